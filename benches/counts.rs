//! Stages of the control step for counting instructions: `counts STAGE` runs one stage, `counts --stages` lists them.
//!
//! `benches/counts.py` runs it without an argument, that is, all stages, under callgrind, and counts the instructions
//! inside [`counted`] only.
#![allow(clippy::expect_used, clippy::print_stdout, reason = "a bench that cannot be set up has nothing to say")]

use std::hint::black_box;
use std::sync::Arc;

use pliant_core::analysis::report;
use pliant_core::params::{Axis, CompliantSide, Frame, Law, NullSpace, PaperOptions, Task};
use pliant_core::task::pose_error;
use pliant_core::{
    BatchCommand, BatchInput, BatchState, Controller, JointFrames, JointVec, MAX_AXES, MAX_JOINTS, Model, Pose,
    Settings, StepInput, Targets,
};

mod setup;

use setup::{STATES, arm, paper, servos, states};

/// One stage of the bench: runs it over all states.
type Work = Box<dyn FnMut()>;

/// Joint positions [rad], each with a target pose.
type States = Vec<(Vec<f64>, Pose)>;

/// Returns the unusual states of `benches/tail.py`, in which a step should take no longer than in others.
fn rare(model: &Model) -> Vec<(&'static str, States)> {
    let (low, high) = (model.lower(), model.upper());
    let at = |s: usize, i: usize| (std::f64::consts::TAU * s as f64 / STATES as f64 + 0.9 * i as f64).sin();
    let make = |q: &dyn Fn(f64, usize) -> f64, shift: f64| -> States {
        let of = |s: usize| -> Vec<f64> { (0..model.n()).map(|i| q(at(s, i), i)).collect() };
        let pose = |q: Vec<f64>| model.forward_kinematics(&q).expect("a state of this arm");
        let near = |s: usize| of(s).iter().enumerate().map(|(i, q)| q + shift * at(s + STATES / 4, i)).collect();
        (0..STATES).map(|s| (of(s), pose(near(s)))).collect()
    };
    let ordinary = |wave: f64, i: usize| 0.5 * (low[i] + high[i]) + 0.2 * (high[i] - low[i]) * wave;
    let stretched = |wave: f64, i: usize| if (3..6).contains(&i) { 1e-3 * wave } else { ordinary(wave, i) };
    let limits = |wave: f64, i: usize| if wave > 0.0 { high[i] } else { low[i] } - 1e-9 * wave;
    let mut far = make(&ordinary, 0.02);
    for (_, target) in &mut far {
        *target = Pose { position: [0.0, 0.0, 1.0], ..Pose::IDENTITY };
    }
    let mut one = make(&|wave, i| if i == 3 { high[i] } else { ordinary(wave, i) }, 0.0);
    for (q, target) in &mut one {
        let beyond = q.iter().enumerate().map(|(i, q)| if i == 3 { q + 0.02 } else { *q }).collect::<Vec<f64>>();
        *target = model.forward_kinematics(&beyond).expect("a state of this arm");
    }
    let slow = |wave: f64, i: usize| ordinary(wave / 400.0, i);
    // The path is slow, so that the reference, within its bounds on speed and acceleration, stays at the target, which
    // is two ticks ahead.
    let mut following = make(&slow, 0.0);
    for s in 0..STATES {
        following[s].1 = model.forward_kinematics(&following[(s + 2) % STATES].0).expect("a state of this arm");
    }
    vec![
        ("following", following),
        ("singular", make(&stretched, 0.02)),
        ("one at its limit", one),
        ("at the limits", make(&limits, 0.02)),
        ("saturated", far),
        ("denormal", make(&|wave, _| 1e-310 * wave, 0.0)),
        ("at rest", make(&ordinary, 1e-310)),
    ]
}

fn soft_y(law: Law) -> Settings {
    let mut settings = Settings { law, ..Settings::default() };
    settings.axes[1] = Axis { yields: Some(CompliantSide::Both), adaptation: 0.9, ..Axis::default() };
    settings
}

