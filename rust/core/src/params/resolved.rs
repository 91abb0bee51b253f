//! Constants of the control step, computed from settings, servos and model.

use nalgebra::DMatrix;

use crate::error::{Error, Result};
use crate::kinematics::{joint_targets, target_region};
use crate::math::rounding;
use crate::math::rows::pad;
use crate::math::simd::LANES;
use crate::math::spatial::Mat3;
use crate::model::Model;
use crate::params::axis_params::{AxisParams, DeviationLimit, deviation_limits, max_adaptation, resolve_rows};
use crate::params::axis_params_simd::AxisParamsSimd;
use crate::params::checks::{check_axes, check_gain, check_gravity, check_kp, check_null_torque};
use crate::params::joint_space::JointSpaceStats;
use crate::params::pacing::PacingParams;
use crate::params::scales::clearance;
use crate::params::{
    AXIS_NAMES, Damping, Features, Follow, Frame, Gain, GravityOffset, Law, LimitRule, Projector, ServoArrays, Servos,
    Settings, impedance, scales,
};
use crate::pose::{Pose, TargetRegion};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS};

/// Reach [m] of the arm on which the damping constants were tuned; they are scaled for other arms.
pub(super) const REFERENCE_REACH: f64 = 0.71;

/// Lower bound on λ_max in the solve that redistributes the motion of joints at position limits: it damps that solve
/// also if the settings have no singularity damping.
const MIN_REDISTRIBUTION_DAMPING: f64 = 0.05;

/// Largest `K_x h T_e` (law `cap`) or `ρ T_e` (law `impedance`) [s] at which the stiff axes do not oscillate; h is the
/// horizon, T_e the delay plus half a period, ρ the stiffness relative to the servos'.
pub(super) const GAIN_DELAY_BOUND: f64 = 0.03;

/// Damping λ of the damped least-squares inverse kinematics, in the units of the scaled Jacobian:
/// `λ² = λ₀² + (1 − (σ/σ₀)²) λ_max²` for a smallest singular value σ < σ₀, else λ₀².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DampingParams {
    /// λ₀: damping λ away from singular poses.
    pub lambda_0: f64,
    /// σ₀: value of the smallest singular value σ below which the damping increases.
    pub sigma_0: f64,
    /// λ_max: square root of the increase of λ² at σ = 0.
    pub lambda_max: f64,
}

/// Weights and centres of the null-space cost.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NullSpaceCost {
    /// Weight w of each joint in the posture cost `½ Σ w (q − q_rest)²`.
    pub(crate) posture: JointVec,
    /// Middle of each joint's range [rad]; 0 for continuous joints.
    pub(crate) middle: JointVec,
    /// Weight of each joint in the joint-limit cost: `weight / (half range)²`; 0 for continuous joints.
    pub(crate) limits: JointVec,
    /// Weight of the manipulability cost `−ln √det(JJᵀ)`.
    pub(crate) manipulability: f64,
}

