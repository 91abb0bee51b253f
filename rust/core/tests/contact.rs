//! The contact estimate equals the true wrench if the model is exact, stays within its bound otherwise, and rejects
//! invalid input.

use std::sync::Arc;

use pliant_core::params::{Frame, Task};
use pliant_core::{ContactEstimator, ContactInput, ContactOptions, Controller, Model, Reference, Servos, Settings};

use crate::common;

const GRASP: [f64; 7] = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];
const KP: [f64; 7] = [150.0, 150.0, 150.0, 150.0, 60.0, 60.0, 60.0];
const FRICTION: [f64; 7] = [0.2, 0.2, 0.2, 0.2, 0.1, 0.1, 0.1];
const WIDE: [f64; 7] = [100.0; 7];

fn servos() -> Servos {
    let torque = vec![10.7, 10.7, 10.7, 10.7, 6.4, 6.4, 6.4];
    Servos { friction: FRICTION.to_vec(), stiffness_known: true, ..Servos::new(KP.to_vec(), torque) }
}

fn controller_with(settings: Settings, servos: Servos) -> Controller {
    Controller::new(Arc::new(common::arm7()), settings, Some(servos)).unwrap()
}

fn controller() -> Controller {
    controller_with(Settings::default(), servos())
}

/// Returns the options for an exact model: all errors are 0. Tests change single errors.
fn exact_options() -> ContactOptions {
    ContactOptions {
        friction_error: 0.0,
        kp_error: Some(0.0),
        gravity_error: 0.0,
        inertia_error: 0.0,
        ..ContactOptions::default()
    }
}

fn noise(seed: usize) -> f64 {
    2.0 * (((seed + 1) as f64 * 12.9898).sin() * 43_758.545_3).fract().abs() - 1.0
}

/// Returns a random wrench in base axes, up to 10 N and 2 N·m.
fn wrench(seed: usize) -> [f64; 6] {
    std::array::from_fn(|k| noise(seed * 31 + k) * if k < 3 { 10.0 } else { 2.0 })
}

/// Returns the servo torques [N·m] that hold the arm against gravity and a wrench, without friction.
fn holding_torque(model: &Model, q: &[f64], wrench: &[f64; 6]) -> Vec<f64> {
    let (jacobian, gravity) = (model.jacobian(q, Reference::WorldAligned).unwrap(), model.gravity(q).unwrap());
    (0..model.n()).map(|i| gravity[i] - (0..6).map(|k| jacobian[(k, i)] * wrench[k]).sum::<f64>()).collect()
}

fn goal(q: &[f64], torque: &[f64]) -> Vec<f64> {
    q.iter().zip(torque).zip(KP).map(|((q, torque), kp)| q + torque / kp).collect()
}

/// Returns force and error bound in base axes [N, N·m] after 100 readings of an arm at rest with these goals and
/// limits.
fn settled_estimate(
    contact: &mut ContactEstimator,
    ctl: &Controller,
    q: &[f64],
    goal: &[f64],
    limit: &[f64],
) -> ([f64; 6], [f64; 6]) {
    let input = ContactInput { sent: Some([goal, limit]), ..ContactInput::default() };
    let mut last = ([0.0; 6], [0.0; 6]);
    for _ in 0..100 {
        let estimate = contact.update(ctl, q, &input).unwrap();
        last = (estimate.force_base, estimate.uncertainty_base);
    }
    last
}

fn assert_within(estimate: &[f64; 6], truth: &[f64; 6], bound: &[f64; 6]) {
    for k in 0..6 {
        let error = (estimate[k] - truth[k]).abs();
        assert!(error <= bound[k] + 1e-9, "axis {k}: {} for {}, bound {}", estimate[k], truth[k], bound[k]);
    }
}

#[test]
fn with_an_exact_model_the_estimate_is_exact() {
    let ctl = controller_with(Settings::default(), Servos { friction: vec![0.0], ..servos() });
    let mut contact = ContactEstimator::new(&ctl, exact_options()).unwrap();
    for seed in 0..60 {
        let (q, truth) = (common::state(ctl.model(), seed), wrench(seed));
        contact.reset();
        let torque = holding_torque(ctl.model(), &q, &truth);
        let (estimate, bound) = settled_estimate(&mut contact, &ctl, &q, &goal(&q, &torque), &WIDE);
        assert_within(&estimate, &truth, &bound);
        if bound.iter().all(|b| *b < 0.5) {
            (0..6).for_each(|k| assert!((estimate[k] - truth[k]).abs() < 0.02, "{estimate:?} {truth:?}"));
        }
    }
}

