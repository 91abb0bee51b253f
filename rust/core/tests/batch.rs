//! A batch step gives the commands of single steps for random settings of all laws: bit for bit, or up to rounding
//! where several arms are processed at once.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test may fail loudly, its helpers too")]

use std::sync::Arc;

use pliant_core::params::{Law, Tracking};
use pliant_core::{
    BatchInput, BatchState, Controller, Error, ModelOptions, OnInvalid, Pose, Settings, StepInput, Targets,
};

#[path = "oracle/cases.rs"]
mod cases;
#[path = "common/many.rs"]
mod many;
#[path = "common/seeded.rs"]
mod seeded;

use many::{ARMS, Arms, Out, bits, single};
use seeded::Random;

/// Returns controllers with random settings of all laws, for arms of seven and of five joints.
fn controllers(random: &mut Random, each: usize) -> Vec<Controller> {
    let mut all = Vec::new();
    for index in 0..3 {
        for law in [Law::Paper, Law::Cap, Law::Impedance] {
            for _ in 0..each {
                let model = seeded::arm(index, &ModelOptions::default());
                let servos = cases::servos(random, &seeded::servos(index), model.n());
                let settings = cases::settings(random, &model, law);
                let settings = cases::tamed(&model, settings, Some(&servos));
                all.push(Controller::new(model, settings, Some(servos)).unwrap());
            }
        }
    }
    all
}

#[test]
fn with_a_state_every_row_is_a_controller_of_its_own() {
    let mut random = Random::new(5);
    let mut locked = 0;
    for controller in controllers(&mut random, 4) {
        let (model, n) = (Arc::clone(controller.model()), controller.model().n());
        let mut alone = vec![controller.clone(); ARMS];
        let mut state = BatchState::new(n, ARMS).unwrap();
        for tick in 0..6 {
            let arms = Arms::new(&mut random, &model, ARMS);
            let dt = random.pick(&[None, Some(0.004), Some(0.2)]);
            let input = arms.input(dt, tick % 3 == 1);
            let mut out = Out::new(ARMS, n);
            controller.step_batch(&input, Some(&mut state), out.command()).unwrap();
            for (row, own) in alone.iter_mut().enumerate() {
                let (q, dq) = (&arms.q[row * n..][..n], &arms.dq[row * n..][..n]);
                let input = StepInput { dt, dq: (tick % 3 == 1).then_some(dq), ..StepInput::default() };
                let want = single(own, q, &arms.poses[row], &input);
                assert_eq!(out.row(row, n), want, "arm {row}, tick {tick}, {:?}", controller.settings());
                locked += usize::from(own.diagnostics().locked.contains(&true));
            }
            for row in (tick..ARMS).step_by(7) {
                let q = random.joints(&model, 0.8);
                alone[row].reset(&q).unwrap();
                state.reset(row, Some(&q)).unwrap();
            }
            for row in (tick..ARMS).step_by(11) {
                alone[row] = controller.clone();
                state.reset(row, None).unwrap();
            }
            let kept = BatchState::from_vec(n, state.as_slice().to_vec()).unwrap();
            assert_eq!(bits(kept.as_slice()), bits(state.as_slice()));
            state = kept;
        }
    }
    assert!(locked > 1000, "{locked} rows had a locked joint");
}

#[test]
fn without_a_state_every_row_is_a_first_step_without_slew() {
    let mut random = Random::new(6);
    for controller in controllers(&mut random, 3) {
        let (model, n) = (Arc::clone(controller.model()), controller.model().n());
        let arms = Arms::new(&mut random, &model, ARMS);
        let free = Settings {
            max_tool_speed: [f64::INFINITY; 2],
            tracking: Tracking { goal_slew: f64::INFINITY, ..controller.settings().tracking.clone() },
            ..controller.settings().clone()
        };
        let fresh = Controller::new(model, free, controller.servos().cloned()).unwrap();
        let mut out = Out::new(ARMS, n);
        for with_dq in [false, true] {
            controller.step_batch(&arms.input(None, with_dq), None, out.command()).unwrap();
            for row in 0..ARMS {
                let (q, dq) = (&arms.q[row * n..][..n], &arms.dq[row * n..][..n]);
                let input = StepInput { dq: with_dq.then_some(dq), ..StepInput::default() };
                let want = single(&mut fresh.clone(), q, &arms.poses[row], &input);
                let same = if controller.settings().law == Law::Paper {
                    out.is_near(row, n, &want)
                } else {
                    out.row(row, n) == want
                };
                assert!(same, "arm {row}, {:?}", controller.settings());
            }
        }
    }
}

/// Returns a controller with default settings, and `count` arms for it.
fn usual(random: &mut Random, count: usize) -> (Controller, Arms) {
    let model = seeded::arm(0, &ModelOptions::default());
    let arms = Arms::new(random, &model, count);
    (Controller::new(model, Settings::default(), Some(seeded::servos(0))).unwrap(), arms)
}

