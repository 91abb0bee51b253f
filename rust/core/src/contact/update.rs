//! Update of the estimate with one reading: residual, low-pass, wrench and events. Also the uncertainty of an arm at
//! rest.

use super::residual::{Balance, ModelErrors, Noise};
use super::wrench::Estimator;
use super::{ContactEstimator, ContactInput, HISTORY, History, Sent, State, Tare, WrenchEstimate};
use crate::controller::{Controller, period};
use crate::error::{Error, Result};
use crate::kinematics::JointFrames;
use crate::kinematics::velocity_filter::{SPEED_BOUND, VelocityFilter};
use crate::math::simd::{BaselineF64x8, JointVec16, JointVector, LANES};
use crate::params::{AXIS_NAMES, joint_space};
use crate::pose::COORDINATE_BOUND;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Largest plausible torque [N·m] or current [A].
const LOAD_BOUND: f64 = 1e6;

/// Standard deviation [counts] of a reading that is rounded to whole counts and is off by one count half of the time.
const QUANTIZATION_STD: f64 = 0.76;

/// Bound on the noise, as a multiple of its standard deviation.
const NOISE_SIGMAS: f64 = 3.0;

/// The typical uncertainty uses every eighth sampled configuration of the joint space.
const SAMPLE_STRIDE: usize = 8;

/// Kinematics of the tool at one reading.
struct ToolState {
    /// Jacobian rows of the estimated axes, in the task frame.
    rows: Rows,
    base_from_task: [[f64; 3]; 3],
    /// Gravity torques per kg of mass at the tool [N·m/kg].
    payload: JointVec,
}

/// Motion of the joints at one reading.
#[derive(Default)]
struct JointMotion {
    /// Mean of the last two positions [rad]; it belongs to the mean torque of the servos between these readings.
    middle: JointVec,
    velocity: JointVec,
    velocity_error: JointVec,
    /// Acceleration with the same low-pass as the residual [rad/s²].
    acceleration: JointVec,
    noise: Noise,
}

impl ContactEstimator {
    /// Processes one reading `q` [rad]. Call it before the controller's step of the same cycle, while the servos
    /// still follow its last command.
    ///
    /// Allocates nothing. Without measured load or current, the force is 0 and the uncertainty ∞ until the command in
    /// force at the time of the reading is known.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::OutOfRange`] for an invalid input, [`Error::Config`] for a current without torque
    /// constants; the estimate is then unchanged.
    pub fn update(&mut self, controller: &Controller, q: &[f64], input: &ContactInput<'_>) -> Result<&WrenchEstimate> {
        let mut state = self.state;
        self.process(&mut state, controller, q, input, true)?;
        self.state = state;
        Ok(&self.state.estimate)
    }

