//! Helpers of the tests: data files, reference implementations, finite differences, comparison.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use pliant_core::model::{JointKind, Model, ModelOptions};
use pliant_core::pose::Pose;
use serde_json::Value;

/// Returns the root folder of the workspace.
pub(crate) fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Returns the path of a file in `rust/core/tests/data`.
pub(crate) fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Reads a JSON file.
pub(crate) fn json(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap()
}

/// Returns the numbers of a JSON array.
pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

/// Returns the rows of a nested JSON array.
pub(crate) fn matrix(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().unwrap().iter().map(numbers).collect()
}

/// Returns the arm `arm7` of the golden data.
pub(crate) fn arm7() -> Model {
    Model::from_urdf_file(root().join("tests/data/golden/arm7.urdf"), &ModelOptions::default()).unwrap()
}

/// Reads a robot of `data/robots`, from `base` to `tool`.
pub(crate) fn robot(name: &str) -> Model {
    Model::from_urdf_file(data("robots").join(name).with_extension("urdf"), &between("base", "tool")).unwrap()
}

/// Returns the pose of every link in the base, by recursion over the whole tree: a reference implementation, to check
/// the fast kinematics.
pub(crate) fn link_poses(model: &Model, q: &[f64]) -> Vec<Isometry3<f64>> {
    let mut poses = vec![Isometry3::identity(); model.links().len()];
    let root = model.links().iter().position(|link| link.parent_joint.is_none()).unwrap();
    let mut stack = vec![root];
    while let Some(parent) = stack.pop() {
        for joint in model.joints().iter().filter(|joint| joint.parent == parent) {
            let value = match (joint.q_index, joint.mimic) {
                (Some(i), Some(mimic)) => mimic.multiplier * q[i] + mimic.offset,
                (Some(i), None) => q[i],
                (None, _) => joint.locked_at.unwrap_or(0.0),
            };
            let axis = Vector3::from(joint.axis);
            let motion = match joint.kind {
                JointKind::Revolute | JointKind::Continuous => Isometry3::rotation(axis * value),
                JointKind::Prismatic => Isometry3::translation(axis[0] * value, axis[1] * value, axis[2] * value),
                JointKind::Fixed | JointKind::Other => Isometry3::identity(),
            };
            poses[joint.child] = poses[parent] * isometry(&joint.origin) * motion;
            stack.push(joint.child);
        }
    }
    let base = model.links().iter().position(|link| link.name == model.base()).unwrap();
    let root_from_base = poses[base];
    poses.into_iter().map(|pose| root_from_base.inverse() * pose).collect()
}

/// Returns the pose of the tool in the base, by [`link_poses`].
pub(crate) fn slow_tool(model: &Model, q: &[f64]) -> Isometry3<f64> {
    let tip = model.links().iter().position(|link| link.name == model.tip()).unwrap();
    link_poses(model, q)[tip]
}

/// Returns the potential energy [J] of all bodies and the payload, computed with [`link_poses`].
pub(crate) fn potential_energy(model: &Model, q: &[f64]) -> f64 {
    let g = Vector3::from(model.gravity_vector());
    let of =
        |pose: &Isometry3<f64>, mass: f64, com: [f64; 3]| -mass * g.dot(&(pose * nalgebra::Point3::from(com)).coords);
    let bodies = link_poses(model, q);
    let links: f64 = bodies
        .iter()
        .zip(model.links())
        .filter_map(|(pose, link)| link.inertial.map(|i| of(pose, i.mass, i.com)))
        .sum();
    links + model.payload().map_or(0.0, |payload| of(&slow_tool(model, q), payload.mass, payload.com))
}

pub(crate) fn isometry(pose: &Pose) -> Isometry3<f64> {
    let matrix = Matrix3::from_fn(|i, j| pose.rotation[i][j]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Isometry3::from_parts(Translation3::from(Vector3::from(pose.position)), rotation)
}

/// Returns joint positions inside the limits (±π for continuous joints), determined by `seed`.
pub(crate) fn state(model: &Model, seed: usize) -> Vec<f64> {
    (0..model.n())
        .map(|k| {
            let pi = std::f64::consts::PI;
            let (lower, upper) = (model.lower()[k].max(-pi), model.upper()[k].min(pi));
            lower + ((seed * 16 + k) as f64 * 0.618_033_988_749_895).fract() * (upper - lower)
        })
        .collect()
}

/// Returns model options with this base and tip.
pub(crate) fn between(base: &str, tip: &str) -> ModelOptions {
    ModelOptions { base: Some(base.into()), tip: Some(tip.into()), ..ModelOptions::default() }
}

/// Returns the derivative of `f` at `x` by central differences: one row per output, one column per entry of `x`.
///
/// The step balances truncation (h²) against rounding (ε/h); the relative error is near 1e-10.
pub(crate) fn finite_difference(f: impl Fn(&[f64]) -> Vec<f64>, x: &[f64]) -> Vec<Vec<f64>> {
    let h = 6e-6;
    let mut x = x.to_vec();
    let columns: Vec<Vec<f64>> = (0..x.len())
        .map(|k| {
            let at = x[k];
            x[k] = at + h;
            let high = f(&x);
            x[k] = at - h;
            let low = f(&x);
            x[k] = at;
            high.iter().zip(&low).map(|(a, b)| (a - b) / (2.0 * h)).collect()
        })
        .collect();
    (0..columns.first().map_or(0, Vec::len)).map(|i| columns.iter().map(|c| c[i]).collect()).collect()
}

/// Asserts that two numbers differ by at most `tolerance`.
#[track_caller]
pub(crate) fn close(what: &str, got: f64, want: f64, tolerance: f64) {
    assert!((got - want).abs() <= tolerance, "{what}: got {got}, want {want}, off by {:e}", (got - want).abs());
}
