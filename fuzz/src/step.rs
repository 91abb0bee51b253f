//! Calls of a running controller with arbitrary numbers: each gives a valid command, or an error that changes nothing;
//! results agree between instruction sets.

use pliant_core::params::CompliantSide;
use pliant_core::{Controller, Error, Law, Payload, Pose, Result, SimdLevel, StepInput};

use super::arms::{CONTROLLERS, controller};
use super::checks::{assert_explained, assert_near, assert_sendable, bits, ceiling};
use super::input::Input;

/// Maximum number of calls in one run.
const CALLS: usize = 24;

/// Largest number in velocity, gradient, posture and twist for which instruction sets are compared.
const LARGEST_USUAL: f64 = 10.0;

/// One call of a controller, with its arguments.
#[derive(Debug)]
pub enum Call {
    Step { q: Vec<f64>, target: Pose, optional: Optional },
    StepJoints { q: Vec<f64>, q_target: Vec<f64>, optional: Optional },
    Reset(Vec<f64>),
    Payload(Option<Payload>),
    Gravity([f64; 3]),
    Delay(f64),
    CaptureGravity { q: Vec<f64>, goal: Vec<f64> },
}

/// Optional inputs of a step, as [`StepInput`] but owned.
#[derive(Debug)]
pub struct Optional {
    dt: Option<f64>,
    dq: Option<Vec<f64>>,
    twist: Option<[f64; 6]>,
    gradient: Option<Vec<f64>>,
    posture: Option<Vec<f64>>,
}

impl Optional {
    fn read(input: &mut Input, n: usize) -> Self {
        // The bits of one byte select the inputs that are present.
        let present = input.byte();
        let list =
            |bit: u8, input: &mut Input, usual: f64| (present >> bit & 1 == 1).then(|| input.vector(&vec![usual; n]));
        let (dq, gradient, posture) = (list(0, input, 0.1), list(1, input, 0.2), list(2, input, 0.1));
        Self {
            dt: (present >> 3 & 1 == 1).then(|| input.number(0.01)),
            dq,
            twist: (present >> 4 & 1 == 1).then(|| std::array::from_fn(|_| input.number(0.1))),
            gradient,
            posture,
        }
    }

    fn borrowed(&self) -> StepInput<'_> {
        StepInput {
            dt: self.dt,
            dq: self.dq.as_deref(),
            twist: self.twist.as_ref(),
            gradient: self.gradient.as_deref(),
            posture: self.posture.as_deref(),
        }
    }
}

/// Returns `usual` with up to three of its numbers replaced.
pub fn pose(input: &mut Input, usual: &Pose) -> Pose {
    let mut out = *usual;
    for _ in 0..input.below(4) {
        match input.below(12) {
            at @ 0..3 => out.position[at] = input.number(out.position[at]),
            at => out.rotation[at % 3][(at / 3 - 1) % 3] = input.number(out.rotation[at % 3][(at / 3 - 1) % 3]),
        }
    }
    out
}

impl Call {
    fn read(input: &mut Input, q: &[f64], target: &Pose) -> Self {
        match input.below(16) {
            0 => Self::Reset(input.vector(q)),
            1 => {
                Self::Payload(input.option(|input| Payload {
                    mass: input.number(0.2),
                    com: std::array::from_fn(|_| input.number(0.01)),
                }))
            }
            2 => Self::Gravity([input.number(0.0), input.number(0.0), input.number(-9.81)]),
            3 => Self::Delay(input.number(0.02)),
            4 => Self::CaptureGravity { q: input.vector(q), goal: input.vector(q) },
            5..8 => Self::StepJoints {
                q: input.vector(q),
                q_target: input.vector(q),
                optional: Optional::read(input, q.len()),
            },
            _ => {
                Self::Step { q: input.vector(q), target: pose(input, target), optional: Optional::read(input, q.len()) }
            }
        }
    }

    fn is_step(&self) -> bool {
        matches!(self, Self::Step { .. } | Self::StepJoints { .. })
    }

    /// Returns true if rounding errors stay below the documented tolerance. They exceed it for short periods, because
    /// accelerations are divided by the square of the period, and for large numbers that nearly cancel in the result.
    fn has_usual_numbers(&self) -> bool {
        let (Self::Step { optional, .. } | Self::StepJoints { optional, .. }) = self else { return true };
        let vectors = [&optional.dq, &optional.gradient, &optional.posture].into_iter().flatten().flatten();
        let usual = vectors.chain(optional.twist.iter().flatten()).all(|value| value.abs() <= LARGEST_USUAL);
        usual && optional.dt.is_none_or(|dt| dt >= 1e-3)
    }

    fn apply(&self, controller: &mut Controller) -> Result<()> {
        match self {
            Self::Step { q, target, optional } => controller.step(q, target, &optional.borrowed()).map(|_| ()),
            Self::StepJoints { q, q_target, optional } => {
                controller.step_joints(q, q_target, &optional.borrowed()).map(|_| ())
            }
            Self::Reset(q) => controller.reset(q),
            Self::Payload(payload) => controller.set_payload(payload.as_ref()),
            Self::Gravity(vector) => controller.set_gravity(*vector),
            Self::Delay(delay) => controller.set_delay(*delay),
            Self::CaptureGravity { q, goal } => controller.capture_gravity(q, goal).map(|_| ()),
        }
    }
}

