//! Invalid settings are rejected by an error that names them; settings that may be infinite are accepted.

use std::sync::Arc;

use nalgebra::DMatrix;
use pliant_core::analysis::check_path;
use pliant_core::params::{Axis, GravityUse, Law, NullSpace, PaperOptions, Task, TorqueLimits, Tracking};
use pliant_core::{
    BatchCommand, BatchInput, ContactEstimator, ContactInput, ContactOptions, Controller, Error, Model, ModelOptions,
    Payload, Servos, Settings, StepInput, Targets, damped_pseudo_inverse, joint_torque_limits, responsibility,
};

use crate::common;

const GRASP: [f64; 7] = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];

/// URDF of two joints that move the tool in the xy plane: no joint moves it along z.
const PLANAR: &str = r#"<robot name="planar"><link name="base"/>
    <link name="upper"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
    <link name="lower"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
    <link name="tool"/>
    <joint name="a" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/></joint>
    <joint name="b" type="continuous"><origin xyz="0.3 0 0"/><parent link="upper"/><child link="lower"/><axis xyz="0 0 1"/></joint>
    <joint name="c" type="fixed"><origin xyz="0.3 0 0"/><parent link="lower"/><child link="tool"/></joint></robot>"#;

fn servos() -> Servos {
    Servos::new(vec![150.0], vec![10.7])
}

fn controller_with(settings: Settings, servos: Servos) -> pliant_core::Result<Controller> {
    Controller::new(Arc::new(common::arm7()), settings, Some(servos))
}

fn message<T>(result: pliant_core::Result<T>) -> String {
    result.map(|_| ()).unwrap_err().to_string()
}

#[test]
fn infinite_bounds_give_finite_commands_for_a_jumping_target() {
    let infinite = f64::INFINITY;
    let all = vec![
        Settings { max_tool_speed: [infinite; 2], ..Settings::default() },
        Settings { max_tool_acceleration: [infinite; 2], ..Settings::default() },
        Settings { max_tool_speed: [0.1, infinite], max_tool_acceleration: [infinite, 1.0], ..Settings::default() },
        Settings { tracking: Tracking { goal_slew: infinite, ..Tracking::default() }, ..Settings::default() },
        Settings { null_space: NullSpace { max_speed: infinite, ..NullSpace::default() }, ..Settings::default() },
        Settings {
            torque_limits: TorqueLimits { max_host_loss_force: Some(infinite), ..TorqueLimits::default() },
            ..Settings::default()
        },
        Settings {
            tracking: Tracking { joint_speed: Some(vec![infinite; 7]), ..Tracking::default() },
            ..Settings::default()
        },
        Settings {
            torque_limits: TorqueLimits { floor: Some(vec![infinite; 7]), ..TorqueLimits::default() },
            ..Settings::default()
        },
        Settings {
            paper_options: PaperOptions { lead_limit: Some(infinite), ..Settings::paper().paper_options },
            ..Settings::paper()
        },
    ];
    for settings in all {
        let mut controller = controller_with(settings.clone(), servos()).unwrap();
        let mut target = controller.model().forward_kinematics(&GRASP).unwrap();
        for shift in [0.0, 0.1, -0.2, 0.0] {
            target.position[1] += shift;
            let command = controller.step(&GRASP, &target, &StepInput::default());
            let command = command.unwrap_or_else(|error| panic!("{settings:?}: {error}"));
            assert!(command.goal().iter().chain(command.torque_limit()).all(|value| value.is_finite()));
        }
    }
}

