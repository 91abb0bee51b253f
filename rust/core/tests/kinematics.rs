//! Poses, Jacobians and gravity torques against reference values and against each other.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use pliant_core::error::Error;
use pliant_core::kinematics::{IkOptions, IkStatus, Reference};
use pliant_core::model::{Model, ModelOptions, Payload};
use pliant_core::pose::Pose;
use proptest::prelude::*;

use crate::common::{
    self, arm7, close, data, finite_difference, isometry, json, matrix, numbers, potential_energy, robot, root,
    slow_tool, state,
};

const ROBOTS: [&str; 6] = ["planar_2r", "twisted_6r", "hobby_5dof", "fixed_pairs", "sliding", "mimics"];

#[test]
fn arm7_agrees_with_the_golden_values() {
    let model = arm7();
    let cases = json(&root().join("tests/data/golden/golden.json"));
    let cases = cases.as_array().unwrap();
    assert_eq!(cases.len(), 24);
    for case in cases {
        let q = numbers(&case["q"]);
        let (pose, jacobian) = model.kinematics(&q, Reference::WorldAligned).unwrap();
        let (p, r, j, g) = (numbers(&case["p"]), matrix(&case["R"]), matrix(&case["J"]), numbers(&case["gravity"]));
        let gravity = model.gravity(&q).unwrap();
        for i in 0..3 {
            close("p", pose.position[i], p[i], 1e-12);
            for k in 0..3 {
                close("R", pose.rotation[i][k], r[i][k], 1e-12);
            }
        }
        for k in 0..7 {
            close("gravity", gravity[k], g[k], 1e-11);
            for i in 0..6 {
                close("J", jacobian[(i, k)], j[i][k], 1e-12);
            }
        }
    }
}

/// The reference values in `tests/data/robots/reference.json` were computed with Pinocchio.
#[test]
fn robots_agree_with_pinocchio() {
    let reference = json(&data("robots/reference.json"));
    for (name, cases) in reference.as_object().unwrap() {
        if name == "made_with" {
            continue;
        }
        let model = robot(name);
        for case in cases.as_array().unwrap() {
            let q = numbers(&case["q"]);
            let (pose, jacobian) = model.kinematics(&q, Reference::WorldAligned).unwrap();
            let (t, j, g) = (matrix(&case["T"]), matrix(&case["J"]), numbers(&case["gravity"]));
            let (rows, gravity) = (pose.to_rows(), model.gravity(&q).unwrap());
            for i in 0..3 {
                for k in 0..4 {
                    close(&format!("{name} T[{i}][{k}]"), rows[i][k], t[i][k], 1e-13);
                }
            }
            for k in 0..model.n() {
                close(&format!("{name} gravity[{k}]"), gravity[k], g[k], 2e-13);
                for i in 0..6 {
                    close(&format!("{name} J[{i}][{k}]"), jacobian[(i, k)], j[i][k], 1e-13);
                }
            }
        }
    }
}

#[test]
fn two_links_in_a_plane_agree_with_the_closed_form() {
    let model = robot("planar_2r");
    for seed in 0..50 {
        let q = state(&model, seed);
        let (a, b) = (q[0], q[0] + q[1]);
        let pose = model.forward_kinematics(&q).unwrap();
        close("x", pose.position[0], 0.5 * a.cos() + 0.3 * b.cos(), 1e-15);
        close("z", pose.position[2], 0.5 * a.sin() + 0.3 * b.sin(), 1e-15);
        close("R", pose.rotation[2][0], b.sin(), 1e-15);
        let jacobian = model.jacobian(&q, Reference::WorldAligned).unwrap();
        close("dx/dq0", jacobian[(0, 0)], -0.5 * a.sin() - 0.3 * b.sin(), 1e-15);
        close("dz/dq1", jacobian[(2, 1)], 0.3 * b.cos(), 1e-15);
        close("wy/dq1", jacobian[(4, 1)], -1.0, 1e-15);
        let gravity = model.gravity(&q).unwrap();
        let second = 9.81 * 0.15 * b.cos();
        close("g0", gravity[0], 9.81 * (2.0 * 0.25 + 1.0 * 0.5) * a.cos() + second, 1e-14);
        close("g1", gravity[1], second, 1e-14);
    }
}

