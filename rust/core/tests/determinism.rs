//! All instruction sets give the same commands up to rounding. Within one set, commands are bit-identical in every run,
//! in a clone and after a reset, and in the plain step and the step with all features.
//!
//! Also: the strength of an axis that yields in one direction only jumps with the sign of the deviation, which is rounding
//! error at the target; a direction band makes it continuous.

use std::sync::Arc;

use pliant_core::params::{Axis, CompliantSide, Damping, Law, NullSpace, PaperOptions, Projector, Settings, Tracking};
use pliant_core::{Controller, Model, ModelOptions, Pose, Servos, SimdLevel, StepInput};

use crate::many::{Arms, single};
use crate::seeded::{self, Random};

/// Number of ticks of a comparison. Miri takes seconds for each.
const TICKS: usize = if cfg!(miri) { 2 } else { 600 };

fn arm() -> Arc<Model> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/golden/arm7.urdf");
    Arc::new(Model::from_urdf_file(path, &ModelOptions::default()).unwrap())
}

/// Returns positions on a slow path through the middle of the joint ranges, and a target slightly ahead.
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

fn controller(model: &Arc<Model>, law: Law, simd_level: SimdLevel) -> Controller {
    let mut settings = if law == Law::Paper { Settings::paper() } else { Settings { law, ..Settings::default() } };
    settings.axes[1] = Axis { yields: Some(CompliantSide::Both), adaptation: 0.9, ..Axis::default() };
    let servos = Servos { friction: vec![0.2], stiffness_known: true, ..Servos::new(vec![100.0], vec![10.0]) };
    let mut controller = Controller::new(Arc::clone(model), settings, Some(servos)).unwrap();
    controller.set_simd_level(simd_level);
    controller
}

