//! Medians over the arm's joint space: scales for the defaults.

use nalgebra::DMatrix;

use crate::error::{Error, Result};
use crate::kinematics::statics::static_force;
use crate::kinematics::{GroupMasses, JointFrames};
use crate::math::halton;
use crate::math::rows::JointMatrix;
use crate::math::svd::singular_values;
use crate::model::Model;
use crate::params::{Frame, ServoArrays};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Number of poses.
const CONFIGURATIONS: u32 = 512;

/// Number of poses for the time constants of the axes.
const PERIOD_CONFIGURATIONS: usize = 64;

/// Results of a survey of one arm with one set of servos.
///
/// A survey takes milliseconds, longer than a step may. The controller caches it, so that a change of settings that
/// needs the same results costs nothing.
#[derive(Debug, Clone, Default)]
pub(crate) struct WorkspaceStats {
    sigma: Option<(Vec<usize>, Frame, f64, f64)>,
    capacity: Option<(JointVec, [f64; 2])>,
    periods: Option<(Vec<usize>, Frame, [JointVec; 2], AxisVec)>,
}

impl WorkspaceStats {
    /// Returns [`median_sigma`], cached for these axes, frame and length.
    pub(crate) fn median_sigma(&mut self, model: &Model, axes: &[usize], frame: &Frame, length: f64) -> f64 {
        if let Some((of, within, unit, sigma)) = &self.sigma
            && of == axes
            && within == frame
            && unit.to_bits() == length.to_bits()
        {
            return *sigma;
        }
        let sigma = median_sigma(model, axes, frame, length);
        self.sigma = Some((axes.to_vec(), *frame, length, sigma));
        sigma
    }

    /// Returns [`squared_periods`], cached for these axes, frame and servos.
    pub(crate) fn squared_periods(
        &mut self,
        model: &Model,
        servos: &ServoArrays,
        axes: &[usize],
        frame: &Frame,
    ) -> AxisVec {
        let joints = [servos.kp, servos.armature];
        if let Some((of, within, with, periods)) = &self.periods
            && of == axes
            && within == frame
            && with.map(|v| v.map(f64::to_bits)) == joints.map(|v| v.map(f64::to_bits))
        {
            return *periods;
        }
        let periods = squared_periods(model, servos, axes, frame);
        self.periods = Some((axes.to_vec(), *frame, joints, periods));
        periods
    }

    /// Returns [`static_capacity`] with the model's own payload and gravity, cached for these torques.
    pub(crate) fn static_capacity(&mut self, model: &Model, usable: &JointVec) -> [f64; 2] {
        if let Some((of, capacity)) = &self.capacity
            && of.map(f64::to_bits) == usable.map(f64::to_bits)
        {
            return *capacity;
        }
        let masses = model.chain().masses(model.payload());
        let capacity = static_capacity(model, usable, &masses, model.gravity_vector());
        self.capacity = Some((*usable, capacity));
        capacity
    }
}

/// Median over a few poses of `C_jj Λ_jj` [s²] of each task row, with `C = J K_p⁻¹ Jᵀ` and `Λ_jj = 1 / (J M⁻¹ Jᵀ)_jj`:
/// the squared time constant of the axis on the servos' springs. Zero if the masses are unknown.
fn squared_periods(model: &Model, servos: &ServoArrays, axes: &[usize], frame: &Frame) -> AxisVec {
    let (n, chain) = (model.n(), model.chain());
    let masses = chain.masses(model.payload());
    let (mut frames, mut j_base) = (JointFrames::default(), [[0.0; MAX_JOINTS]; MAX_AXES]);
    let mut inertia: JointMatrix = [[0.0; MAX_JOINTS]; MAX_JOINTS];
    let mut samples: [Vec<f64>; MAX_AXES] = std::array::from_fn(|_| Vec::new());
    for q in sample_configurations(model).take(PERIOD_CONFIGURATIONS) {
        chain.forward(&q, &mut frames);
        chain.jacobian(&frames, &mut j_base);
        chain.mass_matrix(&frames, &masses, &mut inertia);
        let rows = crate::kinematics::task_rows(&j_base, &frame.base_from_task(&frames.tool.rotation), axes);
        let matrix = DMatrix::from_fn(n, n, |i, j| inertia[i][j] + if i == j { servos.armature[i] } else { 0.0 });
        let Some(factor) = matrix.cholesky() else { continue };
        for (row, samples) in rows.iter().zip(&mut samples).take(axes.len()) {
            let along = DMatrix::from_fn(n, 1, |i, _| row[i]);
            let mobility = along.dot(&factor.solve(&along));
            let compliance: f64 = (0..n).map(|i| row[i] * row[i] * servos.compliance[i]).sum();
            if mobility > 0.0 && (compliance / mobility).is_finite() {
                samples.push(compliance / mobility);
            }
        }
    }
    samples.map(|mut values| median(&mut values))
}

