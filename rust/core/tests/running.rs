//! Tests of changes while the controller runs: settings, payload, gravity, delay, captured gravity offset, integration.

use std::sync::Arc;

use pliant_core::params::{Axis, Compensation, CompliantSide, Damping, Frame, Gain, Law, NullSpace, Task, Tracking};
use pliant_core::{Controller, Model, ModelOptions, Payload, Pose, Servos, Settings, Snapshot, StepInput};

use crate::seeded::{self, Random};

/// The grasp posture [rad].
const Q: [f64; 7] = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];

fn arm() -> Arc<Model> {
    seeded::arm(0, &ModelOptions::default())
}

fn soft_y(adaptation: f64) -> Settings {
    let mut settings = Settings::default();
    settings.set_axes("y", Axis { yields: Some(CompliantSide::Both), adaptation, ..Axis::default() }).unwrap();
    settings
}

fn make(settings: Settings) -> (Arc<Model>, Controller, Pose) {
    let model = arm();
    let controller = Controller::new(Arc::clone(&model), settings, Some(seeded::servos(0))).unwrap();
    let target = model.forward_kinematics(&Q).unwrap();
    (model, controller, target)
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |max, (x, y)| max.max((x - y).abs()))
}

/// A straight arm cannot move along its own direction. A reference that moves in this direction must not use up the
/// torque of the other axis.
#[test]
fn a_reference_along_a_straight_arm_does_not_take_torque_from_the_other_axis() {
    let urdf = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/robots/planar_2r.urdf");
    let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
    let model = Arc::new(Model::from_urdf_file(urdf, &options).unwrap());
    let servos = Servos {
        damping: vec![1.0],
        armature: vec![0.01],
        stiffness_known: true,
        ..Servos::new(vec![150.0], vec![60.0])
    };
    for law in [Law::Cap, Law::Impedance] {
        let task = Task { axes: [true, false, true, false, false, false], frame: Frame::Tool, length: Some(0.2) };
        let settings = Settings { law, task, ..Settings::default() };
        for elbow in [0.01, 1e-3, 1e-4, 1e-6, 1e-9, 1e-16, 0.0] {
            let mut controller = Controller::new(Arc::clone(&model), settings.clone(), Some(servos.clone())).unwrap();
            let q = [-0.9, elbow];
            let mut target = model.forward_kinematics(&q).unwrap();
            for i in 0..3 {
                target.position[i] += 0.2 * target.rotation[i][0];
            }
            for _ in 0..20 {
                controller.step(&q, &target, &StepInput::default()).unwrap();
            }
            let (factors, wrench) = (controller.diagnostics().factors, controller.diagnostics().wrench);
            assert!(factors[2] > 0.999, "{law:?}, elbow {elbow:e}: the stiff axes have {} of their lead", factors[2]);
            assert!(wrench[0].abs() < 100.0, "{law:?}, elbow {elbow:e}: {} N along the arm", wrench[0]);
        }
    }
}

#[test]
fn goals_are_rate_limited_from_reset_and_the_first_limit_is_not() {
    let (_, mut controller, target) = make(Settings::default());
    let goal_and_limit = |controller: &mut Controller| {
        let command = *controller.step(&Q, &target, &StepInput::default()).unwrap();
        (command.goal().to_vec(), command.torque_limit().to_vec())
    };
    let (goal, limit) = goal_and_limit(&mut controller);
    // The gravity offset of the first joint exceeds 0.01 rad, so its goal has moved by the speed limit of 0.01 rad per
    // step.
    assert!((goal[0] - (Q[0] - 0.01)).abs() < 1e-12, "{goal:?}");
    let gravity = controller.diagnostics().gravity;
    for i in 0..7 {
        assert!(limit[i] >= 1.1 * gravity[i].abs(), "{limit:?}");
    }
    // The torque limits of a soft axis fall immediately, and rise from zero to the ceiling in 0.2 s.
    let far = {
        let mut pose = target;
        pose.position[2] += 0.1;
        pose
    };
    let mut open = Controller::new(
        arm(),
        Settings { max_tool_speed: [f64::INFINITY; 2], ..Settings::default() },
        Some(seeded::servos(0)),
    )
    .unwrap();
    open.step(&Q, &target, &StepInput::default()).unwrap();
    let mut before = limit.clone();
    let mut rose = false;
    for _ in 0..30 {
        let limit = open.step(&Q, &far, &StepInput::default()).unwrap().torque_limit().to_vec();
        for (i, (now, then)) in limit.iter().zip(&before).enumerate() {
            let ceiling = if i < 4 { 10.7 } else { 6.4 };
            assert!(now - then <= ceiling / 0.2 * 0.01 + 1e-12 && *now <= ceiling);
            rose |= now - then > 0.9 * ceiling / 0.2 * 0.01;
        }
        before = limit;
    }
    assert!(rose);
    let relaxed = open.step(&Q, &target, &StepInput::default()).unwrap().torque_limit().to_vec();
    assert!(largest_difference(&relaxed, &limit) < 1e-9, "{relaxed:?} {limit:?}");
}

