//! Compares links and joints with those that urdf-rs reads from the original text.

use std::path::Path;

use pliant_core::Pose;
use pliant_core::model::{JointKind, Model, ModelOptions};
use urdf_rs::JointType;

use crate::common::{close, json, root};

/// Asserts that two poses agree. Roll, pitch and yaw are rotations about fixed axes, roll first.
fn same_pose(what: &str, pose: &Pose, other: &urdf_rs::Pose) {
    let [roll, pitch, yaw] = other.rpy.0;
    let turn = |axis: nalgebra::Vector3<f64>, angle| nalgebra::Rotation3::new(axis * angle);
    let (x, y, z) = (nalgebra::Vector3::x(), nalgebra::Vector3::y(), nalgebra::Vector3::z());
    let expected = turn(z, yaw) * turn(y, pitch) * turn(x, roll);
    for i in 0..3 {
        close(&format!("{what} position[{i}]"), pose.position[i], other.xyz[i], 1e-15);
        for j in 0..3 {
            close(&format!("{what} rotation[{i}][{j}]"), pose.rotation[i][j], expected[(i, j)], 1e-14);
        }
    }
}

fn same_joints(model: &Model, robot: &urdf_rs::Robot) {
    let link = |index: usize| model.links()[index].name.as_str();
    assert_eq!(model.joints().len(), robot.joints.len());
    for (joint, other) in model.joints().iter().zip(&robot.joints) {
        let what = format!("{} joint {}", robot.name, other.name);
        assert_eq!(joint.name, other.name);
        let kind = match other.joint_type {
            JointType::Revolute => JointKind::Revolute,
            JointType::Continuous => JointKind::Continuous,
            JointType::Prismatic => JointKind::Prismatic,
            JointType::Fixed => JointKind::Fixed,
            _ => JointKind::Other,
        };
        assert_eq!(joint.kind, kind, "{what}");
        assert_eq!((link(joint.parent), link(joint.child)), (other.parent.link.as_str(), other.child.link.as_str()));
        same_pose(&what, &joint.origin, &other.origin);
        if kind.is_actuated() {
            let length = other.axis.xyz.iter().map(|x| x * x).sum::<f64>().sqrt();
            (0..3).for_each(|i| close(&format!("{what} axis"), joint.axis[i], other.axis.xyz[i] / length, 1e-15));
        }
        if kind.is_actuated() && kind != JointKind::Continuous {
            for (ours, theirs) in [(joint.lower, other.limit.lower), (joint.upper, other.limit.upper)] {
                close(&format!("{what} limit"), ours.unwrap_or(0.0), theirs, 1e-15);
            }
        }
        for (ours, theirs) in [(joint.effort, other.limit.effort), (joint.velocity, other.limit.velocity)] {
            close(&format!("{what} bound"), ours.unwrap_or(0.0), theirs, 1e-15);
        }
        assert_eq!(joint.mimic.is_some(), other.mimic.is_some(), "{what}");
        if let Some(dynamics) = &other.dynamics {
            close(&format!("{what} damping"), joint.damping.unwrap_or(0.0), dynamics.damping, 1e-15);
            close(&format!("{what} friction"), joint.friction.unwrap_or(0.0), dynamics.friction, 1e-15);
        }
    }
}

fn same_links(model: &Model, robot: &urdf_rs::Robot) {
    assert_eq!(model.links().len(), robot.links.len());
    for (link, other) in model.links().iter().zip(&robot.links) {
        assert_eq!(link.name, other.name);
        let (what, theirs) = (format!("{} link {}", robot.name, other.name), &other.inertial);
        let Some(ours) = &link.inertial else {
            close(&what, 0.0, theirs.mass.value, 0.0);
            continue;
        };
        close(&what, ours.mass, theirs.mass.value, 1e-15);
        same_pose(&what, &Pose { position: ours.com, rotation: ours.rotation }, &theirs.origin);
        let i = &theirs.inertia;
        for (ours, theirs) in
            ours.inertia.concat().iter().zip([i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz])
        {
            close(&what, *ours, theirs, 1e-15);
        }
    }
}

fn same(file: &Path, options: &ModelOptions) {
    let (model, robot) = (Model::from_urdf_file(file, options).unwrap(), urdf_rs::read_file(file).unwrap());
    same_links(&model, &robot);
    same_joints(&model, &robot);
}

#[test]
fn own_robots() {
    for file in [
        "benches/arm7_bench",
        "tests/data/golden/arm7",
        "python/pliant/robots/so101_like",
        "python/pliant/robots/koch_like",
    ] {
        let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
        same(&root().join(file).with_extension("urdf"), &options);
    }
}

#[test]
fn third_party_robots() {
    let Ok(folders) = std::fs::read_dir(root().join("../shared/robots")) else {
        println!("skipped: no third-party robots beside the repository");
        return;
    };
    for folder in folders.map(|entry| entry.unwrap().path()) {
        let reference = folder.join("reference_fk.json");
        if reference.is_file() {
            let reference = json(&reference);
            let text = |key: &str| reference[key].as_str().unwrap().to_owned();
            let options = ModelOptions { base: Some(text("base")), tip: Some(text("tip")), ..ModelOptions::default() };
            same(&folder.join(text("urdf")), &options);
        }
    }
}
