//! Commands of a batch step are bit-identical to those of single steps, for random settings of all laws.

use std::sync::Arc;

use pliant_core::params::{
    Axis, CompliantSide, Damping, Follow, Law, NullSpace, PaperOptions, Projector, TorqueLimits, Tracking,
};
use pliant_core::{
    BatchInput, BatchState, Controller, Error, MAX_AXES, Model, ModelOptions, OnInvalid, Payload, Pose, Settings,
    SimdLevel, StepInput, Targets,
};

use crate::cases;
use crate::many::{ARMS, Arms, Out, bits, single};
use crate::seeded::{self, Random};

/// Returns controllers with random settings of all laws, for arms of seven and of five joints.
fn controllers(random: &mut Random, each: usize) -> Vec<Controller> {
    let mut all = Vec::new();
    for index in 0..3 {
        for law in [Law::Paper, Law::Cap, Law::Impedance] {
            for _ in 0..each {
                let model = seeded::arm(index, &ModelOptions::default());
                let servos = cases::servos(random, &seeded::servos(index), model.n());
                let settings = cases::settings(random, &model, law);
                let settings = cases::accepted_settings(&model, settings, Some(&servos));
                all.push(Controller::new(model, settings, Some(servos)).unwrap());
            }
        }
    }
    all
}

#[test]
fn with_a_state_each_row_equals_a_separate_controller() {
    let mut random = Random::new(5);
    let mut locked = 0;
    let mut all = controllers(&mut random, 4);
    all.extend(controllers_as_printed());
    for controller in all {
        let (model, n) = (Arc::clone(controller.model()), controller.model().n());
        let mut singles = vec![controller.clone(); ARMS];
        let mut state = BatchState::new(n, ARMS).unwrap();
        for tick in 0..6 {
            let arms = Arms::new(&mut random, &model, ARMS);
            let dt = random.pick(&[None, Some(0.004), Some(0.2)]);
            let input = arms.input(dt, tick % 3 == 1);
            let mut out = Out::new(ARMS, n);
            controller.step_batch(&input, Some(&mut state), out.command()).unwrap();
            for (row, single_controller) in singles.iter_mut().enumerate() {
                let (q, dq) = (&arms.q[row * n..][..n], &arms.dq[row * n..][..n]);
                let input = StepInput { dt, dq: (tick % 3 == 1).then_some(dq), ..StepInput::default() };
                let want = single(single_controller, q, &arms.poses[row], &input);
                assert_eq!(out.row(row, n), want, "arm {row}, tick {tick}, {:?}", controller.settings());
                locked += usize::from(single_controller.diagnostics().locked.contains(&true));
            }
            for row in (tick..ARMS).step_by(7) {
                let q = random.joints(&model, 0.8);
                singles[row].reset(&q).unwrap();
                state.reset(row, Some(&q)).unwrap();
            }
            for row in (tick..ARMS).step_by(11) {
                singles[row] = controller.clone();
                state.reset(row, None).unwrap();
            }
            let restored = BatchState::from_vec(n, state.as_slice().to_vec()).unwrap();
            assert_eq!(bits(restored.as_slice()), bits(state.as_slice()));
            state = restored;
        }
    }
    assert!(locked > 1000, "{locked} rows had a locked joint");
}

/// Returns controllers of law `paper` with the options of the paper; the other settings are random.
fn controllers_of_paper(random: &mut Random, each: usize) -> Vec<Controller> {
    let settings = |random: &mut Random, model: &Model| {
        let settings = cases::settings(random, model, Law::Paper);
        let damping = Damping::Fixed(random.pick(&[0.02, 0.05, 0.3]));
        Settings {
            tracking: Tracking { damping, ..settings.tracking },
            null_space: NullSpace { projector: Projector::Paper, ..settings.null_space },
            paper_options: PaperOptions {
                follow: Some(Follow::Hold),
                direction_band: random.pick(&[None, Some(0.5)]),
                ..settings.paper_options
            },
            ..settings
        }
    };
    let mut all = Vec::new();
    for index in 0..3 {
        for _ in 0..each {
            let model = seeded::arm(index, &ModelOptions::default());
            let servos = cases::servos(random, &seeded::servos(index), model.n());
            let settings = cases::accepted_settings(&model, settings(random, &model), Some(&servos));
            all.push(Controller::new(model, settings, Some(servos)).unwrap());
        }
    }
    all
}