/// Returns settings with options that should make a step only slightly slower.
fn options(settings: &Settings, n: usize) -> Vec<(&'static str, Settings)> {
    let task = |axes: &str, frame| Task { frame, ..Task::parse(axes).expect("axes") };
    let weights = (1..=n).map(|i| 0.5 + 0.1 * i as f64).collect::<Vec<f64>>();
    let mut five = Settings { task: task("xyz roll pitch", Frame::Base), ..settings.clone() };
    five.axes[5] = Axis::default();
    let mut all = vec![
        ("five axes", five),
        ("axes of the tool", Settings { task: task("all", Frame::Tool), ..settings.clone() }),
        (
            "posture weights",
            Settings {
                paper_options: PaperOptions {
                    posture_weights: Some(weights.clone()),
                    ..settings.paper_options.clone()
                },
                ..settings.clone()
            },
        ),
    ];
    if settings.law == Law::Paper {
        all.push((
            "joint weights",
            Settings {
                paper_options: PaperOptions { joint_weights: Some(weights), ..settings.paper_options.clone() },
                ..settings.clone()
            },
        ));
    }
    all
}

fn padded(q: &[f64]) -> JointVec {
    let mut out = [0.0; MAX_JOINTS];
    out[..q.len()].copy_from_slice(q);
    out
}

/// Benchmark of the report: steps through all states, then reports on the last pose once per state.
fn report_stage(model: &Arc<Model>, states: &States) -> Work {
    let mut controller =
        Controller::new(Arc::clone(model), soft_y(Law::Cap), Some(servos())).expect("settings that fit the bench arm");
    for (q, target) in states {
        controller.step(q, target, &StepInput::default()).expect("a state of this arm");
    }
    Box::new(move || {
        for _ in 0..STATES {
            black_box(report(black_box(&controller)).is_ok());
        }
    })
}

fn stages() -> Vec<(String, Work)> {
    let model = arm();
    let states = states(&model);
    let joints: Vec<JointVec> = states.iter().map(|(q, _)| padded(q)).collect();
    let poses: Vec<(Pose, Pose)> =
        states.iter().map(|(q, target)| (model.forward_kinematics(q).expect("a state of this arm"), *target)).collect();
    let mut stages: Vec<(String, Work)> = Vec::new();

    let (arm, at, mut frames) = (Arc::clone(&model), joints.clone(), JointFrames::default());
    stages.push((
        "forward".into(),
        Box::new(move || {
            for q in &at {
                arm.chain().forward(black_box(q), &mut frames);
                black_box(&frames);
            }
        }),
    ));
    let (arm, mut frames, mut rows) = (Arc::clone(&model), JointFrames::default(), [[0.0; MAX_JOINTS]; MAX_AXES]);
    arm.chain().forward(&joints[0], &mut frames);
    stages.push((
        "jacobian".into(),
        Box::new(move || {
            for _ in 0..STATES {
                arm.chain().jacobian(black_box(&frames), &mut rows);
                black_box(&rows);
            }
        }),
    ));
    let (arm, mut frames, mut torque) = (Arc::clone(&model), JointFrames::default(), [0.0; MAX_JOINTS]);
    arm.chain().forward(&joints[0], &mut frames);
    let masses = arm.chain().masses(None);
    stages.push((
        "gravity".into(),
        Box::new(move || {
            for _ in 0..STATES {
                arm.chain().gravity(black_box(&frames), &masses, arm.gravity_vector(), &mut torque);
                black_box(&torque);
            }
        }),
    ));
    stages.push((
        "pose_error".into(),
        Box::new(move || {
            for (pose, target) in &poses {
                black_box(pose_error(black_box(pose), black_box(target)));
            }
        }),
    ));
    let mut steps = vec![("step impedance".to_owned(), soft_y(Law::Impedance), states.clone())];
    for (law, settings) in [("paper", paper()), ("cap", soft_y(Law::Cap))] {
        steps.push((format!("step {law}"), settings.clone(), states.clone()));
        let rare = rare(&model).into_iter();
        steps.extend(rare.map(|(case, states)| (format!("step {law}, {case}"), settings.clone(), states)));
    }
    for (law, settings) in [("paper", paper()), ("cap", soft_y(Law::Cap))] {
        for (option, settings) in options(&settings, model.n()) {
            steps.push((format!("step {law}, {option}"), settings, states.clone()));
        }
    }
    let defaults = Settings::paper();
    let defaults = Settings { tracking: defaults.tracking, null_space: defaults.null_space, ..paper() };
    steps.push(("step paper, default damping and projector".into(), defaults, states.clone()));
    // In the start posture without a limit cost, the gradient is 0. The null-space column of the activation matrix is
    // then computed from the row norms of the projector.
    let waiting = Settings { null_space: NullSpace { limit_avoidance: 0.0, ..paper().null_space }, ..paper() };
    steps.push(("step paper, as it started".into(), waiting, vec![states[0].clone(); STATES]));
    for (name, settings, at) in steps {
        let mut controller =
            Controller::new(Arc::clone(&model), settings, Some(servos())).expect("settings that fit the bench arm");
        stages.push((
            name,
            Box::new(move || {
                for (q, target) in &at {
                    let command = controller.step(black_box(q), black_box(target), &StepInput::default());
                    black_box(command.is_ok());
                }
            }),
        ));
    }
    for (law, settings) in [("paper", paper()), ("cap", soft_y(Law::Cap))] {
        for with_state in [false, true] {
            let controller = Controller::new(Arc::clone(&model), settings.clone(), Some(servos())).expect("as above");
            let mut state = with_state.then(|| BatchState::new(model.n(), STATES).expect("a small one"));
            let q = states.iter().flat_map(|(q, _)| q.clone()).collect::<Vec<f64>>();
            let targets = states.iter().flat_map(|(_, target)| target.to_rows().concat()).collect::<Vec<f64>>();
            let mut out = [vec![0.0; q.len()], vec![0.0; q.len()], vec![0.0; q.len()]];
            let name = format!("batch {law}{}", if with_state { ", state" } else { "" });
            stages.push((
                name,
                Box::new(move || {
                    let targets = Targets::Poses(&targets);
                    let input = BatchInput::new(black_box(&q), targets);
                    let [goal, torque_limit, velocity] = &mut out;
                    let out = BatchCommand { goal, torque_limit, velocity };
                    black_box(controller.step_batch(&input, state.as_mut(), out).is_ok());
                }),
            ));
        }
    }
    stages.push(("report cap".into(), report_stage(&model, &states)));
    stages.push(batch_with_row_caps(&model, &states));
    stages
}