#[test]
fn new_settings_move_goals_at_the_limited_rate() {
    let mut random = Random::new(5);
    let model = arm();
    let mut controller = Controller::new(Arc::clone(&model), Settings::default(), Some(seeded::servos(0))).unwrap();
    controller.reset(&Q).unwrap();
    let target = random.target(&model, &Q, 0.05, 0.2);
    let mut goal = Q.to_vec();
    let mut q = Q.to_vec();
    for round in 0..400 {
        if round % 7 == 0 {
            let task = Task {
                axes: random.pick(&[
                    [true; 6],
                    [true, true, true, false, false, false],
                    [false, true, true, false, true, false],
                ]),
                frame: random.pick(&[Frame::Base, Frame::Tool]),
                length: None,
            };
            let mut settings = Settings {
                law: random.pick(&[Law::Cap, Law::Impedance, Law::Paper]),
                max_tool_speed: random.pick(&[[0.25, 1.0], [f64::INFINITY; 2], [0.01, 0.05]]),
                task,
                tracking: Tracking { integrate: random.pick(&[0.0, 2.0]), ..Tracking::default() },
                gravity: random.pick(&[true, false]),
                ..Settings::default()
            };
            settings.axes[1] =
                Axis { yields: Some(random.pick(&[CompliantSide::Both, CompliantSide::None])), ..Axis::default() };
            controller.update(settings).unwrap();
        }
        if round % 11 == 0 {
            controller.set_payload(Some(&Payload { mass: random.unit(), com: [0.0; 3] })).unwrap();
            controller.set_delay(0.02 * random.unit()).unwrap();
            controller.set_gravity([random.between(-3.0, 3.0), 0.0, -9.0]).unwrap();
        }
        let command = *controller.step(&q, &target, &StepInput::default()).unwrap();
        assert!(largest_difference(command.goal(), &goal) <= 0.01 + 1e-12, "round {round}");
        goal = command.goal().to_vec();
        // The arm moves half of the distance to its goals.
        for (position, goal) in q.iter_mut().zip(&goal) {
            *position += 0.5 * (goal - *position);
        }
    }
}

/// Deviation along y after an update from `from` to `to`, with the target `away` [m] from a resting tool; then the force
/// and the deviation at the next step.
fn after_update(from: Settings, to: Settings, away: f64) -> (f64, [f64; 2]) {
    let (_, mut controller, mut target) = make(from);
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    target.position[1] += away;
    for _ in 0..200 {
        controller.step(&Q, &target, &StepInput::default()).unwrap();
    }
    let before = controller.diagnostics().wrench[1];
    controller.update(to).unwrap();
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    let now = controller.diagnostics();
    (before, [now.wrench[1], now.deviation[1]])
}

#[test]
fn an_axis_that_becomes_firmer_restarts_its_reference_where_its_force_is_unchanged() {
    let capped = |law, cap: f64| {
        let mut settings = Settings { law, ..Settings::default() };
        let stiffness = matches!(law, Law::Impedance).then_some([400.0; 2]);
        let axis = Axis { soft: Some([cap; 2]), firm: Some([cap; 2]), stiffness, ..Axis::default() };
        settings.set_axes("y", axis).unwrap();
        settings
    };
    for law in [Law::Cap, Law::Impedance] {
        let firm = || Settings { law, ..Settings::default() };
        for away in [0.15, -0.15] {
            // From a free axis the reference restarts at the tool, and moves by at most 1 m/s² · (10 ms)².
            let (_, [_, deviation]) = after_update(capped(law, 1e-3), firm(), away);
            assert!(deviation.abs() < 2e-4, "{law:?}: {deviation}");
            // A larger force cap acts as the tool lags behind the reference, not at once.
            let (before, [force, deviation]) = after_update(capped(law, 2.0), capped(law, 20.0), away);
            assert!((before.abs() - 2.0).abs() < 1e-9, "{law:?}: {before}");
            assert!(force / before >= 0.8 && force / before < 1.6, "{law:?}: {before} N, then {force} N");
            assert!(deviation * away > 0.0 && deviation.abs() < 0.05, "{law:?}: {deviation}");
            // An axis that keeps its settings or becomes softer keeps its reference.
            for to in [capped(law, 20.0), capped(law, 1.0)] {
                let (_, [_, deviation]) = after_update(capped(law, 20.0), to, away);
                assert!((deviation - away).abs() < 1e-12, "{law:?}: {deviation}");
            }
        }
    }
    let paper = |budget: f64| {
        let mut settings = Settings { max_tool_speed: [0.25, 1.0], ..Settings::paper() };
        settings.set_axes("y", Axis { soft: Some([budget; 2]), firm: Some([budget; 2]), ..Axis::default() }).unwrap();
        settings
    };
    let (_, [_, deviation]) = after_update(paper(1e-4), paper(1.0), 0.15);
    assert!(deviation.abs() < 5e-3, "{deviation}");
    // The strengths of law `paper` cannot be compared with forces: all axes restart at the tool.
    let (_, [_, deviation]) = after_update(capped(Law::Cap, 20.0), paper(1.0), 0.15);
    assert!(deviation.abs() < 2e-4, "{deviation}");
}