/// Returns controllers of law `paper` as printed, whose step has no optional parts: with bounds on the rates of goals and
/// torque limits, and without.
fn controllers_as_printed() -> [Controller; 2] {
    let (model, paper) = (seeded::arm(0, &ModelOptions::default()), Settings::paper());
    let printed = |goal_slew, stiffening_time| Settings {
        tracking: Tracking { damping: Damping::Fixed(0.02), goal_slew, ..paper.tracking.clone() },
        torque_limits: TorqueLimits { stiffening_time, ..paper.torque_limits.clone() },
        null_space: NullSpace { projector: Projector::Paper, ..paper.null_space.clone() },
        ..paper.clone()
    };
    [printed(f64::INFINITY, 0.0), printed(0.5, 2.0)]
        .map(|settings| Controller::new(Arc::clone(&model), settings, Some(seeded::servos(0))).unwrap())
}

#[test]
fn without_a_state_each_row_is_a_first_step_without_speed_limit() {
    let mut random = Random::new(6);
    let (mut locked, mut rows) = (0, 0);
    let mut all = controllers(&mut random, 3);
    all.extend(controllers_of_paper(&mut random, 6));
    all.extend(controllers_as_printed());
    // The tool's speed is bounded by default.
    all.push(default_controller(&mut random, 1).0);
    for controller in all {
        let (model, n) = (Arc::clone(controller.model()), controller.model().n());
        let mut arms = Arms::new(&mut random, &model, ARMS);
        let bad = 1 + random.below(ARMS - 1);
        arms.q[n * bad] = f64::NAN;
        arms.flat[16 * (bad / 2) + random.below(12)] = f64::NAN;
        let free = Settings {
            max_tool_speed: [f64::INFINITY; 2],
            tracking: Tracking { goal_slew: f64::INFINITY, ..controller.settings().tracking.clone() },
            ..controller.settings().clone()
        };
        let fresh = Controller::new(model, free, controller.servos().cloned()).unwrap();
        for (simd_level, with_dq) in SimdLevel::available().into_iter().flat_map(|set| [(set, false), (set, true)]) {
            let (mut batch, mut out) = (controller.clone(), Out::new(ARMS, n));
            batch.set_simd_level(simd_level);
            let input = BatchInput { invalid: OnInvalid::Nan, ..arms.input(None, with_dq) };
            batch.step_batch(&input, None, out.command()).unwrap();
            for row in 0..ARMS {
                if row == bad || row == bad / 2 {
                    assert!(out.0.iter().all(|all| all[row * n..][..n].iter().all(|value| value.is_nan())));
                    continue;
                }
                let (q, dq) = (&arms.q[row * n..][..n], &arms.dq[row * n..][..n]);
                let input = StepInput { dq: with_dq.then_some(dq), ..StepInput::default() };
                let mut singles = fresh.clone();
                singles.set_simd_level(simd_level);
                let want = single(&mut singles, q, &arms.poses[row], &input);
                assert_eq!(out.row(row, n), want, "arm {row}, {simd_level}, {:?}", controller.settings());
                (locked, rows) = (locked + usize::from(singles.diagnostics().locked.contains(&true)), rows + 1);
            }
        }
    }
    assert!(rows > 10_000 && locked > 500, "{rows} rows, {locked} of them with a locked joint");
}

/// Returns a controller with default settings, and `count` arms for it.
fn default_controller(random: &mut Random, count: usize) -> (Controller, Arms) {
    let model = seeded::arm(0, &ModelOptions::default());
    let arms = Arms::new(random, &model, count);
    (Controller::new(model, Settings::default(), Some(seeded::servos(0))).unwrap(), arms)
}

