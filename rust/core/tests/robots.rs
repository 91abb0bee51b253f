//! Tests with third-party robots. Without their folder beside the repository, they pass without a check.

use std::path::PathBuf;

use pliant_core::kinematics::Reference;
use pliant_core::model::{Model, ModelOptions};

use crate::common::{close, json, matrix, numbers, root};

fn folder() -> Option<PathBuf> {
    let folder = root().join("../shared/robots");
    if !folder.is_dir() {
        println!("skipped: no third-party robots in {}", folder.display());
        return None;
    }
    Some(folder)
}

fn agrees(robot: &str, file: &str) {
    let Some(folder) = folder().map(|f| f.join(robot)) else { return };
    let reference = json(&folder.join(file));
    let text = |key: &str| Some(reference[key].as_str().unwrap().to_owned());
    let options = ModelOptions { base: text("base"), tip: text("tip"), ..ModelOptions::default() };
    let model = Model::from_urdf_file(folder.join(text("urdf").unwrap()), &options).unwrap();
    let joints: Vec<&str> = reference["joints"].as_array().unwrap().iter().map(|j| j.as_str().unwrap()).collect();
    assert_eq!(model.joint_names(), joints);
    for case in reference["cases"].as_array().unwrap() {
        let q = numbers(&case["q"]);
        let (pose, jacobian) = model.kinematics(&q, Reference::WorldAligned).unwrap();
        let (t, j) = (matrix(&case["T"]), matrix(&case["J"]));
        let rows = pose.to_rows();
        for i in 0..4 {
            for k in 0..4 {
                close(&format!("{robot} T[{i}][{k}]"), rows[i][k], t[i][k], 1e-9);
            }
        }
        for i in 0..6 {
            for k in 0..model.n() {
                close(&format!("{robot} J[{i}][{k}]"), jacobian[(i, k)], j[i][k], 1e-9);
            }
        }
        assert_eq!(q.len(), model.n());
    }
}

#[test]
fn so101() {
    agrees("so101", "reference_fk.json");
}

#[test]
fn koch() {
    agrees("koch_low_cost", "reference_fk.json");
}

#[test]
fn vx300s() {
    agrees("vx300s", "reference_fk.json");
    agrees("vx300s", "reference_mimic.json");
}

#[test]
fn panda() {
    agrees("panda", "reference_fk.json");
    agrees("panda", "reference_mimic.json");
}

#[test]
fn ur5e() {
    agrees("ur5e", "reference_fk.json");
}

#[test]
fn xarm7() {
    agrees("xarm7", "reference_fk.json");
    agrees("xarm7", "reference_mimic.json");
}

#[test]
fn a_robot_without_limits_is_rejected_by_name() {
    let Some(folder) = folder() else { return };
    let path = folder.join("bad_iiwa14_nolimits/kuka_iiwa_robot.urdf");
    let error = Model::from_urdf_file(&path, &ModelOptions::default()).unwrap_err().to_string();
    assert!(error.contains("joint 'iiwa_joint_1' (revolute) has no lower and upper position limits"), "{error}");
    assert!(error.contains("limits = {\"iiwa_joint_1\": (lower, upper)}"), "{error}");
}
