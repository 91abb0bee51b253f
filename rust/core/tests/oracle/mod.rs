//! Oracle: reference implementation of the control step, a direct transcription of lines 1 to 12 of the listing in
//! docs/derivations.md and of the paper's equations.
//!
//! It shares only pose, Jacobian and gravity of the model with the tested step. The estimated singular values of the
//! tested step, which may be off by a percent, are an input. It has no tool speed limit.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Vector3};
use pliant_core::params::{Damping, Law, LimitRule, Settings};
use pliant_core::{Model, Pose, Servos, StepInput};

mod deviation_limit;
mod law;
mod parts;
mod shares;
mod state;

use state::State;

pub(crate) type Vector = DVector<f64>;
pub(crate) type Matrix = DMatrix<f64>;

/// Reference implementation of the controller, with its state between ticks.
#[derive(Clone)]
pub(crate) struct Oracle {
    pub(crate) model: Arc<Model>,
    pub(crate) settings: Settings,
    pub(crate) servos: Option<Servos>,
    /// Damping constants λ₀, σ₀, λ_max.
    pub(crate) damping: [f64; 3],
    pub(crate) delay: f64,
    pub(crate) kg: Vector,
    pub(crate) state: State,
}

/// Intermediate values of one tick; vectors have one entry per task axis or per joint.
#[derive(Clone)]
pub(crate) struct Tick {
    pub(crate) q: Vector,
    pub(crate) velocity: Vector,
    pub(crate) rows: Matrix,
    pub(crate) deviation: Vector,
    pub(crate) adapted: Vector,
    pub(crate) softness: Vector,
    pub(crate) compliance: Vector,
    pub(crate) max_strength: Vector,
    pub(crate) dx: Vector,
    pub(crate) gradient: Vector,
    pub(crate) gravity: Vector,
    pub(crate) feed_forward: Vector,
    pub(crate) wrench: Vector,
    pub(crate) factors: [f64; 3],
    pub(crate) derating: f64,
    pub(crate) activation: Matrix,
    pub(crate) responsibility: Matrix,
    pub(crate) lambda: f64,
    pub(crate) gamma: f64,
    pub(crate) locked: Vec<bool>,
    /// True if a joint is beyond a position limit and a lead that would push it farther out is faded.
    pub(crate) faded: bool,
    /// True for rows at their deviation limit.
    pub(crate) at_limit: Vec<bool>,
    pub(crate) reference: Pose,
    pub(crate) goal: Vector,
    pub(crate) limit: Vector,
    /// Smallest and largest singular value of the task rows, by SVD.
    pub(crate) sigma: [f64; 2],
}

/// Values of one row of the task, lines 3 to 6 of the listing in docs/derivations.md.
struct Row {
    e: f64,
    adapted: f64,
    w: f64,
    c: f64,
    strength: f64,
    max_strength: f64,
    stiffness: f64,
    viscosity: f64,
}

impl Oracle {
    pub(crate) fn new(model: &Arc<Model>, settings: &Settings, servos: Option<&Servos>, damping: [f64; 3]) -> Self {
        let n = model.n();
        let servos = servos.map(|s| s.for_joints(n).unwrap());
        let kg = servos.as_ref().map_or(Vector::repeat(n, 1.0), |s| Vector::from_column_slice(&s.kp));
        Self {
            model: Arc::clone(model),
            settings: settings.clone(),
            servos,
            damping,
            delay: settings.delay,
            kg,
            state: State::new(n),
        }
    }