/// Constants of the control step, resolved from settings, servos and model.
#[derive(Debug, Clone)]
pub(crate) struct Params {
    /// Number of joints.
    pub(crate) n: usize,
    /// Number of task axes.
    pub(crate) k: usize,
    /// Optional parts of the step.
    pub(crate) features: Features,
    /// True if the step has no optional parts and the arm has at most [`LANES`] joints.
    pub(crate) is_plain: bool,
    pub(crate) law: Law,
    pub(crate) follow: Follow,
    /// Rule for the joint torque limits under the laws `cap` and `impedance`.
    pub(crate) limits: LimitRule,
    pub(crate) projector: Projector,
    /// Law `paper`: true if the step of each axis is clamped to its torque budget.
    pub(crate) budget_on_goal: bool,
    pub(crate) frame: Frame,
    /// Rotation `base_from_task` of a task frame that does not turn with the tool. Stored also if it is the identity,
    /// because building a matrix in the step would stall the next load of it.
    pub(super) fixed_axes: Mat3,
    /// Index of each task row's axis among x, y, z, roll, pitch, yaw.
    pub(crate) axes: Vec<usize>,
    /// Parameters of each task axis, then of spare rows.
    pub(crate) per_axis: [AxisParams; MAX_AXES],
    /// Parameters of the task axes in vector layout.
    pub(crate) axis_simd: AxisParamsSimd,
    /// Inertia and damping with which the stiff axes track the velocity of their reference.
    pub(crate) pace: PacingParams,
    /// Largest adaptation η of an axis; η < 1 holds in any case.
    pub(crate) max_adaptation: f64,
    /// Axes with a deviation limit; if there are none, the step skips that part.
    pub(crate) deviation_limits: Vec<DeviationLimit>,
    /// Factor on each task row: 1 / length for translations, 1 for rotations, so that singular values have no unit.
    pub(crate) row_scale: AxisVec,
    /// Factor on the squared damping λ² of each task row: length² for translations, 1 for rotations.
    pub(crate) damping_scale: AxisVec,
    /// Gain K_x over the task rows [1/s].
    pub(crate) kx: [[f64; MAX_AXES]; MAX_AXES],
    /// Columns of the gain K_q.
    pub(crate) kq_columns: [JointVec; MAX_JOINTS],
    /// The gain K_q if it is a scalar, else `None`.
    pub(crate) kq_scalar: Option<f64>,
    /// Factor ≤ 1 on K_x; below 1 if K_x exceeds the bound for the present delay.
    pub(crate) gain_scale: f64,
    /// Law `impedance`: largest stiffness [1] and damping [s] relative to the servos' stiffness at the present delay; ∞
    /// with `accept_high_stiffness`.
    pub(crate) impedance_bounds: [f64; 2],
    /// Stiffness of the null-space motion under law `impedance` [N·m/rad], used instead of α; `None` to use α.
    pub(crate) null_stiffness: Option<f64>,
    /// Gain α of the null-space motion [1/s].
    pub(crate) alpha: f64,
    /// Damping of the inverse kinematics.
    pub(crate) damping: DampingParams,
    /// Damping λ² of each row in the redistribution solve: that of a singular pose, because an arm is often singular
    /// without the joints that are at position limits.
    pub(crate) redistribution_damping: AxisVec,
    /// Parameters of the servos.
    pub(crate) servos: ServoArrays,
    /// Weights and centres of the null-space cost.
    pub(crate) cost: NullSpaceCost,
    /// Rest posture [rad]; `None` for the joint positions at reset.
    pub(crate) posture: Option<JointVec>,
    /// Bound on the torque of the null-space motion summed over all joints [N·m].
    pub(crate) null_torque: f64,
    /// Speed limit of the null-space motion of each joint [rad/s].
    pub(crate) null_speed: f64,
    /// 1 / weight of each joint in law `paper`'s pseudo-inverse; 1 under the other laws, which weight joints by the
    /// servos' stiffness.
    pub(crate) joint_weight_inv: JointVec,
    /// True if a joint has a weight other than 1.
    pub(crate) has_joint_weights: bool,
    /// Speed limit of each joint [rad/s]; ∞ for none.
    pub(crate) joint_speed: JointVec,
    /// Lower position limits [rad or m]; −∞ for continuous joints.
    pub(crate) lower: JointVec,
    /// Upper position limits [rad or m]; ∞ for continuous joints.
    pub(crate) upper: JointVec,
    /// Smallest and largest plausible position readings [rad or m].
    pub(crate) q_plausible: [JointVec; 2],
    /// Smallest and largest plausible joint targets [rad or m].
    pub(crate) joint_targets: [JointVec; 2],
    /// Region of plausible target positions.
    pub(crate) target_region: TargetRegion,
    /// Distance by which goals may exceed the position limits [rad]: the lead (goal − q) at which a servo exerts its
    /// full torque.
    pub(crate) overtravel: JointVec,
    /// Largest slope [rad/rad] with which the lead that exerts a force is reduced while its joint is beyond a position
    /// limit.
    pub(crate) limit_fade_slope: f64,
    /// Distance of each joint to its limit [rad or m] below which the posture task fades; −∞ if it never does.
    pub(crate) clearance: JointVec,
    /// Minimum torque limit of each joint [N·m].
    pub(crate) min_torque_limit: JointVec,
    /// Margin of each torque limit above the law's demand [N·m].
    pub(crate) limit_margin: JointVec,
    /// Largest force [N] that a hand may meet along a translation if the host stops; `None` for no bound.
    pub(crate) max_host_loss_force: Option<f64>,
    /// Largest rate at which each torque limit may rise [N·m/s]; ∞ for no bound.
    pub(crate) max_limit_rate: JointVec,
    /// Gravity offset of the goals; without a captured one, its compliance is 1/k_p and its lead 0.
    pub(crate) gravity_offset: GravityOffset,
}

