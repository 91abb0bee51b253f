//! Targets in other units (millimetres, degrees) are rejected by every call on every instruction set, and do not change
//! the controller.

use std::sync::Arc;

use pliant_core::analysis::check_path;
use pliant_core::{Controller, Error, Model, Pose, Servos, Settings, SimdLevel, StepInput};

use crate::common;

const Q: [f64; 7] = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];

fn controller(model: &Arc<Model>) -> Controller {
    Controller::new(Arc::clone(model), Settings::default(), Some(Servos::new(vec![150.0], vec![10.7]))).unwrap()
}

/// Returns a pose at a distance [m] from the first joint, in a direction.
fn at(model: &Model, distance: f64, direction: [f64; 3]) -> Pose {
    let size = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
    let centre = model.reach_origin();
    Pose { position: std::array::from_fn(|i| centre[i] + distance * direction[i] / size), ..Pose::IDENTITY }
}

#[test]
fn the_target_region_is_the_same_on_all_instruction_sets() {
    let model = Arc::new(common::arm7());
    let bound = 2.0 * model.reach() + 0.1;
    for simd_level in SimdLevel::available() {
        let mut controller = controller(&model);
        controller.set_simd_level(simd_level);
        for direction in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0], [-2.0, 1.0, 0.5]] {
            for distance in [0.5 * bound, bound / 3.0_f64.sqrt(), bound - 1e-9] {
                controller.step(&Q, &at(&model, distance, direction), &StepInput::default()).unwrap();
            }
            let before = controller.snapshot();
            for distance in [bound + 1e-9, 10.0 * bound, 1e3, 1e9, 1e300] {
                let error = controller.step(&Q, &at(&model, distance, direction), &StepInput::default()).unwrap_err();
                assert!(matches!(&error, Error::OutOfRange { value, .. } if *value >= bound - 1e-3), "{error}");
                assert!(error.to_string().contains("millimetres?"), "{error}");
                assert_eq!(error, model.check_target(&at(&model, distance, direction)).unwrap_err());
            }
            assert_eq!(controller.snapshot(), before);
        }
    }
}

#[test]
fn nan_is_reported_before_the_distance() {
    let model = Arc::new(common::arm7());
    let mut controller = controller(&model);
    for strange in [f64::NAN, f64::INFINITY] {
        let target = Pose { position: [strange, 0.0, 90.0], ..Pose::IDENTITY };
        let error = controller.step(&Q, &target, &StepInput::default()).unwrap_err();
        assert!(error.to_string().starts_with("target: position x"), "{error}");
    }
}

#[test]
fn joint_targets_may_exceed_the_limits_slightly() {
    let model = Arc::new(common::arm7());
    let mut controller = controller(&model);
    for i in 0..7 {
        for (limit, sign) in [(model.upper()[i], 1.0), (model.lower()[i], -1.0)] {
            let mut wanted = Q;
            wanted[i] = limit + sign * 0.199;
            controller.step_joints(&Q, &wanted, &StepInput::default()).unwrap();
            let before = controller.snapshot();
            wanted[i] = limit + sign * 0.201;
            let error = controller.step_joints(&Q, &wanted, &StepInput::default()).unwrap_err();
            assert!(error.to_string().contains("degrees?") && error.to_string().contains(&model.joint_names()[i]));
            check_path(&controller, &[wanted.to_vec()]).unwrap_err();
            assert_eq!(controller.snapshot(), before);
        }
    }
}