    /// Runs one tick; `sigma` is the smallest and the largest singular value as estimated by the tested step. Numbers
    /// in comments are lines of the listing.
    #[allow(clippy::too_many_lines, reason = "the lines of the listing in their order, in one place")]
    pub(crate) fn step(&mut self, q: &[f64], target: &Pose, input: &StepInput<'_>, sigma: [f64; 2]) -> Tick {
        let (n, settings) = (self.n(), self.settings.clone());
        let dt = input.dt.unwrap_or(1.0 / settings.rate);
        let h = settings.paper_options.horizon;
        let axes = self.axes();
        let (k, kp, cap) = (axes.len(), self.kp(), settings.law != Law::Paper);

        // 1
        let measured = Vector::from_column_slice(q);
        self.filter(&measured, input, dt);
        let velocity = self.state.velocity.clone();
        let mut q = measured.clone();
        if cap {
            q += &velocity * (self.state.gamma * settings.compensation.delay * self.delay);
        }
        // 2
        let tool = self.model.forward_kinematics(q.as_slice()).unwrap();
        let rows = self.rows(&q);
        let (reference, at_limit) = self.reference(&tool, target);
        let mut e = self.deviation(&tool, &reference);
        // At a deviation limit, the velocity of the reference is not that of the target.
        let twist = input.twist.copied().filter(|_| !at_limit.contains(&true)).unwrap_or_default();
        let twist = self.in_task(
            &tool,
            &Vector3::new(twist[0], twist[1], twist[2]),
            &Vector3::new(twist[3], twist[4], twist[5]),
        );
        if cap {
            e += &twist * (self.state.gamma * settings.compensation.delay * self.delay);
        }
        // 3, 4, 5
        let axis_values: Vec<Row> = (0..k).map(|r| self.row(axes[r], e[r])).collect();
        let of = |f: fn(&Row) -> f64| Vector::from_iterator(k, axis_values.iter().map(f));
        let (adapted, softness, strength, max_strength) =
            (of(|r| r.adapted), of(|r| r.w), of(|r| r.strength), of(|r| r.max_strength));
        let (stiffness, viscosity) = (of(|r| r.stiffness), of(|r| r.viscosity));
        let relative = &twist - &rows * &velocity;
        // 6
        let fed = if cap { Vector::zeros(k) } else { twist };
        let s = (Self::gain(&settings.tracking.gain, k) * &adapted + fed) * h;
        let clip = |value: f64, bound: f64| value.max(-bound).min(bound);
        let soft_step = Vector::from_fn(k, |r, _| clip(s[r], h * self.soft_velocity_limit(axes[r])));
        let step = Vector::from_fn(k, |r, _| clip(s[r], h * self.velocity_limit(axes[r], softness[r])));
        // 7
        let [lambda_0, sigma_0, lambda_max] = self.damping;
        let mut lambda2 = lambda_0 * lambda_0;
        if sigma[0] < sigma_0 {
            lambda2 += (1.0 - (sigma[0] / sigma_0).powi(2)) * lambda_max * lambda_max;
        }
        let gamma = if sigma_0 > 0.0 { (3.0 * sigma[0] / sigma_0).clamp(0.5, 1.0) } else { 1.0 };
        let length = self.length();
        let scale_lambda = !matches!(settings.tracking.damping, Damping::Fixed(_)) || k > n;
        let row_lambda2 =
            Vector::from_fn(k, |r, _| if axes[r] < 3 && scale_lambda { lambda2 * length * length } else { lambda2 });
        // 10
        let gravity = self.model.gravity(q.as_slice()).unwrap();
        let (friction, resistance) = (self.joint(|s| &s.friction, 0.0), self.resistance());
        // The Stribeck friction fades with the speed as 1/(1 + x + x²).
        let fading = |i: usize| {
            let x = velocity[i].abs() / self.joint(|s| &s.stribeck_speed, 1.0)[i];
            1.0 / (1.0 + x + x * x)
        };
        let way =
            |i: usize| settings.compensation.friction * (velocity[i] / settings.paper_options.friction_speed).tanh();
        let (stribeck, per_load) = (self.joint(|s| &s.stribeck, 0.0), self.joint(|s| &s.load_friction, 0.0));
        let per_load_at_rest = self.joint(|s| &s.load_stribeck, 0.0);
        let on = if cap { gamma } else { 0.0 };
        let idle = Vector::from_fn(n, |i, _| {
            let dry = (friction[i] + fading(i) * stribeck[i]) * way(i);
            on * (dry + settings.compensation.damping * resistance[i] * velocity[i])
        });
        let loaded = Vector::from_fn(n, |i, _| on * (per_load[i] + fading(i) * per_load_at_rest[i]) * way(i));
        let in_goal = if settings.gravity_use() == pliant_core::params::GravityUse::Both
            || settings.gravity_use() == pliant_core::params::GravityUse::Goal
        {
            gravity.clone()
        } else {
            Vector::zeros(n)
        };
        let in_limit = if settings.gravity_use() == pliant_core::params::GravityUse::Both
            || settings.gravity_use() == pliant_core::params::GravityUse::Limits
        {
            gravity.clone()
        } else {
            Vector::zeros(n)
        };
        let gradient = self.gradient(&q, input, &axis_values);

        // 8, 9, 11: first with all joints. Then each joint at a position limit is locked, and the other joints make up
        // for the task motion that is lost thereby.
        let law_input = law::LawInput {
            oracle: self,
            rows: &rows,
            scaled: &self.scaled(&rows),
            row_lambda2: &row_lambda2,
            sigma,
            softness: &softness,
            strength: &strength,
            max_strength: &max_strength,
            soft_step: &soft_step,
            step: &step,
            adapted: &adapted,
            stiffness: &stiffness,
            viscosity: &viscosity,
            velocity: &velocity,
            relative: &relative,
            gradient: &gradient,
            in_goal: &in_goal,
            idle: &idle,
            loaded: &loaded,
        };
        // A lead that exerts a force may exceed the position limits. If q itself is beyond a limit, the lead fades with
        // a slope of lead / 0.02 rad, at most what the delay allows: 0.03 s / T_e minus 1, the slope of the servo
        // itself.
        let late = self.delay + 0.5 / settings.rate;
        let slope = if self.well_damped() { 2.0 } else { (0.03 / late).clamp(1.0, 3.0) - 1.0 };
        let fade = |lead: f64, i: usize| {
            let past_limit = if lead > 0.0 { q[i] - self.model.upper()[i] } else { self.model.lower()[i] - q[i] };
            if past_limit > 0.0 {
                lead.signum() * (lead.abs() - past_limit * slope.min(lead.abs() / 0.02)).max(0.0)
            } else {
                lead
            }
        };
        let mut all_joints = match settings.law {
            Law::Cap => law_input.cap(),
            Law::Impedance => law_input.impedance(),
            Law::Paper => law_input.paper(),
        };
        let (lead, resisted) = (all_joints.force.clone(), all_joints.feed_forward.component_div(&kp));
        all_joints.force = Vector::from_fn(n, |i, _| fade(lead[i], i));
        let faded = all_joints.force != lead;
        let resisted = Vector::from_fn(n, |i, _| fade(resisted[i], i));
        let feed_forward = resisted.component_mul(&kp);
        all_joints.feed_forward.clone_from(&feed_forward);
        let (without_lead, forces) = (q.clone(), &all_joints.force + &resisted + in_goal.component_div(&self.kg));
        let mut motion = all_joints.clone();
        let mut locked = vec![false; n];
        let goal = loop {
            let goal = &without_lead + &motion.lead + &motion.null;
            let past_limit = |i: usize| !(self.model.lower()[i]..=self.model.upper()[i]).contains(&goal[i]);
            let more: Vec<usize> = (0..n).filter(|&i| !locked[i] && past_limit(i)).collect();
            if more.is_empty() {
                break goal + &forces;
            }
            for i in more {
                locked[i] = true;
            }
            // The goal of a locked joint is at its limit.
            let fixed = Vector::from_fn(n, |i, _| {
                let at_limit = if without_lead[i] + all_joints.lead[i] + all_joints.null[i] > self.model.upper()[i]
                    || goal[i] >= self.model.upper()[i]
                {
                    self.model.upper()[i]
                } else {
                    self.model.lower()[i]
                };
                if locked[i] { at_limit - without_lead[i] } else { 0.0 }
            });
            motion = law_input.redistributed(&all_joints, &locked, &fixed);
        };

        // 12
        let ahead = dt.min(0.1);
        let every =
            shares::Shares { oracle: self, rows: &rows, scaled: &self.scaled(&rows), row_lambda2: &row_lambda2, sigma };
        let activation = every.activation(&gradient);
        let responsibility = every.responsibility(&(&step / h), &gradient);
        let null_torque = settings.null_space.max_torque.unwrap_or(if k < n { 2.0 } else { 0.0 });
        let wanted = if cap && settings.paper_options.limits == LimitRule::Demand {
            let bounded = Vector::from_fn(k, |r, _| clip(motion.wrench[r], max_strength[r]));
            // Torque of the leads (goal − q), in which the bounded wrench replaces the requested one.
            let (pulled, whole) = (rows.transpose() * bounded, rows.transpose() * &motion.wrench);
            let task = pulled + kp.component_mul(&(&motion.lead + &motion.force)) - whole;
            let demand = &in_limit + task + &feed_forward + kp.component_mul(&(&motion.null + &q - &measured));
            demand.zip_map(&in_limit, |a, g| a.abs().max(settings.paper_options.gravity_scale * g.abs()))
                + self.margin()
        } else if cap {
            in_limit.abs() * settings.paper_options.gravity_scale
                + rows.abs().transpose() * &max_strength
                + activation.column(k) * null_torque
                + feed_forward.abs()
        } else {
            let mut budget = max_strength.clone().resize_vertically(k + 1, 0.0);
            budget[k] = null_torque;
            &activation * budget + in_limit.abs() * settings.paper_options.gravity_scale
        };
        let floor = settings.torque_limits.floor.as_ref().map_or(friction.clone(), |f| Vector::from_column_slice(f));
        let ceiling = self.ceiling();
        let mut limit = Vector::from_fn(n, |i, _| wanted[i].min(ceiling[i]));
        if let Some(before) = &self.state.limit {
            for i in 0..n {
                let rise = if settings.torque_limits.stiffening_time > 0.0 {
                    ceiling[i] / settings.torque_limits.stiffening_time * ahead
                } else {
                    f64::INFINITY
                };
                limit[i] = limit[i].min(before[i] + rise);
            }
        }
        limit = Vector::from_fn(n, |i, _| limit[i].max(floor[i]).min(ceiling[i]));
        let mut goal = goal;
        for i in 0..n {
            if !cap {
                let max_lead = settings.paper_options.lead_limit.unwrap_or(if self.servos.is_some() {
                    (limit[i] + self.margin()[i]) / kp[i]
                } else {
                    0.3
                });
                let lead = motion.lead[i] + motion.null[i];
                goal[i] = goal[i] - lead + clip(lead, max_lead);
            }
            // The goal exceeds a position limit by at most the lead at full torque.
            let out = if self.servos.is_some() { ceiling[i] / kp[i] } else { 0.0 };
            let (lower, upper) = (self.model.lower()[i] - out, self.model.upper()[i] + out);
            goal[i] = goal[i].max(lower).min(upper);
        }
        // The gravity offset moves first and independently, then all other parts by one common share.
        let slew = settings.tracking.goal_slew * ahead;
        let (snapshot, all) = (in_goal.component_div(&self.kg), goal - &self.state.goal);
        let change = &snapshot - &self.state.weight;
        let (lift, way) = (change.map(|w| clip(w, slew)), all - change);
        let room = |i: usize| slew - lift[i].abs();
        let share = (0..n).filter(|&i| way[i].abs() > room(i)).map(|i| room(i) / way[i].abs()).fold(1.0, f64::min);
        let goal = &self.state.goal + &lift + way * share;
        self.state.weight += lift;
        let singular = self.scaled(&rows).singular_values();

        self.state.gamma = gamma;
        self.state.reference = reference;
        self.state.goal.clone_from(&goal);
        self.state.limit = Some(limit.clone());
        Tick {
            responsibility,
            dx: step / h,
            deviation: e,
            compliance: of(|r| r.c),
            factors: motion.factors,
            derating: motion.derating,
            wrench: motion.wrench,
            lambda: lambda2.sqrt(),
            sigma: [singular.min(), singular.max()],
            q,
            velocity,
            rows,
            adapted,
            softness,
            max_strength,
            gradient,
            gravity,
            feed_forward,
            activation,
            gamma,
            locked,
            faded,
            at_limit,
            reference,
            goal,
            limit,
        }
    }
}