#[test]
fn an_axis_that_joins_or_leaves_the_task_or_turns_with_its_frame_restarts_its_reference() {
    let only =
        |axes: &str, frame| Settings { task: Task { frame, ..Task::parse(axes).unwrap() }, ..Settings::default() };
    let (_, [_, deviation]) = after_update(only("x z", Frame::Base), only("xyz", Frame::Base), 0.15);
    assert!(deviation.abs() < 2e-4, "{deviation}");
    // The free y axis of the base is the stiff x axis of the turned frame.
    let turned = Frame::Rotation([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
    let (_, mut controller, mut target) = make(only("x z", Frame::Base));
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    target.position[1] += 0.15;
    for _ in 0..200 {
        controller.step(&Q, &target, &StepInput::default()).unwrap();
    }
    controller.update(only("x y z", turned)).unwrap();
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    assert!(controller.diagnostics().deviation[0].abs() < 2e-4, "{:?}", controller.diagnostics().deviation);
}

#[test]
fn a_force_cap_that_rises_at_every_step_does_not_let_go() {
    let capped = |cap: f64| {
        let mut settings = Settings::default();
        settings.set_axes("y", Axis { soft: Some([cap; 2]), firm: Some([cap; 2]), ..Axis::default() }).unwrap();
        settings
    };
    let (_, mut controller, mut target) = make(capped(5.0));
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    target.position[1] += 0.15;
    for _ in 0..200 {
        controller.step(&Q, &target, &StepInput::default()).unwrap();
    }
    let mut last = controller.diagnostics().wrench[1];
    for tick in 1..=100 {
        controller.update(capped(5.0 + 0.1 * f64::from(tick))).unwrap();
        controller.step(&Q, &target, &StepInput::default()).unwrap();
        let force = controller.diagnostics().wrench[1];
        assert!(force >= 0.99 * last, "tick {tick}: {last} N, then {force} N");
        last = force;
    }
}

#[test]
fn a_lowered_tool_speed_takes_effect_at_once() {
    let (_, mut controller, mut target) = make(Settings { max_tool_speed: [f64::INFINITY; 2], ..Settings::default() });
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    target.position[1] += 0.2;
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    controller.update(Settings { max_tool_speed: [0.1, 0.5], ..Settings::default() }).unwrap();
    let mut before = controller.diagnostics().deviation;
    target.position[1] -= 0.4;
    for _ in 0..100 {
        controller.step(&Q, &target, &StepInput::default()).unwrap();
        let now = controller.diagnostics().deviation;
        assert!((now[1] - before[1]).abs() <= 0.1 * 0.01 + 1e-9, "{now:?} {before:?}");
        before = now;
    }
}

#[test]
fn changes_of_payload_gravity_and_delay_take_effect_and_persist() {
    let (_, mut controller, target) = make(Settings::default());
    let payload = Payload { mass: 0.4, com: [0.01, 0.0, 0.03] };
    let vector = [1.0, -2.0, -9.0];
    controller.set_payload(Some(&payload)).unwrap();
    controller.set_gravity(vector).unwrap();
    controller.update(soft_y(0.0)).unwrap();
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    let loaded = seeded::arm(0, &ModelOptions { payload: Some(payload), gravity: vector, ..ModelOptions::default() });
    let want = loaded.gravity(&Q).unwrap();
    assert!(largest_difference(&controller.diagnostics().gravity[..7], want.as_slice()) < 1e-12);
    controller.set_payload(None).unwrap();
    for _ in 0..=50 {
        controller.step(&Q, &target, &StepInput::default()).unwrap();
    }
    let want = seeded::arm(0, &ModelOptions { gravity: vector, ..ModelOptions::default() }).gravity(&Q).unwrap();
    assert!(largest_difference(&controller.diagnostics().gravity[..7], want.as_slice()) < 1e-12);

    // q̂ = q + γ b_p T_d v. The delay remains after a change of other settings and after a reset.
    controller.set_delay(0.02).unwrap();
    controller.update(soft_y(0.5)).unwrap();
    controller.reset(&Q).unwrap();
    let dq = [0.5; 7];
    controller.step(&Q, &target, &StepInput { dq: Some(&dq), ..StepInput::default() }).unwrap();
    let ahead = controller.diagnostics().q[0] - Q[0];
    assert!((ahead - 0.9 * 0.02 * 0.5).abs() < 1e-12, "{ahead}");
    for wrong in [-1e-9, 0.51, f64::NAN] {
        assert!(controller.set_delay(wrong).is_err());
    }
    assert!(controller.set_payload(Some(&Payload { mass: -1.0, com: [0.0; 3] })).is_err());
    assert!(controller.set_gravity([0.0, f64::NAN, 0.0]).is_err());
}

#[test]
fn a_payload_that_would_throw_a_running_arm_is_rejected() {
    let (_, mut controller, target) = make(Settings::default());
    let payload = |mass| Payload { mass, com: [0.0; 3] };
    // The heaviest payload that a controller accepts before its first step: the servos hold it in some pose.
    let mut loads = (1..30).map(|mass| payload(f64::from(mass)));
    let heaviest = &loads.rfind(|load| make(Settings::default()).1.set_payload(Some(load)).is_ok()).unwrap();
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    let before = controller.snapshot();
    let error = controller.set_payload(Some(heaviest)).unwrap_err().to_string();
    assert!(error.contains("2 times the torque of its servo") && error.contains("mass [kg]"), "{error}");
    assert_eq!(controller.snapshot(), before);
    controller.set_payload(Some(&payload(0.5))).unwrap();
    // A smaller load than the present one is accepted, and so is any load if gravity is not compensated.
    let mut loaded = make(Settings::default()).1;
    loaded.set_payload(Some(heaviest)).unwrap();
    loaded.step(&Q, &target, &StepInput::default()).unwrap();
    loaded.set_payload(Some(&payload(0.9 * heaviest.mass))).unwrap();
    let (_, mut printed, target) = make(Settings { law: Law::Paper, gravity: false, ..Settings::default() });
    printed.step(&Q, &target, &StepInput::default()).unwrap();
    printed.set_payload(Some(heaviest)).unwrap();
}

#[test]
fn a_payload_change_takes_half_a_second() {
    let (_, mut controller, target) = make(Settings::default());
    let payload = Payload { mass: 0.4, com: [0.02, 0.03, 0.05] };
    let weight = |controller: &Controller| controller.diagnostics().gravity[1];
    let tick = |controller: &mut Controller, count: usize| {
        (0..count).for_each(|_| {
            controller.step(&Q, &target, &StepInput::default()).unwrap();
        });
        weight(controller)
    };
    let unloaded_torque = tick(&mut controller, 1);
    controller.set_payload(Some(&payload)).unwrap();
    let loaded = seeded::arm(0, &ModelOptions { payload: Some(payload), ..ModelOptions::default() });
    let payload_torque = loaded.gravity(&Q).unwrap()[1] - unloaded_torque;
    assert!(
        (tick(&mut controller, 1) - unloaded_torque).abs() < 1e-12,
        "the first step after the change uses the previous payload"
    );
    // The ramp takes 50 ticks of 10 ms, also in a controller restored from a snapshot.
    let half = tick(&mut controller, 25) - unloaded_torque;
    assert!((half / payload_torque - 0.5).abs() < 1e-9, "{half} of {payload_torque}");
    let (model, settings) = (Arc::clone(controller.model()), controller.settings().clone());
    let mut other =
        Controller::from_snapshot(model, settings, Some(seeded::servos(0)), &controller.snapshot()).unwrap();
    for count in [1, 10, 20] {
        assert_eq!(tick(&mut controller, count).to_bits(), tick(&mut other, count).to_bits());
    }
    assert!(((tick(&mut controller, 1) - unloaded_torque) / payload_torque - 1.0).abs() < 1e-12);
    // A payload removed during the ramp starts a new ramp at the present value; a reset ends the ramp.
    controller.set_payload(None).unwrap();
    let before = tick(&mut controller, 11);
    assert!(((before - unloaded_torque) / payload_torque - 0.8).abs() < 1e-9);
    controller.set_payload(Some(&payload)).unwrap();
    assert!(((tick(&mut controller, 26) - unloaded_torque) / payload_torque - 0.89).abs() < 1e-9);
    controller.reset(&Q).unwrap();
    assert!(((tick(&mut controller, 1) - unloaded_torque) / payload_torque - 1.0).abs() < 1e-12);
    let mut wrong = controller.snapshot();
    wrong.payload_ramp = Some([f64::NAN; 5]);
    assert!(Controller::from_snapshot(Arc::clone(controller.model()), Settings::default(), None, &wrong).is_err());
}

#[test]
fn removing_a_payload_that_is_not_there_changes_nothing() {
    let (_, mut controller, target) = make(Settings::default());
    let mut other = controller.clone();
    for tick in 0..80 {
        if tick == 1 {
            controller.set_payload(None).unwrap();
        }
        let command = *controller.step(&Q, &target, &StepInput::default()).unwrap();
        assert_eq!(command, *other.step(&Q, &target, &StepInput::default()).unwrap(), "tick {tick}");
    }
}

/// Settings for servos without inertia, friction and damping: no feed-forward of friction and damping.
fn frictionless() -> Settings {
    Settings {
        max_tool_speed: [f64::INFINITY; 2],
        null_space: NullSpace { posture: Some(Q.to_vec()), ..NullSpace::default() },
        compensation: Compensation { friction: 0.0, damping: 0.0, ..Compensation::default() },
        ..Settings::default()
    }
}

/// Returns the positions at which ideal servos with the stiffness `kp` [N·m/rad] rest: `k (goal − q) = g(q)`.
fn settle(model: &Model, kp: &[f64; 7], goal: &[f64]) -> Vec<f64> {
    let mut q = goal.to_vec();
    for _ in 0..200 {
        let gravity = model.gravity(&q).unwrap();
        for i in 0..7 {
            q[i] += 0.3 * (goal[i] - gravity[i] / kp[i] - q[i]);
        }
    }
    q
}

const BELIEVED: [f64; 7] = [150.0, 150.0, 150.0, 150.0, 60.0, 60.0, 60.0];

/// Runs `ticks` steps; after each, the arm rests at its new equilibrium.
fn hold(
    model: &Model,
    controller: &mut Controller,
    kp: &[f64; 7],
    target: &Pose,
    q: &mut Vec<f64>,
    ticks: usize,
) -> Vec<f64> {
    let mut goal = q.clone();
    for _ in 0..ticks {
        goal = controller.step(q, target, &StepInput::default()).unwrap().goal().to_vec();
        *q = settle(model, kp, &goal);
    }
    goal
}

fn position_error(model: &Model, q: &[f64], target: &Pose) -> f64 {
    largest_difference(&model.forward_kinematics(q).unwrap().position, &target.position)
}

#[test]
fn the_integrating_goal_removes_the_steady_error() {
    let model = arm();
    let kp = BELIEVED.map(|k| 0.75 * k);
    let mut errors = [0.0; 2];
    for (slot, integrate) in [0.0, 2.0].into_iter().enumerate() {
        let (_, mut controller, target) =
            make(Settings { tracking: Tracking { integrate, ..frictionless().tracking }, ..frictionless() });
        let mut q = Q.to_vec();
        controller.reset(&q).unwrap();
        hold(&model, &mut controller, &kp, &target, &mut q, 1500);
        errors[slot] = position_error(&model, &q, &target);
    }
    assert!(errors[0] > 2e-3 && errors[1] < 2e-5, "{errors:?}");
}

#[test]
fn settings_without_integration_drop_the_stored_lead() {
    let with =
        |integrate: f64| Settings { tracking: Tracking { integrate, ..frictionless().tracking }, ..frictionless() };
    let (_, mut controller, mut target) = make(with(2.0));
    let (_, mut plain, _) = make(with(0.0));
    target.position[2] += 0.01;
    let run = |controller: &mut Controller, ticks: usize| {
        (0..ticks).for_each(|_| {
            controller.step(&Q, &target, &StepInput::default()).unwrap();
        });
        controller.last_command().unwrap().goal().to_vec()
    };
    let (stored, without) = (run(&mut controller, 100), run(&mut plain, 100));
    assert!(largest_difference(&stored, &without) > 5e-3);
    let (mut twin, mut same) = (controller.clone(), controller.clone());
    same.update(Settings { gravity: true, ..with(2.0) }).unwrap();
    assert!(largest_difference(&run(&mut same, 5), &run(&mut twin, 5)) < 1e-9, "other settings keep the lead");
    controller.update(with(0.0)).unwrap();
    assert!(largest_difference(&run(&mut controller, 100), &without) < 1e-9);
}

#[test]
fn the_integrator_stores_no_lead_on_soft_axes() {
    let (_, mut controller, mut target) = make(Settings {
        max_tool_speed: [f64::INFINITY; 2],
        tracking: Tracking { integrate: 2.0, ..soft_y(0.0).tracking },
        ..soft_y(0.0)
    });
    target.position[1] += 0.05;
    target.position[2] += 0.003;
    let mut goal = Vec::new();
    for _ in 0..60 {
        goal = controller.step(&Q, &target, &StepInput::default()).unwrap().goal().to_vec();
    }
    // Wrench that the lead without its gravity part exerts: W of the law plus the wrench of the stored lead.
    let (rows, record) = (controller.task_jacobian(), controller.diagnostics());
    let lead = nalgebra::DVector::from_fn(7, |i, _| goal[i] - Q[i] - record.gravity[i] / BELIEVED[i]);
    let compliance =
        nalgebra::DMatrix::from_fn(6, 6, |r, c| (0..7).map(|i| rows[(r, i)] * rows[(c, i)] / BELIEVED[i]).sum());
    let wrench = compliance.lu().solve(&(&rows * lead)).unwrap();
    assert!((wrench[1] - record.wrench[1]).abs() < 0.02 * record.wrench[1].abs(), "{wrench} {:?}", record.wrench);
    assert!(wrench[2] > 2.0 * record.wrench[2], "z is stiff and has stored: {wrench} {:?}", record.wrench);
}

#[test]
fn the_integrated_lead_is_bounded_by_the_torque_limit() {
    let (_, mut controller, mut target) =
        make(Settings { tracking: Tracking { integrate: 5.0, ..Tracking::default() }, ..Settings::default() });
    target.position[2] += 0.05;
    let mut goal = Vec::new();
    for _ in 0..3000 {
        goal = controller.step(&Q, &target, &StepInput::default()).unwrap().goal().to_vec();
    }
    let torque = [10.7, 10.7, 10.7, 10.7, 6.4, 6.4, 6.4];
    for i in 0..7 {
        // The stored lead uses at most the torque that gravity leaves; the lead of the law is added to it.
        assert!((goal[i] - Q[i]).abs() <= 2.0 * torque[i] / BELIEVED[i] + 1e-9, "joint {i}: {goal:?}");
    }
}

/// At a deviation limit the reference moves with the tool, so that an integrated lead would grow without reducing the
/// deviation.
#[test]
fn nothing_is_integrated_at_a_deviation_limit() {
    let growth = |offset: f64| {
        let tracking = Tracking { integrate: 0.5, ..Tracking::default() };
        let mut settings = Settings { tracking, ..Settings::default() };
        settings.axes[2].deviation_limit = Some(0.01);
        let (_, mut controller, mut target) = make(settings);
        target.position[2] += offset;
        let goals: Vec<Vec<f64>> =
            (0..150).map(|_| controller.step(&Q, &target, &StepInput::default()).unwrap().goal().to_vec()).collect();
        assert_eq!(controller.diagnostics().deviation_limited[2], offset > 0.01);
        largest_difference(&goals[149], &goals[99])
    };
    assert!(growth(0.009) > 1e-3 && growth(0.03) < 1e-9, "{} {}", growth(0.009), growth(0.03));
}

/// One joint about y, whose tool is at 0.5 m along x and weighs 0.5 kg.
const LEVER: &str = r#"<robot name="lever"><link name="base"/><link name="tool"><inertial><mass value="0.5"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
    <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="8" velocity="3"/></joint><link name="arm"/>
    <joint name="out" type="fixed"><parent link="arm"/><child link="tool"/><origin xyz="0.5 0 0"/></joint></robot>"#;

/// The stored lead of a joint exerts at most the torque that gravity leaves, and at most the force `hold` along z.
#[test]
fn the_stored_lead_is_bounded_by_gravity_and_by_hold() {
    let model = Arc::new(Model::from_urdf_str(LEVER, &ModelOptions::default()).unwrap());
    let gravity = model.gravity(&[0.0]).unwrap()[0];
    assert!((gravity + 0.5 * 0.5 * 9.81).abs() < 1e-9, "{gravity}");
    let stored = |hold: f64, up: f64| {
        let tracking = Tracking { integrate: 5.0, ..Tracking::default() };
        let mut settings = Settings { task: Task::parse("z").unwrap(), tracking, ..Settings::default() };
        settings.axes[2].hold = Some(hold);
        let servos = Servos::new(vec![100.0], vec![8.0]);
        let mut controller = Controller::new(Arc::clone(&model), settings, Some(servos)).unwrap();
        let mut target = model.forward_kinematics(&[0.0]).unwrap();
        target.position[2] += up;
        for _ in 0..1000 {
            controller.step(&[0.0], &target, &StepInput::default()).unwrap();
        }
        // The stored lead exerts the torque of the whole lead minus gravity and minus JᵀW of the law's wrench W. JᵀW is
        // −0.5 W, because a turn about y lowers the tool.
        let goal = controller.last_command().unwrap().goal()[0];
        assert!((100.0 * goal).abs() <= 8.0 + 1e-9, "the whole lead exerts at most the usable torque: {goal}");
        let wrench = controller.diagnostics().wrench[0];
        let stored = 100.0 * goal - gravity + 0.5 * wrench;
        // The torque limit covers gravity, wrench and stored lead, plus a margin of a tenth of the usable torque.
        let demand = (gravity - 0.5 * wrench.clamp(-hold, hold) + stored).abs().max(1.1 * gravity.abs());
        let limit = controller.last_command().unwrap().torque_limit()[0];
        assert!((limit - (demand + 0.8).min(8.0)).abs() < 1e-9, "{limit} {demand}");
        assert_eq!(controller.diagnostics().saturated[0], demand + 0.8 > 8.0);
        stored
    };
    // The stored lead leaves 1.1 times the gravity torque.
    let usable = 8.0 - 1.1 * gravity.abs();
    for side in [-1.0, 1.0] {
        let (strong, weak) = (-side * stored(100.0, 0.05 * side), -side * stored(2.0, 0.05 * side));
        assert!((strong - usable).abs() < 1e-9, "{side}: {strong} {usable}");
        // `hold` allows 2 N at 0.5 m, that is 1 N·m; the damping λ of the inverse kinematics leaves somewhat more.
        assert!(weak > 0.9 && weak < 1.4, "{side}: {weak}");
    }
}

/// The reference of a stiff axis has a velocity v and an acceleration a. In addition to the force for the deviation, the
/// axis exerts `(t² a + t_d (v − J dq)) / C`: `t² = I/k_p` for the inertia I, and `t_d` is the time constant of a damper.
/// The friction of the joint is compensated in the direction in which the reference moves it. An axis that yields exerts
/// the force for the deviation only.
#[test]
fn a_stiff_axis_exerts_the_force_for_the_velocity_and_acceleration_of_its_reference() {
    let options = ModelOptions { gravity: [0.0; 3], ..ModelOptions::default() };
    let model = Arc::new(Model::from_urdf_str(LEVER, &options).unwrap());
    let (kp, lever, horizon, friction, damping, lambda) = (100.0, -0.5, 0.25, 0.2, 0.5, 0.1);
    let inertia = 0.5 * lever * lever;
    let servos = Servos {
        friction: vec![friction],
        damping: vec![damping],
        stiffness_known: true,
        ..Servos::new(vec![kp], vec![8.0])
    };
    let rest = model.forward_kinematics(&[0.0]).unwrap();
    let mut target = rest;
    target.position[2] += 0.1;
    for (law, yields) in [Law::Cap, Law::Impedance, Law::Paper]
        .into_iter()
        .flat_map(|law| [(law, CompliantSide::None), (law, CompliantSide::Both)])
    {
        for (acceleration, dq) in [(1.0, 0.0), (1.0, 0.05), (2.0, -0.03), (20.0, 0.0)] {
            let mut settings = Settings { law, task: Task::parse("z").unwrap(), ..Settings::default() };
            settings.tracking.goal_slew = f64::INFINITY;
            settings.tracking.damping = Damping::Fixed(lambda);
            settings.max_tool_acceleration = [acceleration, 4.0];
            settings.tracking.gain = Gain::Scalar(2.0);
            settings.paper_options.horizon = horizon;
            let strength = (yields == CompliantSide::Both).then_some([10.0; 2]);
            settings.axes[2] =
                Axis { yields: Some(yields), soft: strength, firm: strength, hold: Some(10.0), ..Axis::default() };
            if law == Law::Impedance {
                settings.axes[2].stiffness = Some([300.0; 2]);
            }
            let late = settings.delay + 0.5 / settings.rate + settings.tracking.velocity_filter;
            let ahead = settings.compensation.delay * settings.delay * dq;
            let mut controller = Controller::new(Arc::clone(&model), settings, Some(servos.clone())).unwrap();
            let dq = [dq];
            let input = StepInput { dq: Some(&dq), ..StepInput::default() };
            controller.step(&[0.0], &rest, &input).unwrap();
            let (is_stiff, by_force) = (yields == CompliantSide::None, law != Law::Paper);
            let mut before = 0.0;
            for tick in [1.0, 2.0] {
                let command = *controller.step(&[0.0], &target, &input).unwrap();
                let record = controller.diagnostics();
                // The reference starts from rest. The acceleration that is fed forward is bounded.
                let v = f64::min(0.01 * acceleration * tick, 0.25);
                let a = ((v - before) / 0.01).min(3.0);
                before = v;
                let restored = if by_force { 0.5 * 0.8 * damping / kp } else { 0.0 };
                let time = f64::min(20.0, 0.5 / late) * inertia / kp + restored;
                let (q, row) = (record.q[0], record.rows[0][0]);
                assert!((q - if by_force { ahead } else { 0.0 }).abs() < 1e-15 && (row - lever).abs() < 1e-3);
                let compliance = row * row / kp;
                let full = (inertia / kp * a + time * (v - row * dq[0])) / compliance;
                let (pacing, turn) = if is_stiff { (full, v / row) } else { (0.0, 0.0) };
                let step = horizon * 2.0 * controller.gain_factor() * record.deviation[0];
                let force = match law {
                    Law::Impedance => 300.0 * controller.gain_factor() * record.deviation[0],
                    Law::Cap if !is_stiff => step / compliance,
                    _ => step / (compliance + lambda * lambda / kp),
                };
                let direction = ((dq[0] + turn) / 0.05).tanh();
                let feed_forward = if by_force { 0.9 * friction * direction + 0.8 * damping * dq[0] } else { 0.0 };
                let torque = kp * (command.goal()[0] - q);
                for (name, got, expected) in [
                    ("feed-forward", record.feed_forward[0], feed_forward),
                    ("torque", torque, row * (force + pacing) + feed_forward),
                    ("wrench", record.wrench[0], if by_force { force + pacing } else { 0.0 }),
                ] {
                    let text = format!("{law:?} {yields:?} {acceleration} {dq:?}: {name} {got} {expected}");
                    assert!((got - expected).abs() < 1e-9, "{text}");
                }
            }
        }
    }
}

#[test]
fn a_captured_gravity_offset_is_not_added_twice() {
    let model = arm();
    for share in [0.5, 0.75, 1.5, 2.0] {
        let kp = BELIEVED.map(|k| share * k);
        let settings = Settings { tracking: Tracking { integrate: 2.0, ..frictionless().tracking }, ..frictionless() };
        let (_, mut controller, target) = make(settings.clone());
        let mut q = Q.to_vec();
        controller.reset(&q).unwrap();
        let goal = hold(&model, &mut controller, &kp, &target, &mut q, 800);
        let kg = controller.capture_gravity(&q, &goal).unwrap();
        let gravity = model.gravity(&q).unwrap();
        for i in 0..7 {
            let friction = if i < 4 { 0.2 } else { 0.1 };
            let expected = if gravity[i].abs() > 3.0 * friction { kp[i] } else { BELIEVED[i] };
            assert!((kg[i] / expected - 1.0).abs() < 0.02, "{share}, joint {i}: {} instead of {expected}", kg[i]);
        }
        // With the same settings the goal does not change, so the captured offset is not added twice.
        let next = controller.step(&q, &target, &StepInput::default()).unwrap().goal().to_vec();
        assert!(largest_difference(&next, &goal) < 1e-4, "{share}: {next:?} {goal:?}");
        // Without integration the stored lead is removed, and the captured offset holds the arm, also after a reset.
        controller.update(Settings { tracking: Tracking { integrate: 0.0, ..settings.tracking }, ..settings }).unwrap();
        hold(&model, &mut controller, &kp, &target, &mut q, 300);
        assert!(position_error(&model, &q, &target) < 1e-3, "{share}: {}", position_error(&model, &q, &target));
        controller.reset(&q).unwrap();
        let mut lower = target;
        lower.position[0] -= 0.05;
        hold(&model, &mut controller, &kp, &lower, &mut q, 600);
        assert!(position_error(&model, &q, &lower) < 2.5e-3, "{share}: {}", position_error(&model, &q, &lower));
    }
}

#[test]
fn a_captured_stiffness_is_bounded() {
    let (_, mut controller, _) = make(Settings::default());
    // A lead of zero, a lead that is much too large, and a lead in the wrong direction.
    let gravity = controller.model().gravity(&Q).unwrap();
    for (lead, factor) in [(0.0, 3.0), (1.0, 0.3), (-0.02, 3.0)] {
        let goal: Vec<f64> = (0..7).map(|i| Q[i] + lead * gravity[i].signum()).collect();
        let kg = controller.capture_gravity(&Q, &goal).unwrap();
        assert!((kg[0] - factor * 150.0).abs() < 1e-9 && (kg[5] - 60.0).abs() < 1e-12, "{kg:?}");
    }
    assert!(controller.capture_gravity(&Q[..6], &Q).is_err());
    let paper = Settings { law: Law::Paper, gravity: false, ..Settings::default() };
    assert!(Controller::new(arm(), paper, None).unwrap().capture_gravity(&Q, &Q).is_err());
}

#[test]
fn the_part_of_a_captured_lead_that_no_stiffness_explains_stays() {
    let (model, mut controller, target) = make(frictionless());
    let gravity = model.gravity(&Q).unwrap();
    // Joint 5 carries too little weight to tell its stiffness, joint 1 more than the bounds of the stiffness allow.
    let mut goal: Vec<f64> = (0..7).map(|i| Q[i] + gravity[i] / (0.8 * BELIEVED[i])).collect();
    goal[5] += 0.01;
    goal[1] = Q[1] + 0.01 * gravity[1].signum() + gravity[1] / (0.3 * BELIEVED[1]);
    controller.capture_gravity(&Q, &goal).unwrap();
    let held = |controller: &mut Controller| {
        controller.reset(&Q).unwrap();
        for _ in 0..300 {
            controller.step(&Q, &target, &StepInput::default()).unwrap();
        }
        controller.step(&Q, &target, &StepInput::default()).unwrap().goal().to_vec()
    };
    assert!(largest_difference(&held(&mut controller), &goal) < 1e-9);
    controller.update(Settings { rate: 200.0, ..frictionless() }).unwrap();
    assert!(largest_difference(&held(&mut controller), &goal) < 1e-9);
    // A lead that holds nothing is bounded: 10 times the friction of 0.1 N·m, at k_p = 60 N·m/rad.
    goal[5] = Q[5] + 2.0;
    controller.capture_gravity(&Q, &goal).unwrap();
    let lead = held(&mut controller)[5] - Q[5];
    assert!((lead - gravity[5] / BELIEVED[5] - 10.0 * 0.1 / BELIEVED[5]).abs() < 1e-9, "{lead}");
}

#[test]
fn a_snapshot_keeps_the_captured_stiffness_and_is_checked() {
    let (model, mut controller, target) = make(Settings::default());
    let gravity = model.gravity(&Q).unwrap();
    let goal: Vec<f64> = (0..7).map(|i| Q[i] + gravity[i] / (0.8 * BELIEVED[i])).collect();
    controller.capture_gravity(&Q, &goal).unwrap();
    controller.step(&Q, &target, &StepInput::default()).unwrap();
    let snapshot = controller.snapshot();
    let restore = |snapshot: &Snapshot| {
        Controller::from_snapshot(Arc::clone(&model), Settings::default(), Some(seeded::servos(0)), snapshot)
    };
    let mut other = restore(&snapshot).unwrap();
    for _ in 0..3 {
        let command = *controller.step(&Q, &target, &StepInput::default()).unwrap();
        assert_eq!(command, *other.step(&Q, &target, &StepInput::default()).unwrap());
    }
    let changed = |list: usize, index: usize, value: f64| {
        let mut wrong = snapshot.clone();
        wrong.captured.as_mut().unwrap()[list][index] = value;
        wrong
    };
    let captured = |index: usize, value: f64| changed(0, index, value);
    let short = Snapshot { captured: Some([vec![0.01; 7], vec![0.0; 6]]), ..snapshot.clone() };
    let state = |length: usize| Snapshot { state: vec![1.0; length], ..snapshot.clone() };
    let nan = Snapshot { state: vec![f64::NAN; snapshot.state.len()], ..snapshot.clone() };
    let ramp = |mass: f64| Snapshot { payload_ramp: Some([mass, 0.0, 0.0, 0.0, 0.1]), ..snapshot.clone() };
    for (wrong, text) in [
        (captured(0, 0.0), "captured [rad/(N·m)] = 0 is outside (0, ∞)"),
        (captured(6, -0.01), "captured [rad/(N·m)] = -0.01 is outside (0, ∞)"),
        (captured(3, f64::INFINITY), "captured [rad/(N·m)] = inf is outside (0, ∞)"),
        (changed(1, 2, f64::NAN), "captured lead [rad] = NaN is outside ±1e6"),
        (short, "captured has"),
        (Snapshot { gravity: [0.0, f64::NAN, 0.0], ..snapshot.clone() }, "gravity"),
        (Snapshot { delay: 0.6, ..snapshot.clone() }, "delay [s] = 0.6"),
        (state(snapshot.state.len() - 1), "state has"),
        (nan, "state = NaN is outside numbers"),
        (ramp(1e7), "payload_ramp = 1e7 is outside ±1e6"),
    ] {
        let message = restore(&wrong).unwrap_err().to_string();
        assert!(message.starts_with(text), "{text}: {message}");
    }
    restore(&Snapshot { state: Vec::new(), ..snapshot.clone() }).unwrap();
}

#[test]
fn a_twist_moves_the_target_on_by_the_delay_within_the_tool_speed() {
    let twist = [0.0, 0.1, 0.0, 0.0, 0.0, 2.0];
    let velocity = |law| {
        let settings = Settings { law, delay: 0.02, ..Settings::default() };
        let (_, mut controller, target) = make(settings);
        controller.step(&Q, &target, &StepInput { twist: Some(&twist), ..StepInput::default() }).unwrap();
        controller.diagnostics().task_velocity
    };
    // 1 rad/s is the largest speed of the tool. K_x 4/s, b_p 0.9.
    let ahead = 4.0 * 0.9 * 0.02;
    for (law, factor) in [(Law::Cap, ahead), (Law::Impedance, ahead), (Law::Paper, 1.0)] {
        let dx = velocity(law);
        let want = [0.0, 0.1 * factor, 0.0, 0.0, 0.0, factor];
        assert!(want.iter().zip(&dx).all(|(want, dx)| (want - dx).abs() < 1e-9), "{law:?}: {dx:?}");
    }
}

#[test]
fn a_joint_target_sets_pose_and_posture() {
    let (model, mut controller, _) = make(Settings::default());
    let mut twin = controller.clone();
    let wanted: Vec<f64> = Q.iter().map(|x| x + 0.05).collect();
    let a = *controller.step_joints(&Q, &wanted, &StepInput::default()).unwrap();
    let pose = model.forward_kinematics(&wanted).unwrap();
    let b = *twin.step(&Q, &pose, &StepInput { posture: Some(&wanted), ..StepInput::default() }).unwrap();
    assert_eq!(a, b);
}

#[test]
fn back_emf_of_pwm_limited_servos_is_fed_forward() {
    let duty = Servos { limit_type: pliant_core::LimitType::Pwm, no_load_speed: Some(vec![5.0]), ..seeded::servos(0) };
    let mut controller = Controller::new(arm(), Settings::default(), Some(duty)).unwrap();
    let target = arm().forward_kinematics(&Q).unwrap();
    let dq = [1.0; 7];
    controller.step(&Q, &target, &StepInput { dq: Some(&dq), ..StepInput::default() }).unwrap();
    let want = 0.9 * 0.2 * (1.0_f64 / 0.05).tanh() + 0.8 * (1.2 + 1.5 + 10.7 / 5.0);
    assert!((controller.diagnostics().feed_forward[0] - controller.diagnostics().gamma * want).abs() < 1e-12);
}