#[test]
fn other_settings_take_over_as_with_a_single_step() {
    let mut random = Random::new(7);
    let (mut controller, arms) = usual(&mut random, ARMS);
    let (mut alone, mut state) = (vec![controller.clone(); ARMS], BatchState::new(7, ARMS).unwrap());
    let mut out = Out::new(ARMS, 7);
    for axes in ["all", "xyz", "y rpy"] {
        let task = pliant_core::params::Task::parse(axes).unwrap();
        let settings =
            Settings { task, tracking: Tracking { integrate: 0.5, ..Tracking::default() }, ..Settings::default() };
        controller.update(settings.clone()).unwrap();
        for own in &mut alone {
            own.update(settings.clone()).unwrap();
        }
        for _ in 0..3 {
            controller.step_batch(&arms.input(None, false), Some(&mut state), out.command()).unwrap();
            for (row, own) in alone.iter_mut().enumerate() {
                let want = single(own, &arms.q[row * 7..][..7], &arms.poses[row], &StepInput::default());
                assert_eq!(out.row(row, 7), want, "arm {row}, {axes}");
            }
        }
    }
}

#[test]
fn one_row_that_cannot_be_used_stops_all_and_changes_nothing() {
    let mut random = Random::new(8);
    for count in [1, 5, ARMS] {
        let (controller, mut arms) = usual(&mut random, count);
        let (mut state, mut out) = (BatchState::new(7, count).unwrap(), Out::new(count, 7));
        controller.step_batch(&arms.input(None, false), Some(&mut state), out.command()).unwrap();
        let before = bits(state.as_slice());
        let (row, fine) = (count - 1, arms.q.clone());
        for bad in [f64::NAN, f64::INFINITY, 1e3] {
            arms.q[7 * row + 3] = bad;
            let error = controller.step_batch(&arms.input(None, false), Some(&mut state), out.command()).unwrap_err();
            assert!(error.to_string().starts_with(&format!("Q[{row}]: q[3] (elbow_pitch)")), "{error}");
            assert_eq!(bits(state.as_slice()), before);
            let error = controller.step_batch(&arms.input(None, false), None, out.command()).unwrap_err();
            assert!(error.to_string().starts_with(&format!("Q[{row}]: q[3] (elbow_pitch)")), "{error}");
        }
        arms.q = fine;
        arms.flat[16 * row] = 2.0;
        let error = controller.step_batch(&arms.input(None, false), Some(&mut state), out.command()).unwrap_err();
        assert!(error.to_string().starts_with(&format!("targets[{row}]: rotation part is not")), "{error}");
        arms.flat[16 * row + 15] = 2.0;
        let error = controller.step_batch(&arms.input(None, false), Some(&mut state), out.command()).unwrap_err();
        assert!(error.to_string().starts_with(&format!("targets[{row}]: last row of")), "{error}");
        let many = arms.poses.iter().flat_map(|pose| pose.to_rows().concat()).collect::<Vec<_>>();
        arms.flat = many;
        arms.dq[7 * row] = f64::NAN;
        let error = controller.step_batch(&arms.input(None, true), Some(&mut state), out.command()).unwrap_err();
        assert!(error.to_string().contains(&format!("[{row}]: dq[0] (")), "{error}");
        state.reset(row, Some(&[1e5; 7])).unwrap();
        let before = bits(state.as_slice());
        let error = controller.step_batch(&arms.input(None, false), Some(&mut state), out.command()).unwrap_err();
        assert!(error.to_string().starts_with(&format!("state[{row}]: q[0]")), "{error}");
        assert_eq!(bits(state.as_slice()), before);
    }
}

#[test]
fn where_asked_for_bad_rows_are_nan_and_the_others_are_stepped() {
    let mut random = Random::new(9);
    let (controller, mut arms) = usual(&mut random, ARMS);
    let (mut state, mut good, mut out) = (BatchState::new(7, ARMS).unwrap(), Out::new(ARMS, 7), Out::new(ARMS, 7));
    controller.step_batch(&arms.input(None, false), Some(&mut state.clone()), good.command()).unwrap();
    let width = state.as_slice().len() / ARMS;
    for row in [0, 63, 64, 149] {
        arms.q[7 * row + row % 7] = f64::NAN;
    }
    arms.flat[16 * 20 + 3] = f64::INFINITY;
    let input = BatchInput { invalid: OnInvalid::Nan, ..arms.input(None, false) };
    controller.step_batch(&input, Some(&mut state), out.command()).unwrap();
    for row in 0..ARMS {
        let kept = &state.as_slice()[row * width..][..width];
        if [0, 20, 63, 64, 149].contains(&row) {
            assert!(out.0.iter().all(|all| all[row * 7..][..7].iter().all(|value| value.is_nan())));
            assert!(kept.iter().all(|value| value.to_bits() == 0), "arm {row} has not been stepped");
        } else {
            assert_eq!(out.row(row, 7), good.row(row, 7));
            assert!(kept[0] > 0.0);
        }
    }
}

