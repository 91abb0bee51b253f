//! Force with which an axis pushes back, and the contribution of the other axes.

use crate::command::host_loss::TRAVEL;
use crate::command::torque_limit::Load;
use crate::controller::Record;
use crate::kinematics::statics::static_force;
use crate::law::activation::Activation;
use crate::law::nullspace::fade_squared;
use crate::math::ldlt6::pseudo_inverse;
use crate::math::rows::{axes, load_rows, rows_array, transpose_times, wide};
use crate::math::simd::{Arithmetic, EveryJoint, Lanes};
use crate::params::{Law, LimitRule, Plan, Settings};
use crate::task::compliance::{compliance, strength};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS};

type Axes = <EveryJoint as Lanes>::Axes;

/// The pose of one step, with the quantities of the law.
pub(super) struct Pose<'a> {
    plan: &'a Plan,
    settings: &'a Settings,
    record: &'a Record,
    /// Activation matrix; `Some` if the law computes its torque limits from it.
    shares: Option<Activation<EveryJoint>>,
    /// Budget of the null-space motion under the sum rule [N·m].
    null: JointVec,
}

impl<'a> Pose<'a> {
    pub(super) fn new(plan: &'a Plan, settings: &'a Settings, record: &'a Record) -> Self {
        let needed = plan.law == Law::Paper || plan.limits == LimitRule::Sum;
        let shares = needed.then(|| record.shares(plan));
        let null = shares.map_or([0.0; MAX_JOINTS], |shares| shares.null().map(|share| share * plan.null_torque));
        Self { plan, settings, record, shares: shares.filter(|_| plan.law == Law::Paper), null }
    }

    /// `Σ_i |J⁺_ij| τ_f,i` of each axis, static friction under the arm's weight: a motion of the tool along the axis
    /// turns every joint against its friction.
    pub(super) fn friction(&self) -> AxisVec {
        let (plan, record) = (self.plan, self.record);
        let scaled = rows_array(&plan.scale_rows(&load_rows::<EveryJoint>(&record.rows)));
        let [sigma_min, sigma_max] = record.sigma(plan);
        let squared = [fade_squared(sigma_min, sigma_max); MAX_AXES];
        let inverse = pseudo_inverse(&scaled, &[1.0; MAX_JOINTS], &squared);
        let mut out = [0.0; MAX_AXES];
        for r in 0..plan.k.min(MAX_AXES) {
            let felt: f64 =
                (0..plan.n).map(|i| inverse[r][i].abs() * plan.servos.friction_at_rest(i, record.gravity[i])).sum();
            out[r] = felt * plan.row_scale[r];
        }
        out
    }

    /// Returns the share of the friction that the feed-forward leaves.
    pub(super) fn friction_share_left(&self) -> f64 {
        match self.plan.law {
            Law::Cap | Law::Impedance => 1.0 - (self.settings.compensation.friction * self.record.gamma).min(1.0),
            Law::Paper => 1.0,
        }
    }

    /// Force at which axis `row`, pushed toward `side`, yields: at a small and at a large deviation.
    pub(super) fn gives_way(&self, row: usize, side: usize) -> [f64; 2] {
        let (plan, record) = (self.plan, self.record);
        let axis = &plan.rows[row];
        let d = [axis.soft_until, axis.firm_from];
        match plan.law {
            Law::Cap | Law::Impedance => {
                let sign = [-1.0, 1.0][side];
                let ceiling = static_force(&record.rows[row], sign, &plan.servos.torque, &record.gravity, plan.n);
                d.map(|d| self.cap(row, side, d).min(ceiling))
            }
            Law::Paper => {
                let strengths = if axis.yields[side] > 0.0 {
                    [1.0, 0.0].map(|c| strength(c, axis.soft[side], axis.firm[side], axis.profile))
                } else {
                    [axis.hold; 2]
                };
                strengths.map(|most| self.with_strength(row, side, most))
            }
        }
    }

