//! Restart of the reference when new settings make task axes firmer, so that no axis exerts more force at once.

use crate::kinematics::{Reference, task_rows};
use crate::math::rotation::{base_to_task, rotation_matrix, task_to_base};
use crate::math::simd::{BaselineF64, BaselineF64x8, F64x8, RealOps, SimdLevel};
use crate::math::spatial::{Mat3, multiply};
use crate::model::Chain;
use crate::params::{Law, Params, Settings};
use crate::pose::Pose;
use crate::task::demand::AxisDemand;
use crate::task::pose_error;
use crate::task::reference_governor::ReferenceGovernor;
use crate::{AxisVec, JointVec, MAX_AXES, Rows};

/// Number of bisections of a deviation: the error is below 1e-9 of it.
const BISECTIONS: u32 = 30;

/// Smallest compliance of an axis [m/N, rad/(N·m)]: below it, the joints hardly move the axis.
const MIN_COMPLIANCE: f64 = 1e-12;

/// Smallest change of a deviation [m, rad]: a rounding error does not move the reference.
const MIN_CHANGE: f64 = 1e-6;

/// Settings of a controller, and the parameters that follow from them.
#[derive(Clone, Copy)]
pub(super) struct Rules<'a> {
    pub(super) params: &'a Params,
    pub(super) settings: &'a Settings,
}

/// Force of each task axis at rest as a function of its own deviation only [N, N·m]; under law `paper` the sum of the
/// joint torques that exert it [N·m].
struct AxisForces<'a> {
    rules: Rules<'a>,
    /// Task axes as columns, in the base.
    base_from_task: Mat3,
    /// Force per step `h K_x ẽ` of each row [N/m, N·m/rad]; under law `paper` torque per step.
    stiffness: AxisVec,
}

impl<'a> AxisForces<'a> {
    fn new(rules: Rules<'a>, tool: &Pose, j_base: &Rows) -> Self {
        let params = rules.params;
        let base_from_task = params.base_from_task(tool);
        let rows = task_rows(j_base, &base_from_task, &params.axes);
        let stiffness = std::array::from_fn(|r| {
            let (mut compliance, mut lever) = (0.0, 0.0);
            for (j, c) in rows[r].iter().zip(&params.servos.compliance) {
                compliance += j * j * c;
                lever += j.abs();
            }
            (if matches!(params.law, Law::Paper) { lever } else { 1.0 }) / compliance.max(MIN_COMPLIANCE)
        });
        Self { rules, base_from_task, stiffness }
    }

    /// Returns the components of a 6-vector in base axes along the axes of the task rows.
    fn rows_of(&self, v: &AxisVec) -> AxisVec {
        let turned = base_to_task::<BaselineF64>(&self.base_from_task, v);
        self.rules.params.select_rows::<BaselineF64x8>(&turned).to_axes()
    }

    /// Returns the force of each row at these deviations [m, rad], within its strength.
    fn at(&self, deviation: &AxisVec) -> AxisVec {
        let Rules { params, settings } = self.rules;
        let (e, zero) = (BaselineF64x8::from_axes(deviation), BaselineF64x8::splat(0.0));
        let demand = AxisDemand::<BaselineF64x8>::new(params, settings, params.features, e, zero, 0.0);
        let force = match params.law {
            Law::Impedance => demand.stiffness * demand.adapted,
            Law::Cap | Law::Paper => BaselineF64x8::from_axes(&self.stiffness) * demand.clamped_displacement,
        };
        BaselineF64x8::clamp_abs(force, demand.max_strength).to_axes()
    }

    /// Returns the forces of the rows at these deviations [m, rad] as a wrench in base axes.
    fn wrench(&self, deviation: &AxisVec) -> AxisVec {
        let mut wrench = [0.0; MAX_AXES];
        for (&axis, force) in self.rules.params.axes.iter().zip(self.at(deviation)) {
            wrench[axis] = force;
        }
        task_to_base(&self.base_from_task, &wrench)
    }

    /// Returns the share, 0 to 1, of each row's deviation at which its force is at most `max`; `max` is negative if
    /// it points away from the reference.
    fn shares(&self, deviation: &AxisVec, max: &AxisVec) -> AxisVec {
        let scaled = |share: &AxisVec| -> AxisVec { std::array::from_fn(|r| share[r] * deviation[r]) };
        let exceeds = |share: &AxisVec| -> [bool; MAX_AXES] {
            let force = self.at(&scaled(share));
            std::array::from_fn(|r| force[r].abs() > max[r].max(0.0))
        };
        let firmer = exceeds(&[1.0; MAX_AXES]);
        let (mut low, mut high) = (firmer.map(|firmer| if firmer { 0.0 } else { 1.0 }), [1.0; MAX_AXES]);
        for _ in 0..BISECTIONS {
            let middle = std::array::from_fn(|r| 0.5 * (low[r] + high[r]));
            for (r, exceeds) in exceeds(&middle).into_iter().enumerate() {
                if firmer[r] {
                    *(if exceeds { &mut high[r] } else { &mut low[r] }) = middle[r];
                }
            }
        }
        low
    }
}

/// Moves the reference of `governor` toward the tool along each axis that would otherwise exert more force under the
/// settings `to` than it does under `from`, to the deviation at which the force stays the same: to the tool if the axis
/// exerted no force. From there it approaches the target at a bounded speed.
///
/// Under the laws `cap` and `impedance` a small deviation exerts the same force under settings that differ little, so
/// settings that change at every step do not let the arm sink.
pub(super) fn restart_reference(
    (chain, level, q): (&Chain, SimdLevel, &JointVec),
    (from, to): (Rules<'_>, Rules<'_>),
    governor: &mut ReferenceGovernor,
) {
    let mut j_base: Rows = [[0.0; crate::MAX_JOINTS]; MAX_AXES];
    let tool = chain.pose_and_rows(level, q, Reference::WorldAligned, &mut j_base);
    let (from, to) = (AxisForces::new(from, &tool, &j_base), AxisForces::new(to, &tool, &j_base));
    let error = pose_error(&tool, &governor.pose());
    let deviation = to.rows_of(&error);
    // The strengths of law `paper` are torques, which cannot be compared with forces.
    let is_comparable = matches!(from.rules.params.law, Law::Paper) == matches!(to.rules.params.law, Law::Paper);
    let before = if is_comparable { to.rows_of(&from.wrench(&from.rows_of(&error))) } else { [0.0; MAX_AXES] };
    let max = std::array::from_fn(|r| before[r] * deviation[r].signum());
    let shares = to.shares(&deviation, &max);
    let mut error = base_to_task::<BaselineF64>(&to.base_from_task, &error);
    let mut is_moved = false;
    for (&axis, share) in to.rules.params.axes.iter().zip(shares) {
        if (1.0 - share) * error[axis].abs() > MIN_CHANGE {
            error[axis] *= share;
            is_moved = true;
        }
    }
    if is_moved {
        let [x, y, z, roll, pitch, yaw] = task_to_base(&to.base_from_task, &error);
        let position = std::array::from_fn(|i| tool.position[i] + [x, y, z][i]);
        let rotation = multiply::<BaselineF64>(&rotation_matrix([roll, pitch, yaw]), &tool.rotation);
        governor.set(Pose { rotation, position }, governor.reference_velocity());
    }
}
