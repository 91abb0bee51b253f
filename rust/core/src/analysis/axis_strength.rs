//! Force with which a task axis resists a push, the friction along it, and the effect of the other axes on that force.

use crate::command::host_loss::TRAVEL;
use crate::command::torque_limit::LimitTerms;
use crate::controller::Diagnostics;
use crate::kinematics::statics::static_force;
use crate::law::AxisPush;
use crate::law::activation::Activation;
use crate::law::friction::UNOPPOSED_SHARE;
use crate::law::nullspace::projector_damping_sq;
use crate::math::ldlt6::pseudo_inverse;
use crate::math::rows::{load_rows, store_rows, tr_mul};
use crate::math::simd::{F64x8, JointVec16, JointVector, RealOps};
use crate::params::{LimitRule, Params, Settings};
use crate::task::compliance::{compliance, strength};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS};

type Axes = <JointVec16 as JointVector>::Axes;

/// Forces and friction along the task axes at one control step.
pub(super) struct StepAnalysis<'a> {
    params: &'a Params,
    settings: &'a Settings,
    record: &'a Diagnostics,
    /// Activation matrix A, equation (10) of the paper, from which law `paper` computes its torque limits; `None` under
    /// other laws.
    shares: Option<Activation<JointVec16>>,
    /// Torque of each joint for the null-space motion [N·m], which the rule `Sum` adds; 0 under other rules.
    null: JointVec,
}

impl<'a> StepAnalysis<'a> {
    pub(super) fn new(params: &'a Params, settings: &'a Settings, record: &'a Diagnostics) -> Self {
        let needed = !params.law.by_force() || params.limits == LimitRule::Sum;
        let shares = needed.then(|| record.shares(params));
        let null = shares.map_or([0.0; MAX_JOINTS], |shares| shares.null().map(|share| share * params.null_torque));
        Self { params, settings, record, shares: shares.filter(|_| !params.law.by_force()), null }
    }

    /// Returns the static friction along each axis j, `Σ_i |J⁺_ij| τ_f,i` [N, N·m]: a motion of the tool along the axis
    /// turns every joint i against its friction `τ_f,i` under the gravity load.
    pub(super) fn friction(&self) -> AxisVec {
        let (params, record) = (self.params, self.record);
        let scaled = store_rows(&params.scale_rows(&load_rows::<JointVec16>(&record.rows)));
        let [sigma_min, sigma_max] = record.sigma(params);
        let squared = [projector_damping_sq(sigma_min, sigma_max); MAX_AXES];
        let inverse = pseudo_inverse(&scaled, &[1.0; MAX_JOINTS], &squared);
        let mut out = [0.0; MAX_AXES];
        for r in 0..params.k.min(MAX_AXES) {
            let felt: f64 =
                (0..params.n).map(|i| inverse[r][i].abs() * params.servos.friction_at_rest(i, record.gravity[i])).sum();
            out[r] = felt * params.row_scale[r];
        }
        out
    }

    /// Returns the part [N, N·m] of the `friction` along axis `row` that the feed-forward does not compensate; all of it
    /// under law `paper`, which has no feed-forward. If friction is only estimated, the part beyond a fixed share is
    /// compensated at most up to the strength of the axis ([`OpposedMotion`](crate::law::friction::OpposedMotion)).
    pub(super) fn friction_left(&self, row: usize, friction: f64) -> f64 {
        if !self.params.law.by_force() {
            return friction;
        }
        let compensated = friction * (self.settings.compensation.friction * self.record.gamma).min(1.0);
        let opposed = (1.0 - UNOPPOSED_SHARE) * compensated;
        let excess = if self.params.servos.estimated { opposed - self.record.axis_strength[row] } else { 0.0 };
        friction - compensated + excess.max(0.0)
    }

    /// Returns the two forces [N, N·m] at which axis `row`, pushed toward `side` (0: −, 1: +), yields: at the
    /// deviations `soft_until` and `firm_from` from its adapted target.
    pub(super) fn yield_forces_at(&self, row: usize, side: usize) -> [f64; 2] {
        let (params, record) = (self.params, self.record);
        let axis = &params.per_axis[row];
        let d = [axis.soft_until, axis.firm_from];
        if params.law.by_force() {
            let sign = [-1.0, 1.0][side];
            let ceiling = static_force(&record.rows[row], sign, &params.servos.torque, &record.gravity, params.n);
            return d.map(|d| self.cap_at(row, side, d).min(ceiling));
        }
        let strengths = if axis.yields[side] > 0.0 {
            [1.0, 0.0].map(|c| strength(c, axis.soft[side], axis.firm[side], axis.profile))
        } else {
            [axis.hold; 2]
        };
        strengths.map(|max| self.capacity_with(row, side, max))
    }

