//! Invariants that several targets share.

use pliant_core::{Command, Controller, Error};

/// Relative difference that the documentation allows between instruction sets and between single and batch steps.
pub const TOLERANCE: f64 = 1e-11;

/// Panics unless the error has a subject and a short explanation.
pub fn assert_explained(error: &Error) {
    let (what, rest) = match error {
        Error::Urdf { source_name, message, .. } => (source_name, message.clone()),
        Error::FrameNotFound { frame, available } => (frame, format!("{available:?}")),
        Error::OutOfRange { what, bound, .. } => (what, bound.clone()),
        Error::Shape { what, got, expected } => (what, format!("{got}{expected}")),
        Error::Config { key, message } => (key, message.clone()),
        other => panic!("unknown kind of error: {other}"),
    };
    assert!(!what.trim().is_empty() || matches!(error, Error::FrameNotFound { .. }), "no subject: {error:?}");
    assert!(rest.len() > 2, "no explanation: {error:?}");
    assert!(error.to_string().len() < 20_000, "a message of {} bytes", error.to_string().len());
}

/// Panics unless goals are finite, torque limits within [0, ceiling] and speed limits above 0.
pub fn assert_sendable(command: &Command, ceiling: &[f64]) {
    assert!(command.goal().iter().all(|goal| goal.is_finite()), "{command:?}");
    let within = command.torque_limit().iter().zip(ceiling).all(|(limit, ceiling)| (0.0..=*ceiling).contains(limit));
    assert!(within && command.torque_limit().len() == ceiling.len(), "{command:?} above {ceiling:?}");
    assert!(command.speed_limit().iter().all(|speed| *speed > 0.0), "{command:?}");
}

/// Returns the bits of a command.
pub fn bits(command: &Command) -> Vec<u64> {
    let all = command.goal().iter().chain(command.torque_limit()).chain(command.speed_limit());
    all.map(|value| value.to_bits()).collect()
}

/// Panics unless two rows agree within [`TOLERANCE`] of the largest number in `want`.
pub fn assert_near(what: impl Fn() -> String, got: &[f64], want: &[f64]) {
    let size = want.iter().filter(|value| value.is_finite()).fold(0.0_f64, |size, value| size.max(value.abs()));
    for (g, w) in got.iter().zip(want) {
        let near = g.to_bits() == w.to_bits() || (g - w).abs() <= TOLERANCE * size;
        assert!(near, "{}: {g:e} and {w:e} in {got:?}, {want:?}", what());
    }
}

/// Returns the largest torque limit of each joint: the servos' usable torque, else the effort limit of the model.
pub fn ceiling(controller: &Controller) -> Vec<f64> {
    let model = controller.model();
    match controller.servos() {
        Some(servos) => servos.for_joints(model.n()).unwrap().max_torque,
        None => model.effort_limit().iter().map(|effort| effort.unwrap_or(f64::INFINITY)).collect(),
    }
}