#[test]
fn instruction_sets_differ_by_rounding_only() {
    let model = arm();
    let sets = SimdLevel::available();
    assert_eq!(sets[0], SimdLevel::BASELINE);
    for law in [Law::Cap, Law::Impedance, Law::Paper] {
        for &set in &sets[1..] {
            let (mut plain, mut other) = (controller(&model, law, sets[0]), controller(&model, law, set));
            assert_eq!([plain.simd_level(), other.simd_level()], [sets[0], set]);
            for tick in 0..TICKS {
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

/// Without a direction band, the sign of the deviation determines the strength of an axis that yields to one side. At
/// rest on the target, that sign results from rounding. A band removes the jump.
#[test]
fn only_a_direction_band_makes_a_one_sided_axis_continuous_at_its_target() {
    let model = arm();
    let q = [-0.1, -0.6, 0.7, -1.7, 0.9, 0.6, -0.1];
    let home = model.forward_kinematics(&q).unwrap();
    let command = |set: SimdLevel, direction_band: Option<f64>, y: f64| {
        let mut settings = Settings::paper();
        settings.axes[1] =
            Axis { soft: Some([1.0; 2]), firm: Some([4.0; 2]), yields: Some(CompliantSide::Plus), ..Axis::default() };
        settings.paper_options.direction_band = direction_band;
        let servos = Servos { stiffness_known: true, ..Servos::new(vec![100.0], vec![60.0]) };
        let mut controller = Controller::new(Arc::clone(&model), settings, Some(servos)).unwrap();
        controller.set_simd_level(set);
        let mut target = home;
        target.position[1] += y;
        let command = *controller.step(&q, &target, &StepInput::default()).unwrap();
        (command.torque_limit().to_vec(), controller.diagnostics().axis_strength[1])
    };
    let beside = |band| [-1e-9, 1e-9].map(|y| command(SimdLevel::BASELINE, band, y).1);
    let [beyond, short] = beside(None);
    // Beyond the target the axis yields with `soft`, short of it the axis holds.
    assert!((beyond - 1.0).abs() < 1e-6 && (short - 10.0).abs() < 1e-6, "{beyond} {short}");
    let [beyond, short] = beside(Some(0.1));
    assert!((beyond - 5.5).abs() < 1e-4 && (short - 5.5).abs() < 1e-4, "{beyond} {short}");
    for set in SimdLevel::available() {
        for y in [-1e-17, 0.0, 1e-17, 1e-16] {
            let (want, _) = command(SimdLevel::BASELINE, Some(0.1), 0.0);
            for (got, want) in command(set, Some(0.1), y).0.iter().zip(want) {
                assert!((got - want).abs() <= 1e-11 * 60.0, "{set}, {y}: {got} {want}");
            }
        }
    }
}

#[test]
fn one_instruction_set_is_deterministic() {
    let model = arm();
    for set in SimdLevel::available() {
        let (mut one, mut other) = (controller(&model, Law::Cap, set), controller(&model, Law::Cap, set));
        for tick in 0..TICKS.min(50) {
            let (q, target) = state(&model, tick);
            let want = *one.step(&q, &target, &StepInput::default()).unwrap();
            assert_eq!(*other.step(&q, &target, &StepInput::default()).unwrap(), want);
        }
    }
}

/// The step without optional features is compiled for itself. An optional input, here a gradient of zeros, selects the
/// step with all features.
#[test]
fn a_plain_step_equals_a_step_with_all_features() {
    let model = arm();
    let endless = Axis { max_velocity: Some(f64::INFINITY), soft_step_limit: Some(f64::INFINITY), ..Axis::default() };
    for (case, axis) in [(0, Axis::default()), (1, endless)] {
        let mut settings = Settings {
            axes: [axis; 6],
            tracking: Tracking { damping: Damping::Fixed(0.02), ..Settings::paper().tracking },
            null_space: NullSpace { projector: Projector::Paper, limit_avoidance: 0.1, ..Settings::paper().null_space },
            ..Settings::paper()
        };
        (settings.axes[1].yields, settings.axes[1].adaptation) = (Some(CompliantSide::Both), 0.9);
        for set in SimdLevel::available() {
            let servos = Servos { stiffness_known: true, ..Servos::new(vec![100.0], vec![10.0]) };
            let mut plain = Controller::new(Arc::clone(&model), settings.clone(), Some(servos)).unwrap();
            plain.set_simd_level(set);
            let mut other = plain.clone();
            let arms = Arms::new(&mut Random::new(case), &model, TICKS.min(200));
            for (tick, (q, target)) in arms.q.chunks(7).zip(&arms.poses).enumerate() {
                let got = single(&mut plain, q, target, &StepInput::default());
                let gradient = Some([0.0; 7].as_slice());
                let want = single(&mut other, q, target, &StepInput { gradient, ..StepInput::default() });
                assert_eq!(got, want, "{set}, case {case}, tick {tick}");
                assert_eq!(plain.diagnostics(), other.diagnostics(), "{set}, case {case}, tick {tick}");
                assert_eq!(plain.snapshot(), other.snapshot(), "{set}, case {case}, tick {tick}");
            }
            // The record of a step is that of the settings and the delay with which it ran.
            for controller in [&mut plain, &mut other] {
                controller.set_delay(0.3).unwrap();
                controller.update(Settings::default()).unwrap();
            }
            assert_eq!(plain.diagnostics(), other.diagnostics(), "{set}, case {case}");
        }
    }
}

/// Runs the controller with changing settings, readings and targets; returns the bits of each command.
fn run(controller: &mut Controller, ticks: std::ops::Range<u64>) -> Vec<[u64; 14]> {
    let model = Arc::clone(controller.model());
    ticks
        .map(|tick| {
            let mut random = Random::new(1000 + tick);
            let q: Vec<f64> = (0..7).map(|i| -0.3 + 0.2 * (0.05 * tick as f64 + f64::from(i)).sin()).collect();
            let (dq, gradient) = (random.vector(7, 0.5), random.vector(7, 0.2));
            let input = StepInput {
                dt: random.pick(&[None, Some(0.008)]),
                dq: random.chance(0.3).then_some(&dq),
                gradient: random.chance(0.3).then_some(&gradient),
                ..StepInput::default()
            };
            let target = random.target(&model, &q, 0.05, 0.1);
            let command = controller.step(&q, &target, &input).unwrap();
            let mut bits = [0; 14];
            for i in 0..7 {
                bits[i] = command.goal()[i].to_bits();
                bits[7 + i] = command.torque_limit()[i].to_bits();
            }
            bits
        })
        .collect()
}

#[test]
fn equal_inputs_give_equal_bits() {
    for law in [Law::Cap, Law::Impedance, Law::Paper] {
        let settings = Settings {
            law,
            delay: 0.01,
            tracking: Tracking { integrate: 1.0, ..Settings::soft("y yaw").unwrap().tracking },
            paper_options: PaperOptions { manipulability: 0.1, ..Settings::soft("y yaw").unwrap().paper_options },
            ..Settings::soft("y yaw").unwrap()
        };
        let make = || {
            let arm = seeded::arm(0, &ModelOptions::default());
            Controller::new(arm, settings.clone(), Some(seeded::servos(0))).unwrap()
        };
        let all = run(&mut make(), 0..300);
        assert_eq!(all, run(&mut make(), 0..300));
        // A clone made during the run continues like the original, and a reset starts the run again.
        let mut original = make();
        assert_eq!(all[..150], run(&mut original, 0..150));
        let mut clone = original.clone();
        assert_eq!(all[150..], run(&mut clone, 150..300));
        assert_eq!(all[150..], run(&mut original, 150..300));
        let q: Vec<f64> = (0..7).map(|i| -0.3 + 0.2 * f64::from(i).sin()).collect();
        clone.reset(&q).unwrap();
        assert_eq!(all, run(&mut clone, 0..300));
    }
}