    /// Processes several readings, one after another, and returns the estimate of the last one.
    ///
    /// Gives the numbers of one [`update`](Self::update) per reading, in less time: without thresholds for events, the
    /// wrench is computed for the last reading only. `q` and the arrays of `input` hold the n numbers of one reading
    /// after another; those of `sent` are the commands before each reading.
    ///
    /// # Errors
    /// [`Error::Shape`] if the arrays do not hold the same number of whole readings; then nothing changes. After an
    /// error of [`update`](Self::update) for one of the readings, the estimate is unchanged, and the stored commands
    /// are cleared.
    pub fn update_series<'a>(
        &mut self,
        controller: &Controller,
        q: &'a [f64],
        input: &ContactInput<'a>,
    ) -> Result<&WrenchEstimate> {
        let n = self.joints.n;
        let [goal, limit] = input.sent.map_or([None; 2], |sent| sent.map(Some));
        if q.is_empty() || !q.len().is_multiple_of(n) {
            return Err(Error::rows("Q", q.len(), n));
        }
        let (dq, load, current) = (input.dq, input.load, input.current);
        for (name, array) in [("dq", dq), ("load", load), ("current", current), ("goal", goal), ("torque_limit", limit)]
        {
            let got = array.map_or(q.len(), <[f64]>::len);
            if got != q.len() {
                return Err(Error::length(name, got, q.len()));
            }
        }
        let has_events = [&self.options.touch, &self.options.stop].into_iter().flatten().any(Option::is_some);
        let last = q.len() / n - 1;
        let mut state = self.state;
        for (k, q) in q.chunks_exact(n).enumerate() {
            let row = |array: Option<&'a [f64]>| array.and_then(|array| array.chunks_exact(n).nth(k));
            let input = ContactInput {
                dt: input.dt,
                dq: row(dq),
                load: row(load),
                current: row(current),
                sent: row(goal).zip(row(limit)).map(|(goal, limit)| [goal, limit]),
            };
            if let Err(error) = self.process(&mut state, controller, q, &input, has_events || k == last) {
                self.history.count = 0;
                return Err(error);
            }
        }
        self.state = state;
        Ok(&self.state.estimate)
    }

    /// Processes one reading: updates `state`, and stores the command. Computes tare candidate, wrench and events only
    /// if `wants_wrench` is true. After an error `state` is invalid.
    #[inline(never)]
    fn process(
        &mut self,
        state: &mut State,
        controller: &Controller,
        q: &[f64],
        input: &ContactInput<'_>,
        wants_wrench: bool,
    ) -> Result<()> {
        if self.joints.n != controller.model().n() {
            return Err(Error::Shape {
                what: "controller".into(),
                got: format!("an arm of {} joints", controller.model().n()),
                expected: format!("the arm of {} joints of this ContactEstimator", self.joints.n),
            });
        }
        let q = controller.positions("q", q)?;
        let dt = period(input.dt.unwrap_or(1.0 / controller.settings().rate))?;
        let dq = input.dq.map(|dq| controller.model().joints_within("dq", dq, SPEED_BOUND)).transpose()?;
        let measured = self.measured(controller, input)?;
        let sent = sent(controller, input)?;

        let motion = self.motion(controller, &q, dq.as_ref(), dt, state);
        let (torque, saturated) = match (measured, self.history.at_reading(sent.as_ref(), controller.delay(), dt)) {
            (Some(load), _) => (load, [false; MAX_JOINTS]),
            (None, Some(sent)) => self.joints.servo_torque(&sent.goal, &sent.limit, &motion.middle, &motion.velocity),
            (None, None) => {
                state.estimate = WrenchEstimate { velocity: motion.velocity, ..WrenchEstimate::empty(self.joints.n) };
                self.history.push(sent.as_ref());
                return Ok(());
            }
        };
        let mut frames = JointFrames::default();
        let gravity = gravity(controller, &q, &mut frames);
        let mut mass = [[0.0; MAX_JOINTS]; MAX_JOINTS];
        controller.model().chain().mass_matrix(&frames, &controller.masses, &mut mass);
        let balance = Balance {
            joints: &self.joints,
            servo_torque: &torque,
            measured: measured.is_some(),
            saturated: &saturated,
            gravity: &gravity,
            mass: &mass,
            velocity: &motion.velocity,
            velocity_error: &motion.velocity_error,
            acceleration: &motion.acceleration,
            noise: &motion.noise,
            friction_speed: controller.settings().paper_options.friction_speed,
        };
        let errors = ModelErrors {
            servo_torque: if measured.is_some() { self.options.load_error } else { self.errors.servo_torque },
            ..self.errors
        };
        let (direction, inertial_torque) = (balance.direction(), balance.inertial_torque());
        let resistance = balance.friction_error(&errors, &direction, &inertial_torque);
        let (static_part, friction) = (balance.static_residual(), balance.friction_torque(&direction));
        let static_uncertainty = self.static_uncertainty(&errors, &resistance, &torque, &gravity);
        // Filtered velocities lag behind positions. Delay the terms without velocity equally, so that all refer to the
        // same time.
        let lag_share = if state.filters_ready && dq.is_none() {
            dt / (controller.settings().tracking.velocity_filter + dt)
        } else {
            1.0
        };
        let share = if state.filters_ready { dt / (self.options.filter + dt) } else { 1.0 };
        for i in 0..self.joints.n {
            state.static_residual[i] += lag_share * (static_part[i] - state.static_residual[i]);
            state.low_passed[i] += share * (state.static_residual[i] + friction[i] - state.low_passed[i]);
            // The first reading adds the full servo torque, which decays while the filters settle.
            let before = state.uncertainty[i];
            state.uncertainty[i] = if state.filters_ready {
                before + share * (static_uncertainty[i] - before)
            } else {
                static_uncertainty[i] + self.joints.max_torque[i]
            };
        }
        state.filters_ready = true;
        if !wants_wrench {
            self.history.push(sent.as_ref());
            return Ok(());
        }
        let tool = self.tool_state(controller, &frames);
        // The acceleration is low-passed already: (velocity − low-passed velocity) / time constant.
        (0..self.joints.n).for_each(|i| state.residual[i] = state.low_passed[i] + inertial_torque[i]);
        state.tare_candidate = Tare {
            residual: state.residual,
            servo_torque: torque,
            gravity,
            friction_bound: resistance,
            payload: tool.payload,
        };
        let mut estimate = self.wrench(&tool, &state.residual, &state.uncertainty, &balance);
        (estimate.torque, estimate.velocity, estimate.saturated) = (torque, motion.velocity, saturated);
        estimate.touch = state.touch.update(&estimate.force, &estimate.uncertainty, dt);
        estimate.stop = state.stop.update(&estimate.force, &estimate.uncertainty, dt);
        if !estimate.force_base.iter().all(|x| x.is_finite()) {
            return Err(Error::config("contact", "the estimate is not finite for this q, load and servo table"));
        }
        state.estimate = estimate;
        self.history.push(sent.as_ref());
        Ok(())
    }

    /// Returns the error bound (6,) [N, N·m] of an estimate, in the task frame, for the arm at rest at `q` [rad]; ∞
    /// along axes that are not estimated.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::OutOfRange`] for `q`.
    pub fn uncertainty_at(&self, controller: &Controller, q: &[f64]) -> Result<AxisVec> {
        let q = controller.positions("q", q)?;
        Ok(self.at_rest(controller, &q))
    }

    /// Returns the median of [`ContactEstimator::uncertainty_at`] over 64 configurations in the joint space.
    pub fn typical_uncertainty(&self, controller: &Controller) -> AxisVec {
        let found: Vec<AxisVec> = joint_space::sample_configurations(controller.model())
            .step_by(SAMPLE_STRIDE)
            .map(|q| self.at_rest(controller, &q))
            .collect();
        let mut out = [f64::INFINITY; MAX_AXES];
        for &axis in &self.axes {
            out[axis] = joint_space::median(&mut found.iter().map(|bound| bound[axis]).collect::<Vec<_>>());
        }
        out
    }

    /// Returns an error if a threshold is below `guard` times the typical uncertainty, or belongs to an axis that is
    /// not estimated. Checks nothing with `accept_thresholds`.
    pub(super) fn check_thresholds(&self, controller: &Controller) -> Result<()> {
        let (options, asked) = (&self.options, |thresholds: &[Option<f64>]| thresholds.iter().any(Option::is_some));
        if options.accept_thresholds || !(asked(&options.touch) || asked(&options.stop)) {
            return Ok(());
        }
        let typical = self.typical_uncertainty(controller);
        for (name, thresholds) in [("touch", &options.touch), ("stop", &options.stop)] {
            for (axis, threshold) in thresholds.iter().enumerate() {
                let Some(value) = *threshold else { continue };
                if !self.axes.contains(&axis) {
                    let message = "has a threshold but is not among the estimated axes: give axes, or leave it out";
                    return Err(Error::config(format!("{name}.{}", AXIS_NAMES[axis]), message));
                }
                let least = options.guard() * typical[axis];
                if value < least {
                    // Round up, so that the number in the message passes this check.
                    let least = (1e3 * least).ceil() / 1e3;
                    let unit = if axis < 3 { "N" } else { "N·m" };
                    return Err(Error::out_of_range(
                        format!("{name}.{} [{unit}]", AXIS_NAMES[axis]),
                        value,
                        format!(
                            "[{least:.3}, ∞): below it this arm, at rest in a typical pose, cannot tell a contact from \
                             friction, k_p and gravity; raise it, say how well the arm is known (kp_error, \
                             friction_error, gravity_error), lower guard, or pass accept_thresholds=True"
                        ),
                    ));
                }
            }
        }
        Ok(())
    }

    fn at_rest(&self, controller: &Controller, q: &JointVec) -> AxisVec {
        let (zero, mut frames) = ([0.0; MAX_JOINTS], JointFrames::default());
        let gravity = gravity(controller, q, &mut frames);
        let mass = [[0.0; MAX_JOINTS]; MAX_JOINTS];
        let balance = Balance {
            joints: &self.joints,
            servo_torque: &gravity,
            measured: false,
            saturated: &[false; MAX_JOINTS],
            gravity: &gravity,
            mass: &mass,
            velocity: &zero,
            velocity_error: &zero,
            acceleration: &zero,
            noise: &Noise { reading: self.reading_noise(controller.settings().rate.recip()), ..Noise::default() },
            friction_speed: controller.settings().paper_options.friction_speed,
        };
        let resistance = balance.friction_error(&self.errors, &zero, &zero);
        let static_uncertainty = self.static_uncertainty(&self.errors, &resistance, &gravity, &gravity);
        self.wrench(&self.tool_state(controller, &frames), &zero, &static_uncertainty, &balance).uncertainty
    }

    /// Returns the servo torques [N·m] from a measured load or current; `None` if neither is given.
    fn measured(&self, controller: &Controller, input: &ContactInput<'_>) -> Result<Option<JointVec>> {
        if let Some(load) = input.load {
            return controller.model().joints_within("load [N·m]", load, LOAD_BOUND).map(Some);
        }
        let Some(current) = input.current else { return Ok(None) };
        let mut load = controller.model().joints_within("current [A]", current, LOAD_BOUND)?;
        let Some(constants) = &self.constants else {
            return Err(Error::config(
                "torque_constant",
                "a current needs the torque per ampere of each joint [N·m/A]",
            ));
        };
        load.iter_mut().zip(constants).for_each(|(value, constant)| *value *= constant);
        Ok(Some(load))
    }

    /// Returns the motion of the joints and updates its filters; the velocity is `dq`, or filtered from the positions.
    fn motion(
        &self,
        controller: &Controller,
        q: &JointVec,
        dq: Option<&JointVec>,
        dt: f64,
        state: &mut State,
    ) -> JointMotion {
        let filter = controller.settings().tracking.velocity_filter;
        if !state.started {
            (state.filter, state.previous_q) = (VelocityFilter::new(q), *q);
            (state.lowpassed_velocity, state.started) = (dq.copied().unwrap_or_default(), true);
        }
        match dq {
            Some(dq) => (state.filter.backlash_output, state.filter.velocity) = (*q, *dq),
            None if self.joints.n <= LANES => self.filter_velocity::<BaselineF64x8>(state, q, filter, dt),
            None => self.filter_velocity::<JointVec16>(state, q, filter, dt),
        }
        let velocity = state.filter.velocity;
        let mut motion = JointMotion { velocity, ..JointMotion::default() };
        motion.noise.reading = self.reading_noise(dt);
        let (span, share) = (self.options.filter + dt, dt / (filter + dt));
        for i in 0..self.joints.n {
            motion.middle[i] = 0.5 * (state.previous_q[i] + q[i]);
            motion.acceleration[i] = (velocity[i] - state.lowpassed_velocity[i]) / span;
            state.lowpassed_velocity[i] += dt * motion.acceleration[i];
            if dq.is_none() {
                let encoder_step = self.joints.encoder_step[i];
                motion.velocity_error[i] = encoder_step / (filter + dt) + filter * motion.acceleration[i].abs();
                // Noise of the differences after a one-pole filter. At rest, the backlash of one count suppresses it.
                let toggling = QUANTIZATION_STD * encoder_step * share / dt * (2.0 / (2.0 - share)).sqrt();
                motion.noise.velocity[i] = toggling.min(velocity[i].abs());
                motion.noise.acceleration[i] = motion.noise.velocity[i] / span;
            }
        }
        state.previous_q = *q;
        motion
    }

    /// Updates the velocity filter with a reading `q` [rad]. `time_constant` and `dt` [s] are those of
    /// [`VelocityFilter::update`].
    fn filter_velocity<J: JointVector>(&self, state: &mut State, q: &JointVec, time_constant: f64, dt: f64) {
        let encoder_step = J::load(&self.joints.encoder_step);
        state.filter.set(state.filter.update(J::load(q), encoder_step, time_constant, dt));
    }

    /// Returns the standard deviation of the low-passed mean of two readings [rad].
    fn reading_noise(&self, dt: f64) -> JointVec {
        let share = dt / (self.options.filter + dt);
        let passed = QUANTIZATION_STD * (0.5 * (share / (2.0 - share)).max(0.0)).sqrt();
        self.joints.encoder_step.map(|step| passed * step)
    }

    fn tool_state(&self, controller: &Controller, frames: &JointFrames) -> ToolState {
        let mut j_base = [[0.0; MAX_JOINTS]; MAX_AXES];
        let mut payload = [0.0; MAX_JOINTS];
        controller.model().chain().jacobian(frames, &mut j_base);
        let base_from_task = controller.params.base_from_task(&frames.tool);
        for (row, g) in j_base.iter().zip(controller.gravity) {
            for i in 0..self.joints.n {
                payload[i] -= row[i] * g;
            }
        }
        let rows = crate::kinematics::task_rows(&j_base, &base_from_task, &self.axes);
        ToolState { rows, base_from_task, payload }
    }

    /// Returns the bound [N·m] on the error of the residual torques, without noise and unknown payload. Errors of servo
    /// and gravity torques are proportional to the change of these torques since the tare.
    fn static_uncertainty(
        &self,
        errors: &ModelErrors,
        resistance: &JointVec,
        torque: &JointVec,
        gravity: &JointVec,
    ) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..self.joints.n {
            let servo_torque = errors.servo_torque * (torque[i] - self.tare.servo_torque[i]).abs();
            let weight = errors.gravity * (gravity[i] - self.tare.gravity[i]).abs();
            out[i] = resistance[i] + self.tare.friction_bound[i] + servo_torque + weight;
        }
        out
    }

    /// Computes the wrench and its error bound, in task and base axes, from the residual minus that of the tare.
    fn wrench(
        &self,
        tool: &ToolState,
        residual: &JointVec,
        uncertainty: &JointVec,
        balance: &Balance<'_>,
    ) -> WrenchEstimate {
        let (k, n) = (self.axes.len(), self.joints.n);
        let (mut external, mut payload) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for i in 0..n {
            external[i] = residual[i] - self.tare.residual[i];
            payload[i] = self.options.payload_error * (tool.payload[i] - self.tare.payload[i]);
        }
        // Systematic errors add up linearly (worst case), standard deviations of independent noise by squares.
        let (noise, shared) = (balance.own_noise(), balance.shared_noise());
        let mut total = *uncertainty;
        for i in 0..n {
            total[i] += NOISE_SIGMAS * (noise[i] * noise[i] + shared[i].iter().map(|x| x * x).sum::<f64>()).sqrt();
        }
        let estimator = Estimator::new(&tool.rows, &total, &self.max_wrench, k, n);
        let (force, mut bound) = (estimator.apply(&external), estimator.bound(uncertainty));
        bound
            .iter_mut()
            .zip(estimator.noise(&noise, &shared))
            .for_each(|(bound, noise)| *bound += NOISE_SIGMAS * noise);
        // The payload error loads all joints in proportion, so its effects are not added with independent signs.
        bound.iter_mut().zip(estimator.apply(&payload)).for_each(|(bound, load)| *bound += load.abs());
        let residual_ratio =
            (0..n).fold(0.0_f64, |ratio, i| ratio.max((external[i].abs() - payload[i].abs()) / total[i]));
        let mut out = WrenchEstimate {
            torque_residual: external,
            torque_uncertainty: total,
            residual_ratio,
            ..WrenchEstimate::empty(n)
        };
        for (r, &axis) in self.axes.iter().enumerate() {
            (out.force[axis], out.uncertainty[axis]) = (force[r], bound[r]);
        }
        for axis in 0..MAX_AXES {
            let (block, row) = (axis / 3 * 3, axis % 3);
            out.uncertainty_base[axis] = 0.0;
            for column in 0..3 {
                let turn = tool.base_from_task[row][column];
                if turn.abs() > 1e-12 {
                    out.force_base[axis] += turn * out.force[block + column];
                    out.uncertainty_base[axis] += turn.abs() * out.uncertainty[block + column];
                }
            }
        }
        out
    }
}