impl Params {
    pub(crate) fn new(
        model: &Model,
        settings: &Settings,
        servos: Option<&Servos>,
        captured: bool,
        joint_space_stats: &mut JointSpaceStats,
    ) -> Result<Self> {
        settings.validate()?;
        let axes: Vec<usize> = (0..MAX_AXES).filter(|&axis| settings.task.axes[axis]).collect();
        let (n, k) = (model.n(), axes.len());
        check_axes(settings, k, n)?;
        let expanded = servos.map(|s| s.for_joints(n)).transpose()?;
        let arrays = ServoArrays::new(n, expanded.as_ref(), model.effort_limit());
        check_gravity(model, settings)?;
        check_kp(settings, &arrays, model)?;
        let known = captured || servos.is_some_and(|s| s.stiffness_known);
        let rows = resolve_rows(model, settings, &arrays, &axes, known, joint_space_stats)?;
        let unit = settings.task.length.filter(|_| k > n).unwrap_or_else(|| scale_length(model.reach()));
        // The paper adds one constant λ to rows of different units. With more axes than joints λ weights the rows
        // against each other, so it is scaled to their units.
        let as_printed = matches!(settings.tracking.damping, Damping::Fixed(_)) && k <= n;
        let row_scale = of_translations(&axes, 1.0 / unit);
        let damping_scale = of_translations(&axes, if as_printed { 1.0 } else { unit * unit });
        let redundant = k < n;
        let damping = resolve_damping(model, settings, &axes, unit, joint_space_stats)?;
        check_null_torque(settings, k, n)?;
        let kx = settings
            .tracking
            .gain
            .expand("tracking.gain", if matches!(settings.tracking.gain, Gain::Scalar(_)) { MAX_AXES } else { k })?;
        let kx = compact(&kx, k);
        let (lower, upper) = (pad(model.lower(), f64::NEG_INFINITY), pad(model.upper(), f64::INFINITY));
        let posture_lets_go = settings.law.by_force() && redundant;
        let (well_damped, posture) = (arrays.well_damped(n), settings.null_space.posture.as_deref());
        let mut params = Self {
            n,
            k,
            features: Features::PLAIN,
            is_plain: false,
            law: settings.law,
            follow: settings.effective_follow(),
            limits: settings.paper_options.limits,
            projector: settings.null_space.projector,
            budget_on_goal: settings.paper_options.budget_on_goal,
            frame: settings.task.frame,
            fixed_axes: settings.task.frame.base_from_task(&Pose::IDENTITY.rotation),
            axis_simd: AxisParamsSimd::new(&rows[..k], &damping_scale, &kx),
            pace: PacingParams::new(model, settings, &arrays, &axes, joint_space_stats),
            per_axis: rows,
            max_adaptation: max_adaptation(settings, known),
            deviation_limits: deviation_limits(settings, &axes),
            row_scale,
            damping_scale,
            kx,
            kq_columns: columns(&settings.paper_options.kq.expand("paper_options.kq", n)?),
            kq_scalar: match settings.paper_options.kq {
                Gain::Scalar(gain) => Some(gain),
                _ => None,
            },
            gain_scale: 1.0,
            impedance_bounds: impedance::bounds(settings, settings.delay, &arrays, n),
            null_stiffness: settings.null_space.stiffness,
            alpha: settings.null_space.gain.unwrap_or_else(|| settings.tracking.gain.max_entry()),
            redistribution_damping: damping_scale.map(|scale| {
                scale
                    * (damping.lambda_0 * damping.lambda_0 + damping.lambda_max.max(MIN_REDISTRIBUTION_DAMPING).powi(2))
            }),
            damping,
            cost: resolve_cost(model, settings)?,
            posture: posture.map(|posture| list("null_space.posture", Some(posture), n, 0.0)).transpose()?,
            null_torque: settings.null_space.max_torque.unwrap_or(if redundant { 2.0 } else { 0.0 }),
            null_speed: settings.null_space.max_speed,
            joint_weight_inv: resolve_weight(settings, n)?,
            has_joint_weights: !settings.law.by_force() && settings.paper_options.joint_weights.is_some(),
            joint_speed: resolve_speed(model, settings)?,
            lower,
            upper,
            q_plausible: scales::q_plausible(model),
            joint_targets: joint_targets(model),
            target_region: if settings.task.axes[..3].contains(&true) {
                target_region(model)
            } else {
                TargetRegion::ANY
            },
            overtravel: joints(n, 0.0, |i| arrays.lead_at_full_torque(i)),
            limit_fade_slope: gain_bound(well_damped, settings.delay, 1.0 / settings.rate) - 1.0,
            clearance: if posture_lets_go { clearance(&lower, &upper) } else { [f64::NEG_INFINITY; MAX_JOINTS] },
            min_torque_limit: match &settings.torque_limits.floor {
                Some(floor) => list("torque_limits.floor", Some(floor), n, 0.0)?,
                None => arrays.friction,
            },
            limit_margin: joints(n, 0.0, |i| margin(settings, &arrays, i)),
            max_host_loss_force: settings.torque_limits.max_host_loss_force,
            max_limit_rate: joints(n, f64::INFINITY, |i| max_limit_rate(settings, &arrays, i)),
            gravity_offset: GravityOffset { compliance: arrays.compliance, lead: [0.0; MAX_JOINTS] },
            servos: arrays,
            axes,
        };
        params.features = Features::new(model, settings, &params);
        params.is_plain = params.features == Features::PLAIN && n <= LANES;
        check_gain(settings, &params)?;
        if params.law.has_springs() {
            impedance::check(model, settings, &params)?;
        }
        Ok(params)
    }