#[test]
fn an_axis_that_no_joint_moves_gets_no_torque() {
    let model = Arc::new(Model::from_urdf_str(PLANAR, &ModelOptions::default()).unwrap());
    let target = model.forward_kinematics(&[0.3, 0.5]).unwrap();
    let limits = |hold: f64| {
        let mut settings =
            Settings { task: Task { length: Some(0.3), ..Task::parse("xyz").unwrap() }, ..Settings::paper() };
        settings.axes[..3].fill(Axis { hold: Some(hold), ..Axis::default() });
        let mut controller = Controller::new(Arc::clone(&model), settings, None).unwrap();
        controller.step(&[0.3, 0.5], &target, &StepInput::default()).unwrap().torque_limit().to_vec()
    };
    let (few, many) = (limits(3.0), limits(300.0));
    for (few, many) in few.iter().zip(&many) {
        assert!(*few > 0.0 && (many / few - 100.0).abs() < 1e-9, "{few} {many}");
    }
}

#[test]
fn unusable_numbers_are_rejected_by_name() {
    let cases = [
        (
            "paper_options.posture_weights",
            Settings {
                paper_options: PaperOptions {
                    posture_weights: Some(vec![f64::INFINITY; 7]),
                    ..PaperOptions::default()
                },
                ..Settings::default()
            },
        ),
        (
            "paper_options.joint_weights",
            Settings {
                paper_options: PaperOptions { joint_weights: Some(vec![1e300; 7]), ..Settings::paper().paper_options },
                ..Settings::paper()
            },
        ),
    ];
    for (name, settings) in cases {
        assert!(message(controller_with(settings, servos())).starts_with(name));
    }
    let cases = [
        ("servos.kp[0]", Servos { kp: vec![1e-308], ..servos() }),
        ("servos.max_torque[0]", Servos { max_torque: vec![1e308], ..servos() }),
        ("servos.stribeck_speed[0]", Servos { stribeck: vec![0.1], stribeck_speed: vec![1e-320], ..servos() }),
    ];
    for (name, servos) in cases {
        assert!(message(controller_with(Settings::default(), servos)).starts_with(name));
    }
}

#[test]
fn weak_servos_are_rejected_once_gravity_is_compensated() {
    let weak = Servos::new(vec![150.0], vec![0.5]);
    let strength = Axis { soft: Some([0.1; 2]), firm: Some([0.1; 2]), hold: Some(0.2), ..Axis::default() };
    let on = Settings { axes: std::array::from_fn(|_| strength), ..Settings::default() };
    let error = Settings { gravity: false, ..on.clone() };
    let refusal = message(controller_with(on.clone(), weak.clone()));
    assert!(refusal.contains("torque that holds the arm"), "{refusal}");
    let mut controller = controller_with(error, weak).unwrap();
    controller.set_payload(Some(&Payload { mass: 0.1, com: [0.0; 3] })).unwrap();
    controller.set_payload(None).unwrap();
    assert!(message(controller.update(on)).contains("torque that holds the arm"));
    assert_eq!(controller.settings().gravity_use(), GravityUse::Off);
}

#[test]
fn a_lightly_loaded_joint_keeps_its_configured_stiffness() {
    let configured = Servos { encoder_step: vec![1.5e-3], ..servos() };
    let mut controller = controller_with(Settings::default(), configured).unwrap();
    let gravity = controller.model().gravity(&GRASP).unwrap();
    // All goals are off by half an encoder count; some joints carry a small load, others a large one.
    let goal: Vec<f64> = (0..7).map(|i| GRASP[i] + gravity[i] / 150.0 + 7.5e-4).collect();
    let captured = controller.capture_gravity(&GRASP, &goal).unwrap();
    let mut unchanged = 0;
    for i in 0..7 {
        let error = (captured[i] / 150.0 - 1.0).abs();
        assert!(error < 0.2, "joint {i} carries {}: {}", gravity[i], captured[i]);
        unchanged += usize::from(error < 1e-12);
    }
    assert!((1..7).contains(&unchanged));
}

#[test]
fn an_empty_path_is_rejected() {
    let controller = controller_with(Settings::default(), servos()).unwrap();
    assert!(matches!(check_path(&controller, &[]), Err(Error::Shape { .. })));
}