#[test]
fn pose_jacobian_and_gravity_agree_with_the_reference_and_its_differences() {
    for name in ROBOTS {
        let model = robot(name);
        for seed in 0..20 {
            let q = state(&model, seed);
            let (pose, jacobian) = model.kinematics(&q, Reference::WorldAligned).unwrap();
            let slow = slow_tool(&model, &q);
            let off = (isometry(&pose).inverse() * slow).to_homogeneous() - nalgebra::Matrix4::identity();
            assert!(off.amax() < 1e-14, "{name}: {off}");

            let positions = finite_difference(|q| slow_tool(&model, q).translation.vector.as_slice().to_vec(), &q);
            let turns = finite_difference(
                |q| (slow_tool(&model, q).rotation * slow.rotation.inverse()).scaled_axis().as_slice().to_vec(),
                &q,
            );
            let energy = finite_difference(|q| vec![potential_energy(&model, q)], &q);
            let gravity = model.gravity(&q).unwrap();
            let local = model.jacobian(&q, Reference::Local).unwrap();
            for k in 0..model.n() {
                close(&format!("{name} gravity {k}"), gravity[k], energy[0][k], 1e-8);
                for i in 0..3 {
                    close(&format!("{name} J[{i}][{k}]"), jacobian[(i, k)], positions[i][k], 1e-9);
                    close(&format!("{name} J[{}][{k}]", i + 3), jacobian[(i + 3, k)], turns[i][k], 1e-9);
                    let back: f64 = (0..3).map(|a| pose.rotation[i][a] * local[(a, k)]).sum();
                    close(&format!("{name} local {k}"), back, jacobian[(i, k)], 1e-14);
                }
            }
        }
    }
}

#[test]
fn the_payload_is_at_the_tool() {
    let payload = Payload { mass: 0.7, com: [0.02, -0.03, 0.1] };
    let options =
        ModelOptions { payload: Some(payload), gravity: [1.0, -2.0, -9.0], ..common::between("base", "tool") };
    for name in ROBOTS {
        let model = Model::from_urdf_file(data("robots").join(name).with_extension("urdf"), &options).unwrap();
        let q = state(&model, 5);
        let energy = finite_difference(|q| vec![potential_energy(&model, q)], &q);
        let gravity = model.gravity(&q).unwrap();
        for k in 0..model.n() {
            close(&format!("{name} {k}"), gravity[k], energy[0][k], 1e-8);
        }
    }
}

#[test]
fn joint_positions_are_checked() {
    let model = arm7();
    let shape = model.forward_kinematics(&[0.0; 6]).unwrap_err().to_string();
    assert_eq!(shape, "q has shape (6,), expected (7,)");
    for bad in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1.1e6] {
        let mut q = [0.0; 7];
        q[3] = bad;
        let error = model.gravity(&q).unwrap_err();
        assert!(matches!(error, Error::OutOfRange { .. }));
        assert!(error.to_string().starts_with("q[3] (elbow_pitch) = "), "{error}");
    }
    assert!(model.kinematics(&[-1e6; 7], Reference::Local).is_ok());
}

#[test]
fn non_temporal_stores_give_the_same_bits() {
    let model = arm7();
    let (n, count) = (model.n(), 150_003);
    let q: Vec<f64> = (0..count * n).map(|i| (0.37 * i as f64).sin()).collect();
    // Offset by one number, so that the slices are not aligned to cache lines.
    let (mut poses, mut jacobians) = (vec![0.0; 1 + 16 * count], vec![0.0; 1 + 6 * n * count]);
    let (poses, jacobians) = (&mut poses[1..], &mut jacobians[1..]);
    model.kinematics_batch(&q, Reference::WorldAligned, poses, jacobians).unwrap();
    let (mut few_poses, mut few_jacobians) = (vec![0.0; 16 * 1000], vec![0.0; 6 * n * 1000]);
    for (part, q) in q.chunks(1000 * n).enumerate() {
        let here = q.len() / n;
        let (few_poses, few_jacobians) = (&mut few_poses[..16 * here], &mut few_jacobians[..6 * n * here]);
        model.kinematics_batch(q, Reference::WorldAligned, few_poses, few_jacobians).unwrap();
        let same = |few: &[f64], all: &[f64]| few.iter().zip(all).all(|(a, b)| a.to_bits() == b.to_bits());
        assert!(same(few_poses, &poses[16 * 1000 * part..]), "poses of part {part}");
        assert!(same(few_jacobians, &jacobians[6 * n * 1000 * part..]), "Jacobians of part {part}");
    }
}

