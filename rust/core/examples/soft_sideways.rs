//! Soft along y, stiff along the other axes: print the commands while a force pushes the tool.
//!
//! `cargo run --release -p pliant-core --example soft_sideways`
#![expect(clippy::print_stdout, reason = "the example prints its result")]

mod arm;

use pliant_core::nalgebra::Vector6;
use pliant_core::{Axis, Controller, Result, Settings, StepInput};

fn main() -> Result<()> {
    let model = arm::model()?;
    let mut settings = Settings::default();
    settings.set_axes("y", Axis { soft: Some([4.0; 2]), firm: Some([15.0; 2]), ..Axis::default() })?; // [N]
    let mut controller = Controller::new(model.clone(), settings, Some(arm::servos()))?;

    let mut q = arm::START;
    let target = model.forward_kinematics(&q)?;
    println!(
        "push along   y [N]   z [N]   moved y [mm]   z [mm]   lead goal − q of joint 2 [rad]   torque limit [N·m]"
    );
    for (y, z) in [(0.0, 0.0), (3.0, 0.0), (6.0, 0.0), (10.0, 0.0), (0.0, 10.0), (0.0, 0.0)] {
        let push = Vector6::new(0.0, y, z, 0.0, 0.0, 0.0);
        let mut command = *controller.step(&q, &target, &StepInput::default())?;
        for _ in 0..300 {
            arm::advance(&model, &mut q, command.goal(), command.torque_limit(), &push)?;
            command = *controller.step(&q, &target, &StepInput::default())?;
        }
        let at = model.forward_kinematics(&q)?.position;
        let moved = |axis: usize| 1e3 * (at[axis] - target.position[axis]);
        let (lead, limit) = (command.goal()[1] - q[1], command.torque_limit()[1]);
        println!("{y:>18.0}{z:>8.0}{:>15.1}{:>9.1}{lead:>33.3}{limit:>21.2}", moved(1), moved(2));
    }
    Ok(())
}