    /// Returns the largest K_x h at which the stiff axes do not oscillate, for this delay and period [s].
    pub(crate) fn gain_bound(&self, delay: f64, period: f64) -> f64 {
        gain_bound(self.servos.well_damped(self.n), delay, period)
    }

    /// Returns the largest K_x h over all directions of the task: the largest singular value of K_x times the horizon
    /// [s].
    pub(crate) fn gain(&self, horizon: f64) -> f64 {
        horizon * crate::math::svd::singular_values(&DMatrix::from_fn(self.k, self.k, |r, c| self.kx[r][c])).max()
    }

    /// Updates what depends on the measured delay [s]: the factor on K_x (1 under laws without such a bound), the
    /// bounds of springs and dampers, the fade past position limits and the damper of the reference tracking.
    pub(crate) fn set_delay(&mut self, delay: f64, settings: &Settings) {
        let (gain, bound) = (self.gain(settings.paper_options.horizon), self.gain_bound(delay, 1.0 / settings.rate));
        self.gain_scale = if self.law.bounds_gain() && gain > bound { bound / gain } else { 1.0 };
        self.impedance_bounds = impedance::bounds(settings, delay, &self.servos, self.n);
        self.limit_fade_slope = bound - 1.0;
        self.pace.set_delay(delay, settings);
    }
}

fn gain_bound(well_damped: bool, delay: f64, period: f64) -> f64 {
    if well_damped { 3.0 } else { (GAIN_DELAY_BOUND / (delay + 0.5 * period)).clamp(1.0, 3.0) }
}

/// Returns the margin of a joint's torque limit above the law's demand [N·m].
fn margin(settings: &Settings, servos: &ServoArrays, i: usize) -> f64 {
    let usable = servos.torque[i];
    let share = if usable.is_finite() { settings.torque_limits.margin * usable } else { 0.0 };
    share.max(2.0 * servos.friction[i])
}

/// Returns the largest rate at which a joint's torque limit may rise [N·m/s]; ∞ for no bound.
fn max_limit_rate(settings: &Settings, servos: &ServoArrays, i: usize) -> f64 {
    if settings.torque_limits.stiffening_time > 0.0 {
        servos.torque[i] / settings.torque_limits.stiffening_time
    } else {
        f64::INFINITY
    }
}

fn resolve_weight(settings: &Settings, n: usize) -> Result<JointVec> {
    let weight = list("paper_options.joint_weights", settings.paper_options.joint_weights.as_deref(), n, 1.0)?;
    Ok(if settings.law.by_force() { [1.0; MAX_JOINTS] } else { weight.map(|w| 1.0 / w) })
}