    /// Force of law `cap`, `min(F, h K_x (1 − η)|e| / C_jj)`, or of law `impedance`, `min(F, K (1 − η)|e|)`, at `ẽ` =
    /// `threshold`, at most the simulated distance of a push.
    fn cap(&self, row: usize, side: usize, threshold: f64) -> f64 {
        let (plan, record) = (self.plan, self.record);
        let axis = &plan.rows[row];
        let w = axis.yields[side];
        let left = 1.0 - axis.eta * w;
        let travel = TRAVEL[usize::from(axis.axis >= 3)];
        let e = if self.settings.paper_options.raw_deviation { threshold } else { threshold / left }.min(travel);
        let seen = if self.settings.paper_options.raw_deviation { e } else { left * e };
        let c = compliance(seen, axis.soft_until, axis.firm_from);
        let soft = strength(c, axis.soft[side], axis.firm[side], axis.profile);
        let most = w * soft + (1.0 - w) * axis.hold;
        if plan.law == Law::Impedance {
            return most.min(record.gain_factor * axis.stiffness[side] * left * e);
        }
        let own: f64 = (0..plan.n).map(|i| record.rows[row][i].powi(2) * plan.servos.compliance[i]).sum();
        let damping = plan.damping_scale[row] * record.damping * record.damping / plan.servos.kp_mean;
        let h = self.settings.paper_options.horizon;
        let bound = h * if w > 0.0 { axis.soft_step_limit } else { axis.step_limit };
        let step = (h * plan.kx_derating * plan.kx[row][row] * left * e).min(bound);
        most.min(step / (own + (1.0 - w) * damping))
    }

    /// Deviation [m, rad] at which a yielding axis exerts its whole cap under the laws with a cap, at most the
    /// simulated distance.
    pub(super) fn full(&self, row: usize, side: usize) -> f64 {
        let axis = &self.plan.rows[row];
        let travel = TRAVEL[usize::from(axis.axis >= 3)];
        let [small, large] = self.gives_way(row, side);
        let left = if self.settings.paper_options.raw_deviation { 1.0 } else { 1.0 - axis.eta };
        let from = if large > small { axis.firm_from / left } else { 0.0 };
        let slope = self.cap(row, side, 1e-4) / 1e-4;
        from.max(large / slope).min(travel)
    }

    /// Static force that the limits hold if axis `row` has this strength and the others keep theirs.
    fn with_strength(&self, row: usize, side: usize, most: f64) -> f64 {
        let mut all = self.record.axis_strength;
        all[row] = most;
        self.held(row, side, &all)
    }

    /// Returns the strength of the axis at its own strength 0, and the axis with the largest share of it.
    pub(super) fn coupling(&self, row: usize, side: usize) -> (f64, Option<usize>) {
        let mut most = self.record.axis_strength;
        most[row] = 0.0;
        let whole = self.held(row, side, &most);
        let (mut least, mut with) = (whole - 1e-9 * whole.abs(), None);
        for other in (0..self.plan.k).filter(|&other| other != row) {
            let mut fewer = most;
            fewer[other] = 0.0;
            let force = self.held(row, side, &fewer);
            if force < least {
                (least, with) = (force, Some(other));
            }
        }
        (whole, with)
    }

    /// Static force along `row` that the limits of the law hold if each axis may demand `most`.
    fn held(&self, row: usize, side: usize, most: &AxisVec) -> f64 {
        let (plan, record, n) = (self.plan, self.record, self.plan.n);
        let gravity = if self.settings.gravity_use().in_limits() { record.gravity } else { [0.0; MAX_JOINTS] };
        let wrench: Axes = wide(&record.wrench);
        let load = Load {
            gravity: EveryJoint::load(&gravity),
            feed_forward: EveryJoint::load(&record.feed_forward),
            task: transpose_times(&load_rows(&record.rows), &axes(Axes::clip(wrench, wide(most)))),
            offset: EveryJoint::splat(0.0),
            gravity_scale: self.settings.paper_options.gravity_scale,
            margin: EveryJoint::load(&plan.margin),
        };
        let mut limit = match (&self.shares, plan.limits) {
            (Some(shares), _) => load.budget(shares.distribute(wide(most), plan.null_torque)).array(),
            (None, LimitRule::Demand) => load.demand().array(),
            (None, LimitRule::Sum) => load.sum(&record.rows, most, &self.null),
        };
        for i in 0..n {
            limit[i] = limit[i].max(plan.floor[i]).min(plan.servos.torque[i]);
        }
        let sign = [-1.0, 1.0][side];
        static_force(&record.rows[row], sign, &limit, &record.gravity, n)
    }
}