impl History {
    /// Returns the command that the servos followed when the present reading was taken; `None` if it is not stored.
    /// `sent` is the newest command.
    fn at_reading(&self, sent: Option<&Sent>, delay: f64, dt: f64) -> Option<Sent> {
        let mut ago = 0;
        let mut passed = 0.5 * dt;
        while passed < delay && ago < HISTORY {
            passed += dt;
            ago += 1;
        }
        let Some(stored) = ago.checked_sub(usize::from(sent.is_some())) else { return sent.copied() };
        (ago < HISTORY && stored < self.count).then(|| self.sent[(self.newest + HISTORY - stored) % HISTORY])
    }

    fn push(&mut self, sent: Option<&Sent>) {
        if let Some(&sent) = sent {
            self.newest = (self.newest + 1) % HISTORY;
            self.sent[self.newest % HISTORY] = sent;
            self.count = (self.count + 1).min(HISTORY);
        }
    }
}

/// Returns the gravity torques [N·m] of the arm at `q` [rad], and computes its frames.
fn gravity(controller: &Controller, q: &JointVec, frames: &mut JointFrames) -> JointVec {
    let chain = controller.model().chain();
    let mut gravity = [0.0; MAX_JOINTS];
    chain.forward(q, frames);
    chain.gravity(frames, &controller.masses, controller.gravity, &mut gravity);
    gravity
}

/// Returns the command last sent: that of the input if given, else the controller's last command; `None` before its
/// first step.
fn sent(controller: &Controller, input: &ContactInput<'_>) -> Result<Option<Sent>> {
    if let Some([goal, limit]) = input.sent {
        let goal = controller.model().joints_within("goal", goal, COORDINATE_BOUND)?;
        let limit = controller.model().joints_within("torque_limit", limit, LOAD_BOUND)?;
        return Ok(Some(Sent { goal, limit }));
    }
    Ok(controller.state.limit.map(|limit| Sent { goal: controller.state.goal, limit }))
}