/// A payload change is gradual in the controller itself; arms of a batch have the new payload immediately.
#[test]
fn a_batch_has_the_new_payload_at_once() {
    let mut random = Random::new(9);
    let (mut controller, arms) = default_controller(&mut random, 1);
    let (q, payload) = (arms.q.clone(), Payload { mass: 0.4, com: [0.0, 0.0, 0.05] });
    let batch = |controller: &Controller| {
        let mut out = Out::new(1, 7);
        controller.step_batch(&arms.input(None, false), None, out.command()).unwrap();
        out.row(0, 7)
    };
    let mut loaded = controller.clone();
    loaded.set_payload(Some(&payload)).unwrap();
    controller.step(&q, &arms.poses[0], &StepInput::default()).unwrap();
    controller.set_payload(Some(&payload)).unwrap();
    let without = batch(&default_controller(&mut Random::new(9), 1).0);
    assert_eq!(batch(&controller), batch(&loaded));
    assert_ne!(batch(&controller), without);
}

#[test]
fn new_settings_act_as_in_a_single_controller() {
    let mut random = Random::new(7);
    let (mut controller, arms) = default_controller(&mut random, ARMS);
    let (mut singles, mut state) = (vec![controller.clone(); ARMS], BatchState::new(7, ARMS).unwrap());
    let mut out = Out::new(ARMS, 7);
    for axes in ["all", "xyz", "y rpy"] {
        let task = pliant_core::params::Task::parse(axes).unwrap();
        let settings =
            Settings { task, tracking: Tracking { integrate: 0.5, ..Tracking::default() }, ..Settings::default() };
        controller.update(settings.clone()).unwrap();
        for single_controller in &mut singles {
            single_controller.update(settings.clone()).unwrap();
        }
        for _ in 0..3 {
            controller.step_batch(&arms.input(None, false), Some(&mut state), out.command()).unwrap();
            for (row, single_controller) in singles.iter_mut().enumerate() {
                let want = single(single_controller, &arms.q[row * 7..][..7], &arms.poses[row], &StepInput::default());
                assert_eq!(out.row(row, 7), want, "arm {row}, {axes}");
            }
        }
    }
}