#[test]
fn a_saturated_servo_exerts_its_limit() {
    let ctl = controller_with(Settings::default(), Servos { friction: vec![0.0], ..servos() });
    let mut contact = ContactEstimator::new(&ctl, exact_options()).unwrap();
    let truth = wrench(3);
    let torque = holding_torque(ctl.model(), &GRASP, &truth);
    let (mut goal, mut limit) = (goal(&GRASP, &torque), WIDE);
    for i in [0, 2, 5] {
        limit[i] = torque[i].abs();
        goal[i] += 0.5_f64.copysign(torque[i]);
    }
    let (estimate, bound) = settled_estimate(&mut contact, &ctl, &GRASP, &goal, &limit);
    assert_within(&estimate, &truth, &bound);
    let saturated = contact.estimate().saturated;
    assert_eq!(&saturated[..7], &[true, false, true, false, false, true, false]);
}

#[test]
fn friction_at_rest_stays_within_the_bound() {
    let ctl = controller();
    let mut contact = ContactEstimator::new(&ctl, exact_options()).unwrap();
    for seed in 0..100 {
        let (q, truth) = (common::state(ctl.model(), seed), wrench(seed));
        let mut torque = holding_torque(ctl.model(), &q, &truth);
        // At rest, friction can have any value up to its maximum; the extreme values give the largest error.
        for (i, value) in torque.iter_mut().enumerate() {
            *value += FRICTION[i] * noise(seed * 17 + i).signum();
        }
        contact.reset();
        let (estimate, bound) = settled_estimate(&mut contact, &ctl, &q, &goal(&q, &torque), &WIDE);
        assert_within(&estimate, &truth, &bound);
    }
}

#[test]
fn errors_of_k_p_gravity_and_payload_stay_within_the_bound() {
    let ctl = controller();
    let options = ContactOptions { kp_error: Some(0.11), gravity_error: 0.1, payload_error: 0.3, ..exact_options() };
    let mut contact = ContactEstimator::new(&ctl, options).unwrap();
    for seed in 0..100 {
        let (q, mut truth) = (common::state(ctl.model(), seed), wrench(seed));
        let expected = truth;
        truth[2] -= 0.3 * 9.81 * noise(seed + 7).abs();
        let believed = holding_torque(ctl.model(), &q, &truth);
        // The true stiffness is k_p (1 + share), so the same lead exerts more torque by that factor.
        let torque: Vec<f64> =
            believed.iter().enumerate().map(|(i, t)| t / (1.0 + 0.1 * noise(seed * 13 + i))).collect();
        contact.reset();
        let (estimate, bound) = settled_estimate(&mut contact, &ctl, &q, &goal(&q, &torque), &WIDE);
        assert_within(&estimate, &expected, &bound);
    }
}

#[test]
fn a_measured_load_replaces_lead_and_limit() {
    let ctl = controller_with(Settings::default(), Servos { friction: vec![0.0], ..servos() });
    let options = ContactOptions { load_error: 0.0, torque_constant: Some(vec![2.0; 7]), ..exact_options() };
    let mut contact = ContactEstimator::new(&ctl, options).unwrap();
    let truth = wrench(5);
    let load = holding_torque(ctl.model(), &GRASP, &truth);
    let current: Vec<f64> = load.iter().map(|torque| torque / 2.0).collect();
    for input in [
        ContactInput { load: Some(&load), ..ContactInput::default() },
        ContactInput { current: Some(&current), ..ContactInput::default() },
    ] {
        contact.reset();
        for _ in 0..50 {
            contact.update(&ctl, &GRASP, &input).unwrap();
        }
        assert_within(&contact.estimate().force_base, &truth, &contact.estimate().uncertainty_base);
        assert!(contact.estimate().uncertainty_base[0] < 0.1);
    }
}