#[test]
fn there_is_no_last_command_before_a_step() {
    let mut controller = controller_with(Settings::default(), servos()).unwrap();
    assert!(controller.last_command().is_none());
    let target = controller.model().forward_kinematics(&GRASP).unwrap();
    let sent = *controller.step(&GRASP, &target, &StepInput::default()).unwrap();
    assert_eq!(controller.last_command(), Some(&sent));
    controller.reset(&GRASP).unwrap();
    assert!(controller.last_command().is_none());
}

#[test]
fn a_contact_estimator_rejects_the_controller_of_another_arm() {
    let mut contact =
        ContactEstimator::new(&controller_with(Settings::default(), servos()).unwrap(), ContactOptions::default())
            .unwrap();
    let model = Arc::new(Model::from_urdf_str(PLANAR, &ModelOptions::default()).unwrap());
    let settings = Settings { law: Law::Cap, task: Task::parse("xy").unwrap(), ..Settings::default() };
    let other = Controller::new(model, settings, Some(servos())).unwrap();
    let error = message(contact.update(&other, &[0.3, 0.5], &ContactInput::default()));
    assert!(error.contains("2 joints") && error.contains("7 joints"), "{error}");
}

#[test]
fn positions_are_rejected_as_targets_of_a_task_with_rotations() {
    let controller = controller_with(Settings::default(), servos()).unwrap();
    let target = controller.model().forward_kinematics(&GRASP).unwrap();
    let [mut goal, mut torque_limit, mut velocity] = [[0.0; 7]; 3];
    let input = BatchInput::new(&GRASP, Targets::Positions(&target.position));
    let out = BatchCommand { goal: &mut goal, torque_limit: &mut torque_limit, velocity: &mut velocity };
    assert!(message(controller.step_batch(&input, None, out)).contains("give poses"));
}

#[test]
fn results_of_equations_that_overflow_are_errors() {
    let matrix = |rows, columns, size: f64| {
        DMatrix::from_fn(rows, columns, |r, i| size * (((r * columns + i) as f64).powi(2) * 0.7).sin())
    };
    let overflows = |result: pliant_core::Result<DMatrix<f64>>| {
        let text = message(result);
        assert!(text.contains("overflows"), "{text}");
    };
    overflows(damped_pseudo_inverse(&DMatrix::from_element(1, 1, 5e-324), 0.0));
    overflows(responsibility(&matrix(7, 3, 1e308), &[10.0; 3], &DMatrix::identity(7, 7), &[1.0; 7], 1.0));
    assert!(joint_torque_limits(&matrix(7, 4, 1e308), &[10.0; 4]).is_err());
}

#[test]
fn a_rest_posture_that_is_no_position_is_rejected() {
    let with = |posture: Vec<f64>| Settings {
        null_space: NullSpace { posture: Some(posture), ..NullSpace::default() },
        ..Settings::default()
    };
    let mut running = controller_with(with(GRASP.to_vec()), servos()).unwrap();
    for (posture, text) in [
        (vec![0.0; 6], "null_space.posture has shape (6,), expected (7,)"),
        (vec![f64::NAN; 7], "null_space.posture [rad] = NaN is outside"),
        (vec![90.0; 7], "null_space.posture[0] (shoulder_pitch) [rad] = 90 is outside"),
    ] {
        for error in [message(controller_with(with(posture.clone()), servos())), message(running.update(with(posture)))]
        {
            assert!(error.starts_with(text), "{text}: {error}");
        }
    }
}

#[test]
fn a_period_in_milliseconds_is_recognized() {
    let mut controller = controller_with(Settings::default(), servos()).unwrap();
    let target = common::arm7().forward_kinematics(&GRASP).unwrap();
    for (dt, hint) in [(0.0, ""), (-0.01, ""), (f64::NAN, ""), (1.5, "; is it in milliseconds?")] {
        let text = message(controller.step(&GRASP, &target, &StepInput { dt: Some(dt), ..StepInput::default() }));
        assert_eq!(text, format!("dt [s] = {dt} is outside (0, 1]{hint}"));
    }
    controller.step(&GRASP, &target, &StepInput { dt: Some(1.0), ..StepInput::default() }).unwrap();
}