#[test]
fn one_invalid_row_stops_the_batch_before_any_change() {
    let mut random = Random::new(8);
    for count in [1, 5, ARMS] {
        let (controller, mut arms) = default_controller(&mut random, count);
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
fn with_on_invalid_nan_valid_rows_are_stepped() {
    let mut random = Random::new(9);
    let (controller, mut arms) = default_controller(&mut random, ARMS);
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
        let restored = &state.as_slice()[row * width..][..width];
        if [0, 20, 63, 64, 149].contains(&row) {
            assert!(out.0.iter().all(|all| all[row * 7..][..7].iter().all(|value| value.is_nan())));
            assert!(restored.iter().all(|value| value.to_bits() == 0), "arm {row} has not been stepped");
        } else {
            assert_eq!(out.row(row, 7), good.row(row, 7));
            assert!(restored[0] > 0.0);
        }
    }
}

#[test]
fn targets_can_be_one_pose_or_positions() {
    let mut random = Random::new(10);
    let (controller, arms) = default_controller(&mut random, ARMS);
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
fn errors_name_inconsistent_lengths() {
    let mut random = Random::new(11);
    let (controller, arms) = default_controller(&mut random, 4);
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
fn invalid_states_are_rejected() {
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
fn arbitrary_state_numbers_give_finite_or_nan_commands() {
    let mut random = Random::new(12);
    let (controller, arms) = default_controller(&mut random, 40);
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

/// Returns random caps and adaptation (`ARMS` × 6) within the bounds of the controller; NaN for axes that do not yield.
fn row_axes(random: &mut Random, controller: &Controller) -> [Vec<f64>; 2] {
    let (mut caps, mut adaptation) = (Vec::new(), Vec::new());
    let strengths = controller.axis_strengths();
    for _ in 0..ARMS {
        let mut rows = strengths.iter();
        for axis in 0..MAX_AXES {
            let strength = controller.settings().task.axes[axis].then(|| rows.next().unwrap());
            let yields = controller.settings().axes[axis].compliant_side() != CompliantSide::None;
            let hold = strength.filter(|_| yields).map_or(f64::NAN, |strength| strength.hold);
            caps.push(random.pick(&[0.0, 0.3, 1.0]) * hold);
            adaptation.push(if hold.is_nan() { f64::NAN } else { random.pick(&[0.0, 0.5, 0.9]) });
        }
    }
    [caps, adaptation]
}

/// Returns the settings of a controller whose yielding axes have the caps and the adaptation of row `row`.
fn settings_of_row(controller: &Controller, caps: Option<&[f64]>, adaptation: Option<&[f64]>, row: usize) -> Settings {
    let (mut settings, strengths) = (controller.settings().clone(), controller.axis_strengths());
    let mut rows = strengths.iter();
    for axis in 0..MAX_AXES {
        let Some(strength) = settings.task.axes[axis].then(|| rows.next().unwrap()) else { continue };
        let user = &mut settings.axes[axis];
        let yields = user.compliant_side();
        if yields == CompliantSide::None {
            continue;
        }
        user.yields = Some(yields);
        if let Some(caps) = caps {
            (user.soft, user.firm) = (Some([caps[row * MAX_AXES + axis]; 2]), Some([caps[row * MAX_AXES + axis]; 2]));
            user.hold = Some(strength.hold);
        }
        if let Some(adaptation) = adaptation {
            user.adaptation = adaptation[row * MAX_AXES + axis];
        }
    }
    settings
}

#[test]
fn a_row_with_caps_and_adaptation_equals_a_separate_controller() {
    let (mut random, mut softened) = (Random::new(11), 0);
    for (index, controller) in controllers(&mut random, 3).into_iter().enumerate() {
        let (model, n) = (Arc::clone(controller.model()), controller.model().n());
        let [caps, adaptation] = row_axes(&mut random, &controller);
        let (caps, adaptation) = ((index % 3 != 1).then_some(&*caps), (index % 3 != 2).then_some(&*adaptation));
        let mut singles: Vec<Controller> = (0..ARMS)
            .map(|row| {
                let settings = settings_of_row(&controller, caps, adaptation, row);
                Controller::new(Arc::clone(&model), settings, controller.servos().cloned()).unwrap()
            })
            .collect();
        let free = |settings: &Settings| Settings {
            max_tool_speed: [f64::INFINITY; 2],
            tracking: Tracking { goal_slew: f64::INFINITY, ..settings.tracking.clone() },
            ..settings.clone()
        };
        let mut fresh = singles[ARMS - 1].clone();
        fresh.update(free(&settings_of_row(&controller, caps, adaptation, ARMS - 1))).unwrap();
        let mut state = BatchState::new(n, ARMS).unwrap();
        let (mut out, mut plain) = (Out::new(ARMS, n), Out::new(ARMS, n));
        for tick in 0..4 {
            let arms = Arms::new(&mut random, &model, ARMS);
            let input = BatchInput { caps, adaptation, ..arms.input(Some(0.01), false) };
            controller.step_batch(&input, Some(&mut state), out.command()).unwrap();
            for (row, single_controller) in singles.iter_mut().enumerate() {
                let step = StepInput { dt: Some(0.01), ..StepInput::default() };
                let want = single(single_controller, &arms.q[row * n..][..n], &arms.poses[row], &step);
                assert_eq!(out.row(row, n), want, "arm {row}, tick {tick}, {:?}", single_controller.settings());
            }
            controller.step_batch(&input, None, out.command()).unwrap();
            let (row, step) = (ARMS - 1, StepInput { dt: Some(0.01), ..StepInput::default() });
            let want = single(&mut fresh.clone(), &arms.q[row * n..], &arms.poses[row], &step);
            assert_eq!(out.row(row, n), want, "without a state, {:?}", fresh.settings());
            let input = BatchInput { caps: None, adaptation: None, ..input };
            controller.step_batch(&input, None, plain.command()).unwrap();
            softened += (0..ARMS).filter(|&row| out.row(row, n) != plain.row(row, n)).count();
        }
    }
    assert!(softened > 2000, "{softened} rows differ from those with the settings' caps");
}

#[test]
fn errors_name_row_and_axis_of_invalid_caps_and_adaptation() {
    let mut random = Random::new(12);
    let model = seeded::arm(0, &ModelOptions::default());
    let mut settings = Settings::default();
    settings.axes[1] = Axis { soft: Some([4.0; 2]), ..Axis::default() };
    settings.axes[5] = Axis { soft: Some([0.5; 2]), ..Axis::default() };
    let servos = pliant_core::Servos { stiffness_known: false, ..seeded::servos(0) };
    let controller = Controller::new(Arc::clone(&model), settings, Some(servos)).unwrap();
    let hold = controller.axis_strengths()[1].hold;
    let arms = Arms::new(&mut random, &model, 80);
    let (mut state, mut out) = (BatchState::new(7, 80).unwrap(), Out::new(80, 7));
    let none = f64::NAN;
    let good = [none, 3.0, none, none, none, 0.2].repeat(80);
    let eta = [none, 0.9, none, none, none, 0.0].repeat(80);
    let input = BatchInput { caps: Some(&good), adaptation: Some(&eta), ..arms.input(None, false) };
    controller.step_batch(&input, Some(&mut state), out.command()).unwrap();
    let before = bits(state.as_slice());
    let over = format!("caps[70]: y [N] = {} is outside [0, {hold}]: the axis holds with {hold} N", hold + 1.0);
    for (column, cap, adaptation, expected_start) in [
        (1, hold + 1.0, 0.9, &*over),
        (1, -0.5, 0.9, "caps[70]: y [N] = -0.5 is outside [0, "),
        (1, none, 0.9, "caps[70]: y [N] = NaN is outside [0, "),
        (5, f64::INFINITY, 0.0, "caps[70]: yaw [N·m] = inf is outside [0, "),
        (2, 5.0, none, "caps[70]: z: 5 has no effect, because the settings have no axis z that yields: use NaN"),
        (1, 3.0, 0.96, "adaptation[70]: y = 0.96 is outside [0, 0.95], the bound while k_p is not known"),
        (1, 3.0, none, "adaptation[70]: y = NaN is outside [0, 0.95]"),
        (5, 0.2, -0.1, "adaptation[70]: yaw = -0.1 is outside [0, 0.95]"),
        (0, none, 0.5, "adaptation[70]: x: 0.5 has no effect"),
    ] {
        let (mut caps, mut etas) = (good.clone(), eta.clone());
        (caps[70 * MAX_AXES + column], etas[70 * MAX_AXES + column]) = (cap, adaptation);
        let input = BatchInput { caps: Some(&caps), adaptation: Some(&etas), ..input };
        for with_state in [true, false] {
            let error = controller.step_batch(&input, with_state.then_some(&mut state), out.command()).unwrap_err();
            assert!(error.to_string().starts_with(expected_start), "{error}");
            assert_eq!(bits(state.as_slice()), before);
        }
        let input = BatchInput { invalid: OnInvalid::Nan, ..input };
        controller.step_batch(&input, None, out.command()).unwrap();
        assert!(out.0.iter().all(|all| all[70 * 7..][..7].iter().all(|value| value.is_nan())));
        assert!(out.0.iter().all(|all| all[..70 * 7].iter().all(|value| value.is_finite())));
    }
    for (caps, adaptation, what) in [(&good[6..], &*eta, "caps"), (&*good, &eta[..7], "adaptation")] {
        let input = BatchInput { caps: Some(caps), adaptation: Some(adaptation), ..input };
        let error = controller.step_batch(&input, None, out.command()).unwrap_err().to_string();
        assert!(error.starts_with(&format!("{what} has shape (")), "{error}");
    }
}
