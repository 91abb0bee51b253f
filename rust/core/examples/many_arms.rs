//! Step a thousand arms in one call, each with its own state.
//!
//! `cargo run --release -p pliant-core --example many_arms`
#![expect(clippy::print_stdout, reason = "the example prints its result")]

mod arm;

use std::time::Instant;

use pliant_core::nalgebra::Vector6;
use pliant_core::{BatchCommand, BatchInput, BatchState, Controller, Model, Reference, Result, Settings, Targets};

const ARMS: usize = 1000;
const TICKS: usize = 100;

fn main() -> Result<()> {
    let model = arm::model()?;
    let controller = Controller::new(model.clone(), Settings::default(), Some(arm::servos()))?;
    let n = model.n();

    // Row-major, one row per arm. Each arm starts at slightly different positions.
    let mut q: Vec<f64> = (0..ARMS * n).map(|i| arm::START[i % n] + 0.1 * (0.37 * i as f64).sin()).collect();
    let target = model.forward_kinematics(&arm::START)?;
    let mut state = BatchState::new(n, ARMS)?;
    let [mut goal, mut torque_limit, mut velocity] = [(); 3].map(|()| vec![0.0; ARMS * n]);

    println!("farthest tool from its target: {:.1} mm", 1e3 * farthest(&model, &q, target.position)?);
    let mut seconds = 0.0;
    for _ in 0..TICKS {
        let begin = Instant::now();
        let input = BatchInput::new(&q, Targets::One(&target));
        let out = BatchCommand { goal: &mut goal, torque_limit: &mut torque_limit, velocity: &mut velocity };
        controller.step_batch(&input, Some(&mut state), out)?;
        seconds += begin.elapsed().as_secs_f64();
        let rows = q.chunks_exact_mut(n).zip(goal.chunks_exact(n)).zip(torque_limit.chunks_exact(n));
        for ((q, goal), limit) in rows {
            arm::advance(&model, q, goal, limit, &Vector6::zeros())?;
        }
    }
    println!("after {TICKS} ticks: {:.1} mm", 1e3 * farthest(&model, &q, target.position)?);
    println!("{:.2} µs a step and arm", 1e6 * seconds / (ARMS * TICKS) as f64);
    Ok(())
}

/// Largest distance of a tool from `target` [m].
fn farthest(model: &Model, q: &[f64], target: [f64; 3]) -> Result<f64> {
    let mut poses = vec![0.0; q.len() / model.n() * 16];
    model.kinematics_batch(q, Reference::WorldAligned, &mut poses, &mut [])?;
    let distance = |pose: &[f64]| (0..3).map(|i| (pose[4 * i + 3] - target[i]).powi(2)).sum::<f64>().sqrt();
    Ok(poses.chunks_exact(16).map(distance).fold(0.0, f64::max))
}