#[test]
fn a_goal_acts_after_the_delay() {
    let mut ctl = controller_with(Settings::default(), Servos { friction: vec![0.0], ..servos() });
    ctl.set_delay(0.02).unwrap();
    let mut contact = ContactEstimator::new(&ctl, ContactOptions { filter: 0.0, ..exact_options() }).unwrap();
    let quiet = goal(&GRASP, &holding_torque(ctl.model(), &GRASP, &[0.0; 6]));
    let pushed = goal(&GRASP, &holding_torque(ctl.model(), &GRASP, &[0.0, 5.0, 0.0, 0.0, 0.0, 0.0]));
    let force = |contact: &mut ContactEstimator, goal: &[f64]| {
        let input = ContactInput { sent: Some([goal, &WIDE]), dq: Some(&[0.0; 7]), ..ContactInput::default() };
        let estimate = contact.update(&ctl, &GRASP, &input).unwrap();
        (estimate.force_base[1], estimate.uncertainty_base[1])
    };
    assert!(force(&mut contact, &quiet).1.is_infinite(), "the command in force is not known yet");
    assert!(force(&mut contact, &quiet).1.is_infinite());
    assert!(force(&mut contact, &quiet).0.abs() < 0.01);
    assert!(force(&mut contact, &pushed).0.abs() < 0.01, "just sent");
    assert!(force(&mut contact, &quiet).0.abs() < 0.01, "the goal does not act before the delay");
    assert!((force(&mut contact, &quiet).0 - 5.0).abs() < 0.01, "in force now");
    assert!(force(&mut contact, &quiet).0.abs() < 0.01);
}

#[test]
fn a_tare_removes_constant_errors() {
    let ctl = controller();
    let options = ContactOptions { kp_error: Some(0.2), ..exact_options() };
    let mut contact = ContactEstimator::new(&ctl, options).unwrap();
    assert!(contact.tare().unwrap_err().to_string().contains("there is no estimate yet"));
    let wrong = |truth: &[f64; 6]| -> Vec<f64> {
        holding_torque(ctl.model(), &GRASP, truth).iter().map(|torque| torque / 1.15).collect()
    };
    let (off, loose) = settled_estimate(&mut contact, &ctl, &GRASP, &goal(&GRASP, &wrong(&[0.0; 6])), &WIDE);
    assert!(off[2].abs() > 1.0, "k_p wrong by 15 % feels like a weight: {off:?}");
    contact.tare().unwrap();
    assert!(contact.is_tared());
    let truth = [0.0, 0.0, 6.0, 0.0, 0.0, 0.0];
    let (estimate, bound) = settled_estimate(&mut contact, &ctl, &GRASP, &goal(&GRASP, &wrong(&truth)), &WIDE);
    assert_within(&estimate, &truth, &bound);
    assert!((estimate[2] - 6.0 / 1.15).abs() < 0.05, "{estimate:?}");
    assert!(bound[2] < loose[2] + 2.0 * 2.3, "friction counts twice, k_p no longer: {bound:?} {loose:?}");
    contact.clear_tare();
    let (again, _) = settled_estimate(&mut contact, &ctl, &GRASP, &goal(&GRASP, &wrong(&[0.0; 6])), &WIDE);
    assert!((again[2] - off[2]).abs() < 1e-6);
}

#[test]
fn unobservable_axes_are_uncertain_but_not_noisy() {
    let ctl = controller();
    let contact = ContactEstimator::new(&ctl, exact_options()).unwrap();
    let stretched = [0.0; 7];
    let bound = contact.uncertainty_at(&ctl, &stretched).unwrap();
    assert!(bound.iter().any(|b| *b > 90.0), "the arm cannot sense a force along its straight axis: {bound:?}");
    assert!(bound.iter().all(|b| b.is_finite()));
    let easy = contact.uncertainty_at(&ctl, &GRASP).unwrap();
    assert!(easy[..3].iter().all(|b| *b < 3.0), "{easy:?}");
}