#[test]
fn one_target_for_all_and_positions_alone() {
    let mut random = Random::new(10);
    let (controller, arms) = usual(&mut random, ARMS);
    let settings = Settings { task: pliant_core::params::Task::parse("xyz").unwrap(), ..Settings::default() };
    let lateral = Controller::new(Arc::clone(controller.model()), settings, Some(seeded::servos(0))).unwrap();
    let positions: Vec<f64> = arms.poses.iter().flat_map(|pose| pose.position).collect();
    let mut out = Out::new(ARMS, 7);
    let one = BatchInput { targets: Targets::One(&arms.poses[2]), ..arms.input(None, false) };
    let lone = BatchInput { targets: Targets::Positions(&positions), ..one };
    for (controller, input) in [(&controller, &one), (&lateral, &lone)] {
        controller.step_batch(input, Some(&mut BatchState::new(7, ARMS).unwrap()), out.command()).unwrap();
        for row in 0..ARMS {
            let target = match input.targets {
                Targets::One(pose) => *pose,
                _ => Pose { position: arms.poses[row].position, ..Pose::IDENTITY },
            };
            let want = single(&mut controller.clone(), &arms.q[row * 7..][..7], &target, &StepInput::default());
            assert_eq!(out.row(row, 7), want, "arm {row}");
        }
    }
    let far = Pose { position: [f64::NAN, 0.0, 0.0], ..Pose::IDENTITY };
    let wrong = BatchInput { targets: Targets::One(&far), ..one };
    let error = controller.step_batch(&wrong, None, out.command()).unwrap_err();
    assert!(error.to_string().starts_with("targets: position x"), "{error}");
}

#[test]
fn lengths_that_do_not_fit_are_named() {
    let mut random = Random::new(11);
    let (controller, arms) = usual(&mut random, 4);
    let input = arms.input(None, false);
    let refused = |input: &BatchInput<'_>, sizes: [usize; 3], arms: usize, what: &str| {
        let mut out = Out(sizes.map(|size| vec![0.0; size]));
        let error =
            controller.step_batch(input, Some(&mut BatchState::new(7, arms).unwrap()), out.command()).unwrap_err();
        assert!(matches!(&error, Error::Shape { what: got, .. } if got == what), "{error}");
    };
    refused(&BatchInput { q: &arms.q[..27], ..input }, [28; 3], 4, "Q");
    refused(&BatchInput { targets: Targets::Poses(&arms.flat[..48]), ..input }, [28; 3], 4, "targets");
    refused(&BatchInput { targets: Targets::Positions(&arms.flat[..13]), ..input }, [28; 3], 4, "targets");
    refused(&BatchInput { dq: Some(&arms.q[..14]), ..input }, [28; 3], 4, "dq");
    refused(&input, [21, 28, 28], 4, "goal");
    refused(&input, [28, 29, 28], 4, "torque_limit");
    refused(&input, [28, 28, 0], 4, "velocity");
    refused(&input, [28; 3], 5, "state");
    let wrong = BatchInput { dt: Some(0.0), ..input };
    let error = controller.step_batch(&wrong, None, Out::new(4, 7).command()).unwrap_err();
    assert!(error.to_string().starts_with("dt [s] = 0"), "{error}");
    let none = BatchInput { q: &[], targets: Targets::Poses(&[]), ..input };
    controller.step_batch(&none, Some(&mut BatchState::new(7, 0).unwrap()), Out::new(0, 7).command()).unwrap();
}

#[test]
fn states_refuse_what_they_cannot_be() {
    assert!(BatchState::new(0, 3).is_err() && BatchState::new(17, 3).is_err());
    let error = BatchState::new(7, usize::MAX).unwrap_err();
    assert!(error.to_string().contains("bytes an arm"), "{error}");
    assert!(BatchState::new(7, usize::MAX / 4000).is_err());
    assert!(matches!(BatchState::from_vec(7, vec![0.0; 95]), Err(Error::Shape { .. })));
    let mut state = BatchState::new(5, 2).unwrap();
    assert_eq!((state.n(), state.len(), state.is_empty()), (5, 2, false));
    assert!(state.reset(2, None).is_err());
    assert!(matches!(state.reset(1, Some(&[0.0; 6])), Err(Error::Shape { .. })));
    assert!(state.reset(1, Some(&[f64::NAN; 5])).unwrap_err().to_string().starts_with("Q[1]: q"));
}

#[test]
fn numbers_that_no_step_has_written_harm_nobody() {
    let mut random = Random::new(12);
    let (controller, arms) = usual(&mut random, 40);
    let width = BatchState::new(7, 1).unwrap().as_slice().len();
    for _ in 0..200 {
        let numbers: Vec<f64> = (0..40 * width)
            .map(|i| if i % width == 0 { random.between(0.0, 64.0).floor() } else { f64::from_bits(random.next()) })
            .collect();
        let (mut state, mut out) = (BatchState::from_vec(7, numbers).unwrap(), Out::new(40, 7));
        let input = BatchInput { invalid: OnInvalid::Nan, ..arms.input(None, false) };
        controller.step_batch(&input, Some(&mut state), out.command()).unwrap();
        for (limit, goal) in out.0[1].iter().zip(&out.0[0]) {
            assert!(limit.is_nan() == goal.is_nan() && (limit.is_nan() || *limit >= 0.0));
        }
    }
}
