//! What the test files share: data, finite differences, comparison.
#![allow(dead_code, reason = "each test file is a crate of its own and uses a part of this")]

use std::path::PathBuf;

use pliant_core::model::{Model, ModelOptions};
use serde_json::Value;

/// The workspace's root.
pub(crate) fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A file of `rust/core/tests/data`.
pub(crate) fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// JSON of a file.
pub(crate) fn json(path: PathBuf) -> Value {
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap()
}

/// Numbers of a JSON array.
pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

/// Numbers of a nested JSON array.
pub(crate) fn matrix(value: &Value) -> Vec<Vec<f64>> {
    value.as_array().unwrap().iter().map(numbers).collect()
}

/// The built-in arm.
pub(crate) fn arm7() -> Model {
    Model::from_urdf_file(root().join("tests/data/golden/arm7.urdf"), &ModelOptions::default()).unwrap()
}

/// Options with a base and a tip.
pub(crate) fn between(base: &str, tip: &str) -> ModelOptions {
    ModelOptions { base: Some(base.into()), tip: Some(tip.into()), ..ModelOptions::default() }
}

/// Derivative of `f` at `x` by central differences: one row per output, one column per entry of `x`.
///
/// The step balances truncation (h²) against rounding (ε/h): relative errors near 1e-10.
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

/// Asserts that two numbers agree.
#[track_caller]
pub(crate) fn close(what: &str, got: f64, want: f64, tolerance: f64) {
    assert!((got - want).abs() <= tolerance, "{what}: got {got}, want {want}, off by {:e}", (got - want).abs());
}