/// Panics unless the next step of both controllers has bit-identical results.
pub fn assert_same_next(one: &Controller, other: &Controller, q: &[f64], target: &Pose, error: &Error) {
    let next = |controller: &Controller| {
        let mut controller = controller.clone();
        let command = controller.step(q, target, &StepInput::default()).map(bits);
        (command, format!("{:?} {:?}", controller.diagnostics(), controller.snapshot()))
    };
    assert_eq!(next(one), next(other), "the controller has changed after: {error}");
}

/// Runs calls on one controller.
pub fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let (arm, initial) = controller(input.below(CONTROLLERS));
    let levels = SimdLevel::available();
    let mut controller = initial.clone();
    controller.set_simd_level(input.pick(&levels));
    let other_level = input.pick(&levels);
    let ceiling = ceiling(&controller);
    let mut q = arm.q.clone();
    let mut target = arm.target;
    for _ in 0..CALLS {
        if input.is_empty() {
            break;
        }
        let call = Call::read(&mut input, &q, &target);
        let before = controller.clone();
        let result = call.apply(&mut controller);
        if let Err(error) = &result {
            assert_explained(error);
            assert_same_next(&controller, &before, &arm.q, &arm.target, error);
        } else if let (true, Some(command)) = (call.is_step(), controller.last_command()) {
            assert_sendable(command, &ceiling);
            // Later calls start from the inputs of accepted calls, so that the state moves away from the start.
            match &call {
                Call::Step { q: measured, target: accepted, .. } => (q, target) = (measured.clone(), *accepted),
                Call::StepJoints { q: measured, .. } => q.clone_from(measured),
                _ => {}
            }
        }
        if call.is_step() && other_level != controller.simd_level() {
            compare(&call, before, other_level, &controller, &result);
        }
    }
}

/// Panics unless the call has the same result with another instruction set: the same error, or, for usual numbers, a
/// command that agrees up to rounding.
fn compare(call: &Call, before: Controller, level: SimdLevel, controller: &Controller, result: &Result<()>) {
    let mut other = before;
    other.set_simd_level(level);
    // Compare texts, because an error that contains a NaN is not equal to itself.
    assert_eq!(
        format!("{result:?}"),
        format!("{:?}", call.apply(&mut other)),
        "{level} and {}",
        controller.simd_level()
    );
    if !call.has_usual_numbers() {
        return;
    }
    let [smallest, largest] = controller.sigma_range();
    if result.is_ok() && (smallest < SINGULAR * largest || is_undetermined(controller, &other)) {
        return;
    }
    if let (Ok(()), Some(got), Some(want)) = (result, other.last_command(), controller.last_command()) {
        assert_near(|| format!("goal after {call:?} with {level}"), got.goal(), want.goal());
        // The limits that bound the force after a host loss are found by bisection: rounding may end it at another
        // step.
        if controller.settings().torque_limits.max_host_loss_force.is_none() {
            assert_near(
                || format!("torque_limit after {call:?} with {level}"),
                got.torque_limit(),
                want.torque_limit(),
            );
        }
        assert_near(|| format!("speed_limit after {call:?} with {level}"), got.speed_limit(), want.speed_limit());
    }
}

/// Largest deviation [m, rad] that can be zero plus rounding errors.
const ROUNDED_ZERO: f64 = 1e-12;

/// Ratio of the smallest to the largest singular value below which rounding errors exceed the tolerance; they grow with
/// the inverse square of this ratio.
const SINGULAR: f64 = 0.01;

/// Length [m/rad] of a Jacobian row below which rounding errors change its direction by more than the tolerance.
const SHORT_ROW: f64 = 1e-4;

/// Returns true if rounding errors determine the torque limits of law `paper`.
///
/// Without a direction band, which is the default, the sign of the deviation selects the strength of an axis that
/// yields to one side only. For an axis that no joint moves, the shares of the joints are ratios of rounding errors.
fn is_undetermined(one: &Controller, other: &Controller) -> bool {
    let settings = one.settings();
    if settings.law != Law::Paper {
        return false;
    }
    let (one, other) = (one.diagnostics(), other.diagnostics());
    let axes = settings.axes.iter().zip(settings.task.axes).filter(|(_, on)| *on).map(|(axis, _)| axis);
    axes.enumerate().any(|(r, axis)| {
        let (a, b) = (one.deviation[r], other.deviation[r]);
        let one_sided = matches!(axis.compliant_side(), CompliantSide::Plus | CompliantSide::Minus);
        let switches = one_sided
            && settings.paper_options.direction_band.unwrap_or(0.0) <= 0.0
            && (a < 0.0) != (b < 0.0)
            && a.abs().max(b.abs()) < ROUNDED_ZERO;
        switches || one.rows[r].iter().map(|x| x * x).sum::<f64>().sqrt() < SHORT_ROW
    })
}