#[test]
fn inverse_kinematics_finds_reachable_poses() {
    for name in ["arm7", "twisted_6r", "sliding", "hobby_5dof"] {
        let model = if name == "arm7" { arm7() } else { robot(name) };
        // With four or five joints, a search from another start may miss a pose of six axes, so only the position is
        // searched.
        let six = model.n() >= 6;
        let axes = [true, true, true, six, six, six];
        let options = IkOptions { axes, restarts: 20, ..IkOptions::default() };
        let mut solved = 0;
        for seed in 0..100 {
            let target = model.forward_kinematics(&state(&model, seed)).unwrap();
            let solution = model.inverse_kinematics(&target, &state(&model, seed + 1000), &options).unwrap();
            assert_eq!(solution, model.inverse_kinematics(&target, &state(&model, seed + 1000), &options).unwrap());
            let pose = model.forward_kinematics(&solution.q).unwrap();
            let off = isometry(&pose).inverse() * isometry(&target);
            close("position error", solution.position_error, off.translation.vector.norm(), 1e-12);
            if six {
                close("rotation error", solution.rotation_error, off.rotation.angle(), 1e-9);
            }
            assert_eq!(solution.converged, solution.reason == IkStatus::Converged);
            assert_eq!(solution.converged, solution.position_error <= 1e-8 && solution.rotation_error <= 1e-8);
            for k in 0..model.n() {
                assert!(solution.q[k] >= model.lower()[k] && solution.q[k] <= model.upper()[k]);
            }
            solved += usize::from(solution.converged);
        }
        println!("{name}: {solved} of 100");
        assert!(solved >= 95, "{name}: {solved} of 100");
    }
}

#[test]
fn inverse_kinematics_reports_the_reason_of_a_failure() {
    let model = arm7();
    let start = [0.1, -0.3, 0.2, -1.2, 0.1, 0.2, 0.1];
    let mut far = model.forward_kinematics(&start).unwrap();
    far.position = [2.0, 0.0, 0.0];
    let solution = model.inverse_kinematics(&far, &start, &IkOptions::default()).unwrap();
    assert!(!solution.converged);
    assert!(matches!(solution.reason, IkStatus::OutOfReach { .. }));
    assert_eq!(solution.reason.to_string(), "out of reach: 2.000 m from the first joint, the arm reaches 0.710 m");
    // The arm stretches toward the target: no position error is smaller than the distance minus the arm's length.
    assert!(solution.position_error >= 2.0 - 0.71, "{}", solution.position_error);

    let behind = Pose { position: [-0.3, 0.5, 0.2], ..far };
    let solution = model.inverse_kinematics(&behind, &start, &IkOptions::default()).unwrap();
    assert!(matches!(&solution.reason, IkStatus::JointLimit { joints } if !joints.is_empty()), "{solution:?}");

    let bad = IkOptions { position_tolerance: 0.0, ..IkOptions::default() };
    let error = model.inverse_kinematics(&far, &start, &bad).unwrap_err().to_string();
    assert!(error.starts_with("position_tolerance: is 0; must be finite and at least 1e-12"), "{error}");
    let nan = Pose { position: [f64::NAN, 0.0, 0.0], ..far };
    assert!(model.inverse_kinematics(&nan, &start, &IkOptions::default()).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn kinematics_equal_the_reference_anywhere(which in 0..ROBOTS.len(), q in prop::collection::vec(-1e6..1e6, 6)) {
        let model = robot(ROBOTS[which]);
        // At 1e6 rad, the rounding error of the angle itself is 1e-10.
        for scale in [1e-12_f64, 1e-6, 1e-3, 1.0] {
            let q: Vec<f64> = q[..model.n()].iter().map(|x| x * scale).collect();
            let slow = slow_tool(&model, &q);
            let fast = isometry(&model.forward_kinematics(&q).unwrap());
            let size = 1.0 + slow.translation.vector.norm();
            let off = (fast.translation.vector - slow.translation.vector).norm() / size;
            prop_assert!(off < 1e-9 * scale.max(1e-6), "{} at {scale}: {off:e}", ROBOTS[which]);
            let r = model.forward_kinematics(&q).unwrap().rotation;
            let m = Matrix3::from_fn(|i, j| r[i][j]);
            prop_assert!((m.transpose() * m - Matrix3::identity()).amax() < 1e-14);
            let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m)).angle_to(&slow.rotation);
            prop_assert!(turn < 1e-8 * scale.max(1e-6), "{} at {scale}: {turn:e}", ROBOTS[which]);
        }
    }

    #[test]
    fn any_joint_positions_give_a_result_or_an_error(q in prop::collection::vec(any::<f64>(), 0..9)) {
        let model = robot("twisted_6r");
        let fits = q.len() == 6 && q.iter().all(|x| x.abs() <= 1e6);
        prop_assert_eq!(model.kinematics(&q, Reference::Local).is_ok(), fits);
        prop_assert_eq!(model.gravity(&q).is_ok(), fits);
        if let Ok(torque) = model.gravity(&q) {
            prop_assert!(torque.iter().all(|t| t.is_finite()));
        }
    }
}