#[test]
fn forces_are_given_in_the_task_frame() {
    let rotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    let task = Task { frame: Frame::Rotation(rotation), ..Task::default() };
    let ctl = controller_with(Settings { task, ..Settings::default() }, servos());
    let mut contact = ContactEstimator::new(&ctl, exact_options()).unwrap();
    let truth = [0.0, 5.0, 0.0, 0.0, 0.0, 0.0];
    let (base, _) = settled_estimate(
        &mut contact,
        &ctl,
        &GRASP,
        &goal(&GRASP, &holding_torque(ctl.model(), &GRASP, &truth)),
        &WIDE,
    );
    assert!((base[1] - 5.0).abs() < 0.05);
    assert!((contact.estimate().force[0] - 5.0).abs() < 0.05, "the base's y is the task's x");
}

#[test]
fn a_threshold_below_the_uncertainty_is_rejected_with_the_bound() {
    let ctl = controller();
    let mut options = ContactOptions { touch: [None, None, Some(0.5), None, None, None], ..exact_options() };
    let text = ContactEstimator::new(&ctl, options.clone()).unwrap_err().to_string();
    assert!(text.starts_with("touch.z [N] = 0.5 is outside [") && text.contains("accept"), "{text}");
    options.accept_thresholds = true;
    assert!(ContactEstimator::new(&ctl, options).is_ok());
    let crossed = ContactOptions { touch: [Some(9.0); 6], stop: [Some(8.0); 6], ..exact_options() };
    assert!(ContactEstimator::new(&ctl, crossed).unwrap_err().to_string().contains("at or above the touch"));
    let elsewhere = ContactOptions {
        axes: Some([true, false, false, false, false, false]),
        touch: [Some(30.0); 6],
        ..exact_options()
    };
    assert!(ContactEstimator::new(&ctl, elsewhere).unwrap_err().to_string().contains("not among the estimated axes"));
}

#[test]
fn invalid_input_is_rejected_and_changes_nothing() {
    let ctl = controller();
    let mut contact = ContactEstimator::new(&ctl, ContactOptions::default()).unwrap();
    let good = goal(&GRASP, &holding_torque(ctl.model(), &GRASP, &wrench(1)));
    settled_estimate(&mut contact, &ctl, &GRASP, &good, &WIDE);
    let before = *contact.estimate();
    let strange = [f64::NAN, f64::INFINITY, -f64::INFINITY, 1e308, -1e7];
    for value in strange {
        for place in 0..7 {
            let mut bad = GRASP;
            bad[place] = value;
            let sent = ContactInput { sent: Some([&good, &WIDE]), ..ContactInput::default() };
            assert!(contact.update(&ctl, &bad, &sent).is_err());
            let inputs = [
                ContactInput { load: Some(&bad), ..sent },
                ContactInput { dq: Some(&bad), ..sent },
                ContactInput { sent: Some([&bad, &WIDE]), ..sent },
                ContactInput { sent: Some([&good, &bad]), ..sent },
                ContactInput { dt: Some(value), ..sent },
                ContactInput { current: Some(&GRASP), ..sent },
                ContactInput { load: Some(&GRASP[..3]), ..sent },
            ];
            for input in inputs {
                assert!(contact.update(&ctl, &GRASP, &input).is_err(), "{input:?}");
            }
        }
    }
    assert_eq!(before, *contact.estimate());
    // The largest accepted numbers give finite results, and a reset removes their effect.
    let large = [1e6; 7];
    for dt in [1e-300, 1.0] {
        let input = ContactInput { load: Some(&large), dt: Some(dt), ..ContactInput::default() };
        let estimate = *contact.update(&ctl, &GRASP, &input).unwrap();
        assert!(estimate.force.iter().chain(&estimate.uncertainty).all(|x| x.is_finite()));
    }
    contact.reset();
    let (estimate, _) = settled_estimate(&mut contact, &ctl, &GRASP, &good, &WIDE);
    (0..6).for_each(|k| assert!((estimate[k] - before.force_base[k]).abs() < 1e-3));
}

