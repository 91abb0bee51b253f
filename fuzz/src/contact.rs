//! Contact estimates from arbitrary readings: finite, or an error that leaves the estimate unchanged.

use pliant_core::{ContactEstimator, ContactInput, ContactOptions, StepInput, WrenchEstimate};

use super::arms::{CONTROLLERS, controller};
use super::checks::assert_explained;
use super::input::Input;

/// Maximum number of readings in one run.
const READINGS: usize = 24;

/// Creates an estimator and updates it beside a running controller.
pub fn run(data: &[u8]) {
    let mut input = Input::new(data);
    let (arm, initial) = controller(input.below(CONTROLLERS));
    let n = arm.model.n();
    let mut controller = initial.clone();
    let usual = ContactOptions::default();
    let options = ContactOptions {
        filter: input.number(usual.filter),
        friction_error: input.number(usual.friction_error),
        kp_error: input.option(|input| input.number(0.2)),
        payload_error: input.number(0.0),
        inertia_error: input.number(usual.inertia_error),
        torque_constant: input.option(|input| input.vector(&vec![1.2; n])),
        touch: [input.option(|input| input.number(20.0)), None, None, None, None, None],
        hysteresis: input.number(usual.hysteresis),
        min_time: input.number(usual.min_time),
        accept_thresholds: input.flag(),
        ..usual
    };
    let mut estimator = match ContactEstimator::new(&controller, options) {
        Ok(estimator) => estimator,
        Err(error) => return assert_explained(&error),
    };
    for _ in 0..READINGS {
        if input.is_empty() {
            break;
        }
        let q = input.vector(&arm.q);
        let present = input.byte();
        let mut list = |bit: u8, usual: f64| (present >> bit & 1 == 1).then(|| input.vector(&vec![usual; n]));
        let (dq, load, current, goal, limit) = (list(0, 0.1), list(1, 0.5), list(2, 0.3), list(3, 0.2), list(4, 2.0));
        let reading = ContactInput {
            dt: (present >> 5 & 1 == 1).then(|| input.number(0.01)),
            dq: dq.as_deref(),
            load: load.as_deref(),
            current: current.as_deref(),
            sent: goal.as_deref().zip(limit.as_deref()).map(|(goal, limit)| [goal, limit]),
        };
        let before = *estimator.estimate();
        match estimator.update(&controller, &q, &reading) {
            Ok(estimate) => assert_finite(estimate),
            Err(error) => {
                assert_explained(&error);
                assert_eq!(format!("{before:?}"), format!("{:?}", estimator.estimate()), "changed after: {error}");
            }
        }
        match present >> 6 {
            1 => drop(estimator.tare().map_err(|error| assert_explained(&error))),
            2 => estimator.clear_tare(),
            3 => estimator.reset(),
            _ => {}
        }
        if controller.step(&q, &arm.target, &StepInput::default()).is_err() {
            controller.step(&arm.q, &arm.target, &StepInput::default()).unwrap();
        }
    }
}

fn assert_finite(estimate: &WrenchEstimate) {
    let forces = estimate.force.iter().chain(&estimate.force_base);
    assert!(forces.chain(&estimate.torque_residual).all(|value| value.is_finite()), "{estimate:?}");
    let bounds = estimate.uncertainty.iter().chain(&estimate.uncertainty_base).chain(&estimate.torque_uncertainty);
    assert!(bounds.chain([&estimate.residual_ratio]).all(|value| *value >= 0.0), "{estimate:?}");
}