/// Returns `scale` for each row that is a translation, 1 for the others.
fn of_translations(axes: &[usize], scale: f64) -> AxisVec {
    let mut out = [1.0; MAX_AXES];
    for (slot, _) in out.iter_mut().zip(axes).filter(|(_, axis)| **axis < 3) {
        *slot = scale;
    }
    out
}

/// Returns `value(i)` for each of the first `n` joints and `padding` for the rest.
fn joints(n: usize, padding: f64, value: impl Fn(usize) -> f64) -> JointVec {
    std::array::from_fn(|i| if i < n { value(i) } else { padding })
}

fn scale_length(reach: f64) -> f64 {
    if reach > 0.0 { reach / REFERENCE_REACH } else { 1.0 }
}

fn compact(full: &[[f64; MAX_AXES]; MAX_AXES], k: usize) -> [[f64; MAX_AXES]; MAX_AXES] {
    let mut out = [[0.0; MAX_AXES]; MAX_AXES];
    for r in 0..k {
        out[r][..k].copy_from_slice(&full[r][..k]);
    }
    out
}

/// Returns the columns of a matrix that is given by its rows.
fn columns(rows: &[JointVec; MAX_JOINTS]) -> [JointVec; MAX_JOINTS] {
    std::array::from_fn(|i| rows.map(|row| row[i]))
}

fn resolve_damping(
    model: &Model,
    settings: &Settings,
    axes: &[usize],
    length: f64,
    joint_space_stats: &mut JointSpaceStats,
) -> Result<DampingParams> {
    Ok(match settings.tracking.damping {
        Damping::Fixed(lambda) => DampingParams { lambda_0: lambda, sigma_0: 0.0, lambda_max: 0.0 },
        Damping::Adaptive { lambda_0, sigma_0, lambda_max } => DampingParams { lambda_0, sigma_0, lambda_max },
        Damping::Auto => {
            let sigma_0 = 2.0 * joint_space_stats.median_sigma(model, axes, &settings.task.frame, length);
            if sigma_0 < 1e-6 {
                let names: Vec<&str> = axes.iter().map(|&axis| AXIS_NAMES[axis]).collect();
                return Err(Error::config(
                    "task.axes",
                    format!(
                        "this arm cannot move {} independently of each other in most of its poses: take an axis away, \
                         or choose the damping yourself",
                        names.join(", ")
                    ),
                ));
            }
            let sigma_0 = rounding::round_to_two_digits(sigma_0);
            DampingParams { lambda_0: rounding::round_to_two_digits(0.13 * sigma_0), sigma_0, lambda_max: sigma_0 }
        }
    })
}

fn resolve_cost(model: &Model, settings: &Settings) -> Result<NullSpaceCost> {
    let n = model.n();
    let (mut middle, mut limits) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    for (i, (&lower, &upper)) in model.lower().iter().zip(model.upper()).enumerate().take(MAX_JOINTS) {
        if lower.is_finite() && upper.is_finite() {
            middle[i] = 0.5 * (lower + upper);
            limits[i] = settings.null_space.limit_avoidance / (0.25 * (upper - lower) * (upper - lower));
        }
    }
    if settings.paper_options.manipulability > 0.0 && model.chain().path != n {
        return Err(Error::config(
            "paper_options.manipulability",
            "not available for a chain with mimic joints: use 0",
        ));
    }
    Ok(NullSpaceCost {
        posture: list("paper_options.posture_weights", settings.paper_options.posture_weights.as_deref(), n, 1.0)?,
        middle,
        limits,
        manipulability: settings.paper_options.manipulability,
    })
}

fn resolve_speed(model: &Model, settings: &Settings) -> Result<JointVec> {
    if settings.tracking.joint_speed.is_some() {
        return list("tracking.joint_speed", settings.tracking.joint_speed.as_deref(), model.n(), f64::INFINITY);
    }
    let mut out = [f64::INFINITY; MAX_JOINTS];
    for (slot, speed) in out.iter_mut().zip(model.velocity_limit()) {
        *slot = speed.unwrap_or(f64::INFINITY);
    }
    Ok(out)
}

fn list(key: &str, values: Option<&[f64]>, n: usize, default: f64) -> Result<JointVec> {
    match values {
        None => Ok([default; MAX_JOINTS]),
        Some(values) if values.len() == n => Ok(pad(values, default)),
        Some(values) => Err(Error::length(key, values.len(), n)),
    }
}
