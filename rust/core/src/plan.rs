//! Settings, servos and model resolved into the arrays that the cycle reads.

use crate::error::{Error, Result};
use crate::kinematics::Masses;
use crate::law::nullspace::Cost;
use crate::model::Model;
use crate::servos::{ServoArrays, Servos};
use crate::settings::{Damping, Follow, Law, LimitRule, Projector, Settings};
use crate::survey;
use crate::task::axes::{AXIS_NAMES, Axis, Frame, Profile};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Reach [m] of the arm on which the damping constants were found; others are scaled to it.
const REFERENCE_REACH: f64 = 0.71;

/// Largest η without knowing `k_p` or having captured gravity: beyond it a gravity error walks the arm away.
const ETA_UNPROVEN: f64 = 0.95;

/// `K_x h T_e` [s] up to which the stiff axes stay quiet.
const GAIN_DELAY_BOUND: f64 = 0.03;

/// One task axis, every default filled in.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    /// Index among x, y, z, roll, pitch, yaw.
    pub(crate) axis: usize,
    pub(crate) soft: [f64; 2],
    pub(crate) firm: [f64; 2],
    pub(crate) hold: f64,
    pub(crate) yields: [f64; 2],
    pub(crate) eta: f64,
    pub(crate) d_minus: f64,
    pub(crate) d_plus: f64,
    /// Half-width [m or rad] of the change-over between the sides.
    pub(crate) band: f64,
    pub(crate) profile: Profile,
    pub(crate) step_limit: f64,
    pub(crate) soft_step_limit: f64,
}

/// λ of line 7, in the units of the scaled rows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DampingPlan {
    pub(crate) lambda_0: f64,
    pub(crate) sigma_0: f64,
    pub(crate) lambda_max: f64,
}

/// Everything that stays the same from tick to tick.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    pub(crate) n: usize,
    pub(crate) k: usize,
    pub(crate) law: Law,
    pub(crate) follow: Follow,
    pub(crate) limits: LimitRule,
    pub(crate) projector: Projector,
    pub(crate) frame: Frame,
    /// Axis index of each row.
    pub(crate) axes: Vec<usize>,
    pub(crate) rows: [Row; MAX_AXES],
    /// 1 / length for translations, 1 for rotations: what makes singular values of mixed rows comparable.
    pub(crate) row_scale: AxisVec,
    /// Factor on λ² of each row.
    pub(crate) damping_scale: AxisVec,
    pub(crate) kx: [[f64; MAX_AXES]; MAX_AXES],
    pub(crate) kq: [[f64; MAX_JOINTS]; MAX_JOINTS],
    /// Factor ≤ 1 on K_x that keeps it within the bound of the present delay.
    pub(crate) kx_derating: f64,
    pub(crate) alpha: f64,
    pub(crate) damping: DampingPlan,
    pub(crate) servos: ServoArrays,
    pub(crate) cost: Cost,
    pub(crate) null_torque: f64,
    pub(crate) null_speed: f64,
    pub(crate) joint_weight: JointVec,
    pub(crate) joint_speed: JointVec,
    pub(crate) lower: JointVec,
    pub(crate) upper: JointVec,
    pub(crate) floor: JointVec,
    pub(crate) margin: JointVec,
    /// Rise of the limits per second; ∞ for none.
    pub(crate) rise: JointVec,
    /// Stiffness for the gravity offset, k_g.
    pub(crate) kg: JointVec,
}