    /// Returns the force [N, N·m], at most the strength, that law `cap` or `impedance` exerts at the deviation
    /// `threshold` [m, rad] from the adapted target (with `raw_deviation`: from the target). The deviation from the
    /// target is at most the distance of a simulated push.
    fn cap_at(&self, row: usize, side: usize, threshold: f64) -> f64 {
        let (params, record) = (self.params, self.record);
        let axis = &params.per_axis[row];
        let w = axis.yields[side];
        let left = 1.0 - axis.eta * w;
        let travel = TRAVEL[usize::from(axis.axis >= 3)];
        let e = if self.settings.paper_options.raw_deviation { threshold } else { threshold / left }.min(travel);
        let deviation = if self.settings.paper_options.raw_deviation { e } else { left * e };
        let c = compliance(deviation, axis.soft_until, axis.firm_from);
        let soft = strength(c, axis.soft[side], axis.firm[side], axis.profile);
        let max = w * soft + (1.0 - w) * axis.hold;
        let push = AxisPush {
            params,
            horizon: self.settings.paper_options.horizon,
            row,
            side,
            j_row: &record.rows[row],
            damping: params.damping_scale[row] * record.damping * record.damping / params.servos.kp_mean,
            gain_factor: record.gain_factor,
            share: left,
            deviation: e,
        };
        max.min(push.force())
    }

    /// Returns the deviation [m, rad], at most the distance of a simulated push, at which a yielding axis exerts its
    /// full strength under law `cap` or `impedance`.
    pub(super) fn full_cap_deviation(&self, row: usize, side: usize) -> f64 {
        let axis = &self.params.per_axis[row];
        let travel = TRAVEL[usize::from(axis.axis >= 3)];
        let [small, large] = self.yield_forces_at(row, side);
        let left = if self.settings.paper_options.raw_deviation { 1.0 } else { 1.0 - axis.eta };
        let from = if large > small { axis.firm_from / left } else { 0.0 };
        let slope = self.cap_at(row, side, 1e-4) / 1e-4;
        from.max(large / slope).min(travel)
    }

    /// Returns the static force [N, N·m] that the torque limits would hold along axis `row` if its strength were `max`;
    /// the other axes keep their strengths.
    fn capacity_with(&self, row: usize, side: usize, max: f64) -> f64 {
        let mut all = self.record.axis_strength;
        all[row] = max;
        self.static_capacity(row, side, &all)
    }

    /// Returns the static force [N, N·m] that the torque limits would still hold along the axis if its own strength
    /// were 0, and the other axis that contributes most to this force; `None` if no axis does.
    pub(super) fn coupling(&self, row: usize, side: usize) -> (f64, Option<usize>) {
        let mut max = self.record.axis_strength;
        max[row] = 0.0;
        let whole = self.static_capacity(row, side, &max);
        let (mut least, mut with) = (whole - 1e-9 * whole.abs(), None);
        for other in (0..self.params.k).filter(|&other| other != row) {
            let mut fewer = max;
            fewer[other] = 0.0;
            let force = self.static_capacity(row, side, &fewer);
            if force < least {
                (least, with) = (force, Some(other));
            }
        }
        (whole, with)
    }

    /// Returns the static force [N, N·m] along axis `row` that the torque limits of the law hold if the strengths of
    /// the axes are `max`.
    fn static_capacity(&self, row: usize, side: usize, max: &AxisVec) -> f64 {
        let (params, record, n) = (self.params, self.record, self.params.n);
        let gravity = if self.settings.gravity_use().in_limits() { record.gravity } else { [0.0; MAX_JOINTS] };
        let wrench = Axes::from_axes(&record.wrench);
        let terms = LimitTerms {
            gravity: JointVec16::load(&gravity),
            feed_forward: JointVec16::load(&record.feed_forward),
            task: tr_mul(&load_rows(&record.rows), &Axes::clamp_abs(wrench, Axes::from_axes(max)).to_axes()),
            offset: JointVec16::splat(0.0),
            gravity_scale: self.settings.paper_options.gravity_scale,
            margin: JointVec16::load(&params.limit_margin),
        };
        let mut limit = match (&self.shares, params.limits) {
            (Some(shares), _) => terms.budget(shares.distribute(Axes::from_axes(max), params.null_torque)).to_joints(),
            (None, LimitRule::Demand) => terms.demand().to_joints(),
            (None, LimitRule::Sum) => terms.sum(&record.rows, max, &self.null),
        };
        for i in 0..n {
            limit[i] = limit[i].max(params.min_torque_limit[i]).min(params.servos.torque[i]);
        }
        let sign = [-1.0, 1.0][side];
        static_force(&record.rows[row], sign, &limit, &record.gravity, n)
    }
}
