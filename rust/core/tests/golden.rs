//! Compares intermediate values of the control step with those in `tests/data/golden`, computed with Pinocchio and
//! NumPy.

use std::sync::Arc;

use pliant_core::params::{
    Axis, CompliantSide, Damping, Gain, Law, NullSpace, PaperOptions, Projector, TorqueLimits, Tracking,
};
use pliant_core::{Controller, Model, ModelOptions, Pose, Settings, StepInput};
use serde_json::Value;

const TOLERANCE: f64 = 1e-10;

fn cases() -> Vec<Value> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/golden/golden.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn vector(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn flags(value: &Value) -> Vec<bool> {
    value.as_array().unwrap().iter().map(|x| x.as_bool().unwrap()).collect()
}

fn matrix(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().unwrap().iter().map(vector).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn arm7() -> Arc<Model> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/golden/arm7.urdf");
    let mut options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
    // The reference values were computed without position limits.
    let joints = Model::from_urdf_file(path, &options).unwrap().joint_names().to_vec();
    options.limits = joints.into_iter().map(|name| (name, (-100.0, 100.0))).collect();
    Arc::new(Model::from_urdf_file(path, &options).unwrap())
}

fn close(what: &str, case: usize, got: f64, expected: f64, scale: f64) {
    assert!((got - expected).abs() <= TOLERANCE * scale.max(1.0), "case {case}, {what}: {got} instead of {expected}");
}

/// Returns the settings of a case. Its flag `compliant_pos` names the sign of the deviation; `CompliantSide` names the
/// direction of the push, which is opposite.
fn settings(case: &Value) -> Settings {
    let mut settings = Settings {
        law: Law::Paper,
        gravity: false,
        max_tool_speed: [f64::INFINITY; 2],
        tracking: Tracking {
            damping: Damping::Fixed(number(&case["lam"])),
            gain: Gain::Scalar(number(&case["Kx"])),
            goal_slew: f64::INFINITY,
            joint_speed: Some(vec![f64::INFINITY; 7]),
            ..Tracking::default()
        },
        null_space: NullSpace {
            projector: Projector::Paper,
            gain: Some(number(&case["alpha"])),
            max_torque: Some(number(&case["tau_null"])),
            ..NullSpace::default()
        },
        torque_limits: TorqueLimits { stiffening_time: 0.0, ..TorqueLimits::default() },
        paper_options: PaperOptions {
            kq: Gain::Scalar(number(&case["Kq"])),
            posture_weights: Some(vec![0.0; 7]),
            lead_limit: Some(f64::INFINITY),
            ..PaperOptions::default()
        },
        ..Settings::default()
    };
    let (toward_minus, toward_plus) = (flags(&case["compliant_pos"]), flags(&case["compliant_neg"]));
    let (soft, firm, hold) = (vector(&case["tau_min"]), vector(&case["tau_max"]), vector(&case["tau_stiff"]));
    for axis in 0..6 {
        let yields = match (toward_minus[axis], toward_plus[axis]) {
            (true, true) => CompliantSide::Both,
            (true, false) => CompliantSide::Minus,
            (false, true) => CompliantSide::Plus,
            (false, false) => CompliantSide::None,
        };
        // `Axis` rejects firm > hold, which some cases have. Reduce firm; torques are not compared in these cases.
        let firm = firm[axis].min(hold[axis]);
        settings.axes[axis] = Axis {
            soft: Some([soft[axis]; 2]),
            firm: Some([firm; 2]),
            hold: Some(hold[axis]),
            yields: Some(yields),
            adaptation: if yields == CompliantSide::None { 0.0 } else { number(&case["eta"]) },
            soft_until: Some(vector(&case["d_minus"])[axis]),
            firm_from: Some(vector(&case["d_plus"])[axis]),
            max_velocity: Some(f64::INFINITY),
            soft_step_limit: Some(f64::INFINITY),
            ..Axis::default()
        };
    }
    settings
}

fn target(case: &Value) -> Pose {
    let (p, r) = (vector(&case["target_p"]), matrix(&case["target_R"]));
    Pose {
        position: [p[0], p[1], p[2]],
        rotation: [[r[0][0], r[0][1], r[0][2]], [r[1][0], r[1][1], r[1][2]], [r[2][0], r[2][1], r[2][2]]],
    }
}

#[test]
fn the_step_reproduces_every_quantity() {
    let model = arm7();
    let cases = cases();
    assert_eq!(cases.len(), 24);
    for (index, case) in cases.iter().enumerate() {
        let firm_above_hold = vector(&case["tau_max"]).iter().zip(vector(&case["tau_stiff"])).any(|(f, h)| *f > h);
        let mut controller = Controller::new(Arc::clone(&model), settings(case), None).unwrap();
        let q = vector(&case["q"]);
        // The file has the negative gradient of the cost.
        let gradient: Vec<f64> = vector(&case["grad"]).iter().map(|g| -g).collect();
        let input = StepInput { gradient: Some(&gradient), ..StepInput::default() };
        let command = *controller.step(&q, &target(case), &input).unwrap();
        let record = controller.diagnostics();
        for axis in 0..6 {
            close("deviation", index, record.deviation[axis], vector(&case["d_rotvec"])[axis], 1.0);
            close("dx", index, record.task_velocity[axis], vector(&case["dx"])[axis], 1.0);
            close("c", index, record.compliance[axis], vector(&case["c"])[axis], 1.0);
            assert_eq!(record.softness[axis] > 0.5, flags(&case["mask"])[axis], "case {index}, mask {axis}");
        }
        let (dq, a, expected) = (vector(&case["dq"]), controller.activation(), matrix(&case["A"]));
        for i in 0..7 {
            close("dq", index, (command.goal()[i] - q[i]) / 0.25, dq[i], dq[i].abs());
            for column in 0..7 {
                close("A", index, a[(i, column)], expected[i][column], 1.0);
            }
            if !firm_above_hold {
                let ceiling = model.effort_limit()[i].unwrap();
                close("tau_q", index, command.torque_limit()[i], vector(&case["tau_q"])[i].min(ceiling), 10.0);
            }
        }
        let gravity = vector(&case["gravity"]);
        (0..7).for_each(|i| close("gravity", index, record.gravity[i], gravity[i], 1.0));
    }
}
