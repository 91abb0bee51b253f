//! Arbitrary URDF text: a model with finite kinematics, or an error; memory use is bounded by the size of the text.

use std::sync::Arc;

use pliant_core::kinematics::Reference;
use pliant_core::{Controller, Model, ModelOptions, Servos, Settings, StepInput};

use super::allocator::peak;
use super::checks::{assert_explained, assert_sendable};

/// Bound on the memory use: bytes per byte of text, plus a constant number of bytes.
const BYTES_PER_BYTE: usize = 400;
const CONSTANT_BYTES: usize = 1 << 20;

/// Reads the bytes as URDF, with the default tip and with the tip `tool`; uses the model if there is one.
pub fn run(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    for tip in [None, Some("tool".to_owned())] {
        let options = ModelOptions { tip, ..ModelOptions::default() };
        let (result, bytes) = peak(|| Model::from_urdf_str(text, &options));
        assert!(bytes <= CONSTANT_BYTES + BYTES_PER_BYTE * text.len(), "{bytes} bytes for a text of {}", text.len());
        match result {
            Ok(model) => use_model(model),
            Err(error) => assert_explained(&error),
        }
    }
}

fn use_model(model: Model) {
    let n = model.n();
    for share in [0.0, 0.3, 1.0] {
        let within = |i: usize| {
            let (low, high) = (model.lower()[i].max(-1e3), model.upper()[i].min(1e3));
            low + share * (high - low)
        };
        let q: Vec<f64> = (0..n).map(within).collect();
        let (pose, jacobian) = model.kinematics(&q, Reference::WorldAligned).unwrap();
        assert!(pose.position.iter().chain(pose.rotation.iter().flatten()).all(|x| x.is_finite()), "{pose:?}");
        assert!(jacobian.iter().all(|x| x.is_finite()), "{jacobian}");
        assert!(model.gravity(&q).unwrap().iter().all(|x| x.is_finite()));
    }
    let q: Vec<f64> = (0..n).map(|i| 0.0_f64.clamp(model.lower()[i], model.upper()[i])).collect();
    let target = model.forward_kinematics(&q).unwrap();
    let servos = Servos::new(vec![150.0], vec![60.0]);
    match Controller::new(Arc::new(model), Settings::default(), Some(servos)) {
        Ok(mut controller) => match controller.step(&q, &target, &StepInput::default()) {
            Ok(command) => assert_sendable(command, &vec![60.0; n]),
            Err(error) => assert_explained(&error),
        },
        Err(error) => assert_explained(&error),
    }
}