/// Returns the stage of a batch in which each arm has force caps and adaptation of its own.
fn batch_with_row_caps(model: &Arc<Model>, states: &States) -> (String, Work) {
    let controller =
        Controller::new(Arc::clone(model), soft_y(Law::Cap), Some(servos())).expect("settings that fit the bench arm");
    let mut state = BatchState::new(model.n(), STATES).expect("a small one");
    let q = states.iter().flat_map(|(q, _)| q.clone()).collect::<Vec<f64>>();
    let targets = states.iter().flat_map(|(_, target)| target.to_rows().concat()).collect::<Vec<f64>>();
    let mut out = [vec![0.0; q.len()], vec![0.0; q.len()], vec![0.0; q.len()]];
    let of_y = |value| [f64::NAN, value, f64::NAN, f64::NAN, f64::NAN, f64::NAN].repeat(STATES);
    let (caps, adaptation) = (of_y(2.0), of_y(0.5));
    (
        "batch cap, state, row caps".into(),
        Box::new(move || {
            let input = BatchInput {
                caps: Some(&caps),
                adaptation: Some(&adaptation),
                ..BatchInput::new(black_box(&q), Targets::Poses(&targets))
            };
            let [goal, torque_limit, velocity] = &mut out;
            let out = BatchCommand { goal, torque_limit, velocity };
            black_box(controller.step_batch(&input, Some(&mut state), out).is_ok());
        }),
    )
}

/// Runs one round over all states, which callgrind counts; `benches/counts.py` finds the function by its name.
#[inline(never)]
fn counted(work: &mut Work) {
    black_box(work)();
}

fn main() {
    let wanted = std::env::args().nth(1).unwrap_or_default();
    let mut stages = stages();
    if wanted == "--stages" {
        for (name, _) in &stages {
            println!("{name} {STATES}");
        }
        return;
    }
    for (name, work) in &mut stages {
        if wanted.is_empty() || **name == wanted {
            work(); // the first step of a controller resets it
            counted(work);
        }
    }
}