#[test]
fn errors_name_invalid_options() {
    let ctl = controller();
    let cases = [
        (ContactOptions { filter: -1.0, ..exact_options() }, "filter [s] = -1"),
        (ContactOptions { friction_error: f64::NAN, ..exact_options() }, "friction_error = NaN"),
        (ContactOptions { max_wrench: [0.0, 1.0], ..exact_options() }, "max_wrench (force)"),
        (ContactOptions { guard: 1.5, ..exact_options() }, "guard = 1.5"),
        (ContactOptions { hysteresis: 1.0, ..exact_options() }, "hysteresis = 1"),
        (ContactOptions { torque_constant: Some(vec![1.0]), ..exact_options() }, "torque_constant has shape (1,)"),
        (ContactOptions { axes: Some([false; 6]), ..exact_options() }, "no axis given"),
    ];
    for (options, text) in cases {
        let error = ContactEstimator::new(&ctl, options).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
    }
    let blind = Controller::new(
        Arc::new(common::arm7()),
        Settings { law: pliant_core::params::Law::Paper, gravity: false, ..Settings::default() },
        None,
    );
    assert!(
        ContactEstimator::new(&blind.unwrap(), exact_options())
            .unwrap_err()
            .to_string()
            .contains("give the controller servos")
    );
}

/// Returns the numbers of reading `k`.
fn row(array: Option<&[f64]>, k: usize) -> Option<&[f64]> {
    array.map(|array| &array[k * 7..][..7])
}

#[test]
fn a_series_has_the_numbers_of_its_readings_one_by_one() {
    let ctl = controller_with(Settings { delay: 0.02, ..Settings::default() }, servos());
    let count = 12;
    let series = |scale: f64, shift: usize| -> Vec<f64> {
        (0..count * 7).map(|i| GRASP[i % 7] + scale * noise(i + shift)).collect()
    };
    let (q, goal) = (series(0.01, 0), series(0.1, 500));
    let velocity: Vec<f64> = (0..count * 7).map(|i| noise(i + 700)).collect();
    let load: Vec<f64> = (0..count * 7).map(|i| 5.0 * noise(i + 900)).collect();
    let limit = [8.0; 12 * 7];
    let sent = Some([&goal[..], &limit[..]]);
    let inputs = [
        ContactInput { sent, dt: Some(0.01), ..ContactInput::default() },
        ContactInput { load: Some(&load), ..ContactInput::default() },
        ContactInput { sent, dq: Some(&velocity), ..ContactInput::default() },
    ];
    let mut eventful = ContactOptions { accept_thresholds: true, min_time: 0.05, ..exact_options() };
    eventful.touch[2] = Some(1.0);
    for options in [exact_options(), ContactOptions { payload_error: 0.1, ..ContactOptions::default() }, eventful] {
        for input in inputs {
            let mut single = ContactEstimator::new(&ctl, options.clone()).unwrap();
            let mut several = single.clone();
            for k in 0..count {
                let one_reading = ContactInput {
                    dq: row(input.dq, k),
                    load: row(input.load, k),
                    sent: input.sent.map(|sent| sent.map(|array| &array[k * 7..][..7])),
                    ..input
                };
                single.update(&ctl, &q[k * 7..][..7], &one_reading).unwrap();
            }
            assert_eq!(several.update_series(&ctl, &q, &input).unwrap(), single.estimate());
            single.tare().unwrap();
            several.tare().unwrap();
            single.update_series(&ctl, &q, &input).unwrap();
            assert_eq!(several.update_series(&ctl, &q, &input).unwrap(), single.estimate());
        }
    }
}

#[test]
fn a_series_with_an_invalid_reading_leaves_the_estimate() {
    let ctl = controller();
    let mut contact = ContactEstimator::new(&ctl, exact_options()).unwrap();
    let torque = holding_torque(ctl.model(), &GRASP, &wrench(1));
    settled_estimate(&mut contact, &ctl, &GRASP, &goal(&GRASP, &torque), &WIDE);
    let before = *contact.estimate();
    let (mut q, limit) = ([GRASP, GRASP, GRASP].concat(), [100.0; 21]);
    for (part, broken) in [(20, false), (0, false), (21, true)] {
        q[16] = if broken { f64::NAN } else { GRASP[2] };
        let sent = Some([&limit[..], &limit[..]]);
        let input = ContactInput { sent, ..ContactInput::default() };
        assert!(contact.update_series(&ctl, &q[..part], &input).is_err());
        assert_eq!(*contact.estimate(), before);
    }
    // The next update begins without commands.
    let input = ContactInput { sent: Some([&GRASP, &WIDE]), ..ContactInput::default() };
    assert!(contact.update(&ctl, &GRASP, &input).is_ok());
}
