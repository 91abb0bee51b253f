//! Nanoseconds and instructions of the hot path on one set of instructions (`PLIANT_INSTRUCTIONS`).
//!
//! Without arguments: a table of medians over short blocks, states in turn, throughput and, for steps, latency as in a
//! control loop where each call waits for the last. With `count STAGE CALLS`: nothing but those calls, for callgrind;
//! `benches/counts.py` does that.
#![allow(clippy::expect_used, clippy::print_stdout, reason = "a bench that cannot be set up has nothing to say")]

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use pliant_core::settings::{Damping, Law, Projector};
use pliant_core::task::axes::{Axis, Yields};
use pliant_core::{
    Controller, Instructions, MAX_AXES, MAX_JOINTS, Model, ModelOptions, Pose, Reference, Servos, Settings, StepInput,
};

const STATES: usize = 64;
const BLOCK: usize = 256;
const BLOCKS: usize = 400;
/// Short, so that most runs are undisturbed; on one thread.
const MANY: usize = 4096;

fn arm() -> Arc<Model> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../benches/arm7_bench.urdf");
    Arc::new(Model::from_urdf_file(path, &ModelOptions::default()).expect("the bench arm is part of the repository"))
}

fn servos() -> Servos {
    let spread = |shoulder: f64, wrist: f64| [vec![shoulder; 4], vec![wrist; 3]].concat();
    Servos {
        friction: spread(0.2, 0.1),
        damping: spread(1.2, 0.8),
        kv: spread(1.5, 0.5),
        kp_known: true,
        ..Servos::new(spread(150.0, 60.0), spread(10.7, 6.4))
    }
}

/// A closed path through the middle of the joint ranges, and targets a few centimetres off.
fn states(model: &Model) -> Vec<(Vec<f64>, Pose)> {
    (0..STATES)
        .map(|s| {
            let turn = std::f64::consts::TAU * s as f64 / STATES as f64;
            let at = |phase: f64| -> Vec<f64> {
                (0..model.n())
                    .map(|i| {
                        let (low, high) = (model.lower()[i], model.upper()[i]);
                        0.5 * (low + high) + 0.2 * (high - low) * (turn + 0.9 * i as f64 + phase).sin()
                    })
                    .collect()
            };
            let target = model.forward_kinematics(&at(0.05)).expect("a state of this arm");
            (at(0.0), target)
        })
        .collect()
}

/// Fixed λ, printed projector, posture and limit cost, no gravity, no step limits.
fn paper() -> Settings {
    let endless = Axis { step_limit: Some(f64::INFINITY), soft_step_limit: Some(f64::INFINITY), ..Axis::default() };
    let mut settings = Settings {
        damping: Damping::Fixed(0.02),
        projector: Projector::Paper,
        limit_avoidance: 0.1,
        max_tool_speed: [f64::INFINITY; 2],
        axes: [endless; 6],
        ..Settings::paper()
    };
    settings.axes[1].yields = Some(Yields::Both);
    settings.axes[1].eta = 0.9;
    settings
}

fn cap() -> Settings {
    let mut settings = Settings::default();
    settings.axes[1] = Axis { yields: Some(Yields::Both), eta: 0.9, ..Axis::default() };
    settings
}

/// Name, and what runs that many calls.
type Stage = (&'static str, Box<dyn FnMut(usize)>);

/// What is counted and timed.
fn stages(model: &Arc<Model>) -> Vec<Stage> {
    let states = states(model);
    let mut stages: Vec<Stage> = Vec::new();
    let (arm, at) = (Arc::clone(model), states.clone());
    let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    stages.push((
        "kinematics",
        Box::new(move |calls| {
            for i in 0..calls {
                let pose = arm.kinematics_into(black_box(&at[i % STATES].0), Reference::WorldAligned, &mut rows);
                black_box((pose.is_ok(), &rows));
            }
        }),
    ));
    for (name, settings) in
        [("paper", paper()), ("cap", cap()), ("impedance", Settings { law: Law::Impedance, ..cap() })]
    {
        let mut controller = Controller::new(Arc::clone(model), settings, Some(servos())).expect("settings that fit");
        let at = states.clone();
        stages.push((
            name,
            Box::new(move |calls| {
                for i in 0..calls {
                    let (q, target) = &at[i % STATES];
                    black_box(controller.step(black_box(q), black_box(target), &StepInput::default()).is_ok());
                }
            }),
        ));
    }
    stages
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn time(run: &mut dyn FnMut(usize)) -> f64 {
    let block = |run: &mut dyn FnMut(usize)| {
        let start = Instant::now();
        run(BLOCK);
        start.elapsed().as_secs_f64() * 1e9 / BLOCK as f64
    };
    (0..20).for_each(|_| run(BLOCK));
    median((0..BLOCKS).map(|_| block(run)).collect())
}

/// Millions of configurations per second.
fn batches(model: &Model) {
    let n = model.n();
    let q: Vec<f64> = states(model).into_iter().map(|state| state.0).cycle().take(MANY).flatten().collect();
    let (mut poses, mut jacobians, mut torques) = (vec![0.0; 16 * MANY], vec![0.0; 6 * n * MANY], vec![0.0; n * MANY]);
    let rate = |seconds: Vec<f64>| MANY as f64 / median(seconds) * 1e-6;
    let once = |work: &mut dyn FnMut()| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    let mut kinematics =
        || assert!(model.kinematics_batch(&q, Reference::WorldAligned, &mut poses, &mut jacobians).is_ok());
    println!("  kinematics_batch {:14.2} M/s", rate((0..400).map(|_| once(&mut kinematics)).collect()));
    let mut gravity = || assert!(model.gravity_batch(&q, &mut torques).is_ok());
    println!("  gravity_batch {:17.2} M/s", rate((0..400).map(|_| once(&mut gravity)).collect()));
}

fn main() {
    let model = arm();
    let arguments: Vec<String> = std::env::args().collect();
    let at = |i: usize| arguments.get(i).map_or("", String::as_str);
    if at(1) == "count" {
        let calls = at(3).parse().expect("a number of calls");
        let mut stages = stages(&model);
        let (_, run) = stages.iter_mut().find(|(name, _)| *name == at(2)).expect("a stage");
        run(calls);
        return;
    }
    println!("{}", Instructions::chosen());
    for (name, mut run) in stages(&model) {
        println!("  {name:24} {:8.1} ns", time(&mut run));
    }
    batches(&model);
}