/// The first 512 Halton points inside the position limits (±π for continuous joints).
pub(crate) fn sample_configurations(model: &Model) -> impl Iterator<Item = JointVec> + '_ {
    (1..=CONFIGURATIONS).map(|index| halton::joints(model.lower(), model.upper(), index))
}

/// Median over the poses of the smallest singular value of the task rows, with translations divided by `length`.
///
/// Uses base axes also for a task in the tool's axes: rows of a full translation or rotation differ by a rotation only,
/// which does not change the singular values.
fn median_sigma(model: &Model, axes: &[usize], frame: &Frame, length: f64) -> f64 {
    let n = model.n();
    median_over_rows(model, axes, frame, |rows| {
        let matrix = DMatrix::from_fn(axes.len(), n, |r, i| if axes[r] < 3 { rows[r][i] / length } else { rows[r][i] });
        singular_values(&matrix).min()
    })
}

/// Median over the poses of a function of the task rows.
pub(crate) fn median_over_rows(model: &Model, axes: &[usize], frame: &Frame, of: impl Fn(&Rows) -> f64) -> f64 {
    let mut frames = JointFrames::default();
    let mut j_base = [[0.0; MAX_JOINTS]; MAX_AXES];
    let mut values: Vec<f64> = sample_configurations(model)
        .map(|q| {
            model.chain().forward(&q, &mut frames);
            model.chain().jacobian(&frames, &mut j_base);
            of(&crate::kinematics::task_rows(&j_base, &frame.base_from_task(&frames.tool.rotation), axes))
        })
        .collect();
    median(&mut values)
}

/// Median static capacity of the arm: the force [N] and the torque [N·m] that its joint torques can hold, over the
/// poses, the three base axes and both signs: `min_i (usable_i + s_i g_i) / |J_ji|`.
fn static_capacity(model: &Model, usable: &JointVec, masses: &GroupMasses, gravity: [f64; 3]) -> [f64; 2] {
    let mut frames = JointFrames::default();
    let mut j_base: Rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    let mut holding = [0.0; MAX_JOINTS];
    let (mut forces, mut moments) = (Vec::new(), Vec::new());
    for q in sample_configurations(model) {
        model.chain().forward(&q, &mut frames);
        model.chain().jacobian(&frames, &mut j_base);
        model.chain().gravity(&frames, masses, gravity, &mut holding);
        for (axis, row) in j_base.iter().enumerate() {
            for sign in [-1.0, 1.0] {
                let capacity = static_force(row, sign, usable, &holding, model.n());
                if capacity.is_finite() {
                    (if axis < 3 { &mut forces } else { &mut moments }).push(capacity);
                }
            }
        }
    }
    [median(&mut forces), median(&mut moments)]
}

/// Refuses an arm that its servos cannot hold in any of the poses: a mass in grams, or wrong servo data.
pub(crate) fn check_holding(model: &Model, usable: &JointVec, masses: &GroupMasses, gravity: [f64; 3]) -> Result<()> {
    let (mut frames, mut holding) = (JointFrames::default(), [0.0; MAX_JOINTS]);
    // Pose with the smallest maximum of torque / usable torque, and the joint with this maximum.
    let mut best = (f64::INFINITY, 0, 0.0);
    for q in sample_configurations(model) {
        model.chain().forward(&q, &mut frames);
        model.chain().gravity(&frames, masses, gravity, &mut holding);
        let mut worst = (0.0, 0, 0.0);
        for i in 0..model.n() {
            let share = holding[i].abs() / usable[i];
            if share > worst.0 {
                worst = (share, i, holding[i].abs());
            }
        }
        if worst.0 < best.0 {
            best = worst;
        }
        if best.0 <= 1.0 {
            return Ok(());
        }
    }
    let (share, joint, torque) = best;
    let name = model.joint_names().get(joint).map_or("", String::as_str);
    Err(Error::out_of_range(
        format!("torque that holds the arm at joint {name} [N·m]"),
        torque,
        format!(
            "±{} even in the best of {CONFIGURATIONS} poses ({share:.1} times too much): check masses [kg], payload [kg] and the \
             servos' torque [N·m]",
            usable[joint]
        ),
    ))
}

pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        len if len % 2 == 1 => values[len / 2],
        len => 0.5 * (values[len / 2 - 1] + values[len / 2]),
    }
}
