//! Poses, Jacobians and gravity against independent values and against each other.

mod common;

use common::{arm7, close, json, matrix, numbers, root};
use pliant_core::kinematics::Reference;

#[test]
fn arm7_agrees_with_the_golden_values() {
    let model = arm7();
    let cases = json(root().join("tests/data/golden/golden.json"));
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