impl Plan {
    pub(crate) fn new(model: &Model, settings: &Settings, servos: Option<&Servos>, captured: bool) -> Result<Self> {
        settings.validate()?;
        let n = model.n();
        let axes: Vec<usize> = (0..MAX_AXES).filter(|&axis| settings.task.axes[axis]).collect();
        let k = axes.len();
        if k > n && settings.task.length.is_none() {
            return Err(Error::config(
                "task.axes",
                format!(
                    "{k} axes on an arm of {n} joints cannot all be met: take away at least {} (e.g. axes=\"xyz\"), \
                     or give task.length [m], the distance that counts as much as one radian",
                    k - n
                ),
            ));
        }
        let spread = servos.map(|s| s.for_joints(n)).transpose()?;
        let arrays = ServoArrays::new(n, spread.as_ref(), model.effort_limit());
        check_gravity(model, settings)?;
        check_kp(settings, &arrays, model)?;
        let known = captured || servos.is_some_and(|s| s.kp_known);
        let rows = resolve_rows(model, settings, &arrays, &axes, known)?;
        let unit = settings.task.length.filter(|_| k > n).unwrap_or_else(|| scale_length(model.reach()));
        let (mut row_scale, mut damping_scale) = ([1.0; MAX_AXES], [1.0; MAX_AXES]);
        for (r, &axis) in axes.iter().enumerate() {
            if axis < 3 {
                row_scale[r] = 1.0 / unit;
                damping_scale[r] = if matches!(settings.damping, Damping::Fixed(_)) { 1.0 } else { unit * unit };
            }
        }
        let redundant = k < n;
        if settings.law == Law::Paper && !redundant && settings.null_torque.is_some_and(|torque| torque > 0.0) {
            return Err(Error::config(
                "null_torque",
                format!("{k} task axes leave no null space on {n} joints: leave it out, or take away an axis"),
            ));
        }
        let mut plan = Self {
            n,
            k,
            law: settings.law,
            follow: settings.effective_follow(),
            limits: settings.limits,
            projector: settings.projector,
            frame: settings.task.frame,
            rows,
            row_scale,
            damping_scale,
            kx: [[0.0; MAX_AXES]; MAX_AXES],
            kq: settings.kq.spread("kq", n)?,
            kx_derating: 1.0,
            alpha: settings.alpha.unwrap_or_else(|| settings.kx.largest()),
            damping: resolve_damping(model, settings, &axes, unit),
            cost: resolve_cost(model, settings)?,
            null_torque: settings.null_torque.unwrap_or(if redundant { 2.0 } else { 0.0 }),
            null_speed: settings.null_speed,
            joint_weight: list("joint_weights", settings.joint_weights.as_deref(), n, 1.0)?,
            joint_speed: resolve_speed(model, settings)?,
            lower: fill(model.lower(), f64::NEG_INFINITY),
            upper: fill(model.upper(), f64::INFINITY),
            floor: match &settings.floor {
                Some(floor) => list("floor", Some(floor), n, 0.0)?,
                None => arrays.friction,
            },
            margin: [0.0; MAX_JOINTS],
            rise: [f64::INFINITY; MAX_JOINTS],
            kg: arrays.kp,
            servos: arrays,
            axes,
        };
        // Joint weights of J⁺ are those of the cost; the pseudo-inverse wants their inverse.
        plan.joint_weight = plan.joint_weight.map(|w| 1.0 / w);
        plan.kx = compact(&settings.kx.spread("kx", if matches!(settings.kx, crate::settings::Gain::Scalar(_)) { MAX_AXES } else { k })?, k);
        plan.kx_derating = derating(settings, &plan)?;
        for i in 0..n {
            let usable = plan.servos.torque[i];
            let share = if usable.is_finite() { settings.margin * usable } else { 0.0 };
            plan.margin[i] = share.max(2.0 * plan.servos.friction[i]);
            if settings.stiffening_time > 0.0 {
                plan.rise[i] = usable / settings.stiffening_time;
            }
        }
        if let Some(posture) = &settings.posture {
            list("posture", Some(posture), n, 0.0)?;
        }
        Ok(plan)
    }

    /// Task rows with translations divided by the arm's length.
    #[inline]
    pub(crate) fn scale_rows(&self, rows: &Rows) -> Rows {
        let mut out = *rows;
        for (row, scale) in out.iter_mut().zip(self.row_scale) {
            row.iter_mut().for_each(|value| *value *= scale);
        }
        out
    }

    /// K_x h that the present delay allows.
    pub(crate) fn gain_bound(&self, delay: f64, period: f64) -> f64 {
        let well_damped = (0..self.n).all(|i| self.servos.damping[i] * self.servos.compliance[i] >= 0.04);
        let effective_delay = delay + 0.5 * period;
        if well_damped { 3.0 } else { (GAIN_DELAY_BOUND / effective_delay).clamp(1.0, 3.0) }
    }

