//! Estimate the force at the tool without a force sensor, from commands and joint positions.
//!
//! `cargo run --release -p pliant-core --example feel_a_touch`
#![expect(clippy::print_stdout, reason = "the example prints its result")]

mod arm;

use pliant_core::nalgebra::Vector6;
use pliant_core::{ContactEstimator, ContactInput, ContactOptions, Controller, Result, Settings, StepInput};

/// Index of z in every 6-vector.
const Z: usize = 2;

fn main() -> Result<()> {
    let model = arm::model()?;
    let mut controller = Controller::new(model.clone(), Settings::default(), Some(arm::servos()))?;
    let mut options = ContactOptions::default();
    options.touch[Z] = Some(10.0); // [N]
    let mut contact = ContactEstimator::new(&controller, options)?;

    let mut q = arm::START;
    let target = model.forward_kinematics(&q)?;
    let mut touched = false;
    for tick in 0..300 {
        let time = 0.01 * f64::from(tick); // [s]
        // A hand pushes the tool from 1 s to 2 s.
        let hand = 20.0 * (5.0 * (time - 1.0).min(2.0 - time)).clamp(0.0, 1.0); // [N]
        // Update the estimate before the step, while the servos still follow the previous command.
        let estimate = *contact.update(&controller, &q, &ContactInput::default())?;
        if estimate.touch[Z] != touched {
            touched = estimate.touch[Z];
            println!("{time:.2} s: {}", if touched { "touched" } else { "released" });
        }
        if tick % 50 == 25 {
            let (force, uncertainty) = (estimate.force[Z], estimate.uncertainty[Z]);
            println!("{time:.2} s: a hand pushes with {hand:.0} N, estimated along z: {force:.1} ± {uncertainty:.1} N");
        }
        let command = *controller.step(&q, &target, &StepInput::default())?;
        arm::advance(
            &model,
            &mut q,
            command.goal(),
            command.torque_limit(),
            &Vector6::new(0.0, 0.0, -hand, 0.0, 0.0, 0.0),
        )?;
    }
    Ok(())
}
