//! Every set of instructions comes to the same command.
#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

use std::sync::Arc;

use pliant_core::settings::{Law, Settings};
use pliant_core::task::axes::{Axis, Yields};
use pliant_core::{Controller, Instructions, Model, ModelOptions, Pose, Servos, StepInput};

fn arm() -> Arc<Model> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/golden/arm7.urdf");
    Arc::new(Model::from_urdf_file(path, &ModelOptions::default()).unwrap())
}

/// A slow walk through the middle of the joint ranges, and targets a little ahead.
fn state(model: &Model, tick: usize) -> (Vec<f64>, Pose) {
    let at = |phase: f64| -> Vec<f64> {
        (0..model.n())
            .map(|i| {
                let (low, high) = (model.lower()[i], model.upper()[i]);
                0.5 * (low + high) + 0.2 * (high - low) * (0.01 * tick as f64 + 0.9 * i as f64 + phase).sin()
            })
            .collect()
    };
    (at(0.0), model.forward_kinematics(&at(0.02)).unwrap())
}

fn controller(model: &Arc<Model>, law: Law, instructions: Instructions) -> Controller {
    let mut settings = if law == Law::Paper { Settings::paper() } else { Settings { law, ..Settings::default() } };
    settings.axes[1] = Axis { yields: Some(Yields::Both), eta: 0.9, ..Axis::default() };
    let servos = Servos { friction: vec![0.2], kp_known: true, ..Servos::new(vec![100.0], vec![10.0]) };
    let mut controller = Controller::new(Arc::clone(model), settings, Some(servos)).unwrap();
    controller.set_instructions(instructions);
    controller
}

#[test]
fn sets_differ_by_rounding_alone() {
    let model = arm();
    let sets = Instructions::available();
    assert_eq!(sets[0], Instructions::BASELINE);
    for law in [Law::Cap, Law::Impedance, Law::Paper] {
        for &set in &sets[1..] {
            let (mut plain, mut other) = (controller(&model, law, sets[0]), controller(&model, law, set));
            for tick in 0..600 {
                let (q, target) = state(&model, tick);
                let want = *plain.step(&q, &target, &StepInput::default()).unwrap();
                let got = *other.step(&q, &target, &StepInput::default()).unwrap();
                for (got, want) in [(got.goal(), want.goal()), (got.torque_limit(), want.torque_limit())] {
                    let scale = want.iter().fold(0.0_f64, |a, x| a.max(x.abs()));
                    for (g, w) in got.iter().zip(want) {
                        assert!((g - w).abs() <= 1e-11 * scale, "{law:?}, {set}, tick {tick}: {g} {w}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_set_repeats_bit_for_bit() {
    let model = arm();
    for set in Instructions::available() {
        let (mut one, mut other) = (controller(&model, Law::Cap, set), controller(&model, Law::Cap, set));
        for tick in 0..50 {
            let (q, target) = state(&model, tick);
            let want = *one.step(&q, &target, &StepInput::default()).unwrap();
            assert_eq!(*other.step(&q, &target, &StepInput::default()).unwrap(), want);
        }
    }
}
