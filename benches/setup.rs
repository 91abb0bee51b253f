//! Shared by the benches of the control step: arm, servos, states and the paper's settings.
#![expect(clippy::expect_used, reason = "a bench that cannot be set up has nothing to say")]

use std::path::Path;
use std::sync::Arc;

use pliant_core::params::{Axis, CompliantSide, Damping, NullSpace, Projector, Tracking};
use pliant_core::{Model, ModelOptions, Pose, Servos, Settings};

/// Number of states in one round.
pub(crate) const STATES: usize = 64;

pub(crate) fn arm() -> Arc<Model> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("arm7_bench.urdf");
    Arc::new(Model::from_urdf_file(path, &ModelOptions::default()).expect("the bench arm is part of the repository"))
}

pub(crate) fn servos() -> Servos {
    let spread = |shoulder: f64, wrist: f64| [vec![shoulder; 4], vec![wrist; 3]].concat();
    Servos {
        friction: spread(0.2, 0.1),
        damping: spread(1.2, 0.8),
        kv: spread(1.5, 0.5),
        stiffness_known: true,
        ..Servos::new(spread(150.0, 60.0), spread(10.7, 6.4))
    }
}

/// Returns a closed path through the middle of the joint ranges, and targets a few centimetres from it.
pub(crate) fn states(model: &Model) -> Vec<(Vec<f64>, Pose)> {
    let at = |s: usize, phase: f64| -> Vec<f64> {
        let turn = std::f64::consts::TAU * s as f64 / STATES as f64;
        (0..model.n())
            .map(|i| {
                let (low, high) = (model.lower()[i], model.upper()[i]);
                0.5 * (low + high) + 0.2 * (high - low) * (turn + 0.9 * i as f64 + phase).sin()
            })
            .collect()
    };
    let pose = |q: &[f64]| model.forward_kinematics(q).expect("a state of this arm");
    (0..STATES).map(|s| (at(s, 0.0), pose(&at(s, 0.05)))).collect()
}

/// Returns settings of law `paper`: fixed λ, the paper's projector, posture and limit cost, no gravity, no step limits.
pub(crate) fn paper() -> Settings {
    let endless = Axis { max_velocity: Some(f64::INFINITY), soft_step_limit: Some(f64::INFINITY), ..Axis::default() };
    let mut settings = Settings {
        axes: [endless; 6],
        tracking: Tracking { damping: Damping::Fixed(0.02), ..Settings::paper().tracking },
        null_space: NullSpace { projector: Projector::Paper, limit_avoidance: 0.1, ..Settings::paper().null_space },
        ..Settings::paper()
    };
    (settings.axes[1].yields, settings.axes[1].adaptation) = (Some(CompliantSide::Both), 0.9);
    settings
}