    /// The largest K_x h of an axis.
    pub(crate) fn gain(&self, horizon: f64) -> f64 {
        (0..self.k).map(|r| self.kx[r][r] * horizon).fold(0.0, f64::max)
    }
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

fn derating(settings: &Settings, plan: &Plan) -> Result<f64> {
    let (gain, bound) = (plan.gain(settings.horizon), plan.gain_bound(settings.delay, 1.0 / settings.rate));
    if settings.law == Law::Cap && gain > bound * (1.0 + 1e-12) {
        return Err(Error::limit(
            "kx · horizon",
            gain,
            format!(
                "(0, {bound:.3}]: with a delay of {} s at {} Hz a stiffer loop oscillates; lower kx, or shorten delay and period",
                settings.delay, settings.rate
            ),
        ));
    }
    Ok(1.0)
}

fn check_gravity(model: &Model, settings: &Settings) -> Result<()> {
    let unknown = model.unknown_mass_joints();
    if settings.gravity == crate::settings::GravityUse::Off || unknown.is_empty() || settings.floor.is_some() {
        return Ok(());
    }
    let names: Vec<&str> = unknown.iter().map(|&i| model.joint_names()[i].as_str()).collect();
    Err(Error::config(
        "gravity",
        format!(
            "no mass is known of what joints {} move, so gravity cannot be compensated there: add <inertial> to the URDF, \
             or give floor=[...] [N·m] for the limits, or gravity=\"off\"",
            names.join(", ")
        ),
    ))
}

fn check_kp(settings: &Settings, servos: &ServoArrays, model: &Model) -> Result<()> {
    if servos.has_kp {
        return Ok(());
    }
    let wants = match settings.law {
        Law::Cap => Some("law=\"cap\""),
        Law::Paper if settings.budget_on_goal => Some("budget_on_goal=True"),
        Law::Paper if settings.effective_follow() == Follow::Free => Some("follow=\"free\""),
        Law::Paper if settings.gravity.in_goal() => Some("gravity in the goals"),
        Law::Paper => None,
    };
    wants.map_or(Ok(()), |what| {
        Err(Error::config(
            "servos",
            format!(
                "{what} needs the stiffness k_p of joints {}: give servos=Servos(kp=[...] [N·m/rad], torque=[...] [N·m]), \
                 from the servo's table or identified on the arm",
                model.joint_names().join(", ")
            ),
        ))
    })
}

/// Strengths where nothing is given: soft, firm, hold of translations and rotations.
fn default_strengths(model: &Model, settings: &Settings, servos: &ServoArrays) -> [[f64; 3]; 2] {
    match settings.law {
        Law::Paper => [[0.5, 10.0, 10.0]; 2],
        Law::Cap => {
            let masses: Masses = model.chain().masses(model.payload());
            let capacity = survey::static_capacity(model, &servos.torque, &masses, model.gravity_vector());
            let of = |shares: [f64; 3], capacity: f64| shares.map(|share| survey::round_to_halves(share * capacity));
            [of([0.12, 0.45, 1.2], capacity[0]), of([0.105, 0.2, 0.53], capacity[1])]
        }
    }
}

fn resolve_rows(
    model: &Model,
    settings: &Settings,
    servos: &ServoArrays,
    axes: &[usize],
    kp_known: bool,
) -> Result<[Row; MAX_AXES]> {
    let given = |axis: &Axis| axis.soft.is_some() && axis.firm.is_some() && axis.hold.is_some();
    let defaults = if axes.iter().all(|&axis| given(&settings.axes[axis])) {
        [[0.0; 3]; 2]
    } else {
        default_strengths(model, settings, servos)
    };
    let mut rows = [None; MAX_AXES];
    for (slot, &axis) in rows.iter_mut().zip(axes) {
        *slot = Some(resolve_row(settings, axis, defaults[usize::from(axis >= 3)], kp_known)?);
    }
    let spare = resolve_row(&Settings::default(), 0, [0.0; 3], true)?;
    Ok(rows.map(|row| row.unwrap_or(spare)))
}

fn resolve_row(settings: &Settings, axis: usize, defaults: [f64; 3], kp_known: bool) -> Result<Row> {
    let (given, name) = (&settings.axes[axis], AXIS_NAMES[axis]);
    let paper = settings.law == Law::Paper;
    let [soft, firm, hold] = defaults;
    // What is left out makes room for what is given.
    let soft = given.soft.unwrap_or_else(|| given.firm.map_or([soft; 2], |firm| firm.map(|f| f.min(soft))));
    let firm = given.firm.unwrap_or_else(|| soft.map(|s| s.max(firm)));
    let hold = given.hold.unwrap_or_else(|| firm[0].max(firm[1]).max(hold));
    let yields = given.effective_yields();
    for side in 0..2 {
        let sides = if soft[0] == soft[1] && firm[0] == firm[1] { "" } else { [" (pushed toward −)", " (pushed toward +)"][side] };
        if yields.sides()[side] && !(soft[side] <= firm[side] && firm[side] <= hold) {
            return Err(Error::config(
                format!("axes.{name}"),
                format!("needs soft ≤ firm ≤ hold, got soft={}, firm={}, hold={hold}{sides}", soft[side], firm[side]),
            ));
        }
    }
    if !paper && given.eta > ETA_UNPROVEN && !kp_known && !settings.accept.iter().any(|risk| risk == "eta") {
        return Err(Error::limit(
            format!("axes.{name}.eta"),
            given.eta,
            format!(
                "[0, {ETA_UNPROVEN}] while k_p is not known within 10 %: a gravity error would walk the arm away. \
                 Identify k_p (Servos(kp_known=True)), capture gravity, or take the risk by name: Settings(accept=(\"eta\",))"
            ),
        ));
    }
    let translation = axis < 3;
    let d_minus = given.d_minus.unwrap_or(if translation { 0.01 } else { 0.04 });
    let d_plus = given.d_plus.unwrap_or(if translation { 0.10 } else { 0.40 });
    if d_minus >= d_plus {
        return Err(Error::limit(format!("axes.{name}.d_minus"), d_minus, format!("[0, d_plus = {d_plus})")));
    }
    let soft_step = match (paper, translation) {
        (true, true) => 0.1,
        (true, false) => 0.5,
        (false, _) => f64::INFINITY,
    };
    Ok(Row {
        axis,
        soft,
        firm,
        hold,
        yields: yields.sides().map(|on| f64::from(u8::from(on))),
        eta: given.eta,
        d_minus,
        d_plus,
        band: d_minus * settings.direction_band.unwrap_or(if paper { 0.0 } else { 0.1 }),
        profile: given.profile,
        step_limit: given.step_limit.unwrap_or(if translation { 0.4 } else { 2.0 }),
        soft_step_limit: given.soft_step_limit.unwrap_or(soft_step),
    })
}

fn resolve_damping(model: &Model, settings: &Settings, axes: &[usize], length: f64) -> DampingPlan {
    match settings.damping {
        Damping::Fixed(lambda) => DampingPlan { lambda_0: lambda, sigma_0: 0.0, lambda_max: 0.0 },
        Damping::Adaptive { lambda_0, sigma_0, lambda_max } => DampingPlan { lambda_0, sigma_0, lambda_max },
        Damping::Auto => {
            let sigma_0 = 2.0 * survey::median_sigma(model, axes, &settings.task.frame, length);
            DampingPlan { lambda_0: (0.13 * sigma_0).max(1e-6), sigma_0, lambda_max: sigma_0 }
        }
    }
}

fn resolve_cost(model: &Model, settings: &Settings) -> Result<Cost> {
    let n = model.n();
    let (mut middle, mut limits) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    for (i, (&lower, &upper)) in model.lower().iter().zip(model.upper()).enumerate().take(MAX_JOINTS) {
        if lower.is_finite() && upper.is_finite() {
            middle[i] = 0.5 * (lower + upper);
            limits[i] = settings.limit_avoidance / (0.25 * (upper - lower) * (upper - lower));
        }
    }
    if settings.manipulability > 0.0 && model.chain().path != n {
        return Err(Error::config("manipulability", "not available for a chain with mimic joints: use 0"));
    }
    Ok(Cost {
        posture: list("posture_weights", settings.posture_weights.as_deref(), n, 1.0)?,
        middle,
        limits,
        manipulability: settings.manipulability,
    })
}

fn resolve_speed(model: &Model, settings: &Settings) -> Result<JointVec> {
    if settings.joint_speed.is_some() {
        return list("joint_speed", settings.joint_speed.as_deref(), model.n(), f64::INFINITY);
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
        Some(values) if values.len() == n => Ok(fill(values, default)),
        Some(values) => Err(Error::length(key, values.len(), n)),
    }
}

fn fill(values: &[f64], rest: f64) -> JointVec {
    let mut out = [rest; MAX_JOINTS];
    for (slot, value) in out.iter_mut().zip(values) {
        *slot = *value;
    }
    out
}
