//! Time of one control step, natively, on the bench arm; 64 states in turn, so that nothing is remembered.
//!
//! `paper`: fixed λ, printed projector, posture and limit cost, no gravity, no step limits. `defaults`: law `cap` as it
//! comes. The others show what an option costs.
#![allow(clippy::expect_used, reason = "a bench that cannot be set up has nothing to say")]

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pliant_core::settings::{Damping, Follow, Law, LimitRule, Projector};
use pliant_core::task::axes::{Axis, Task, Yields};
use pliant_core::task::deviation::pose_error;
use pliant_core::{Controller, Model, ModelOptions, Pose, Servos, Settings, StepInput};

const STATES: usize = 64;

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

fn paper() -> Settings {
    let endless = Axis { step_limit: Some(f64::INFINITY), soft_step_limit: Some(f64::INFINITY), ..Axis::default() };
    let mut settings = Settings {
        damping: Damping::Fixed(0.02),
        projector: Projector::Paper,
        limit_avoidance: 0.1,
        axes: [endless; 6],
        ..Settings::paper()
    };
    settings.axes[1].yields = Some(Yields::Both);
    settings.axes[1].eta = 0.9;
    settings
}

fn soft_y() -> Settings {
    let mut settings = Settings::default();
    settings.axes[1] = Axis { yields: Some(Yields::Both), eta: 0.9, ..Axis::default() };
    settings
}

fn step(criterion: &mut Criterion) {
    let model = arm();
    let states = states(&model);
    let cases = vec![
        ("paper", paper()),
        (
            "paper, exact projector, adaptive damping",
            Settings { projector: Projector::Exact, damping: Damping::Auto, ..paper() },
        ),
        ("defaults", Settings::default()),
        ("y yields", soft_y()),
        ("y yields, follow hold", Settings { follow: Some(Follow::Hold), ..soft_y() }),
        ("y yields, sum of limits", Settings { limits: LimitRule::Sum, ..soft_y() }),
        ("y yields, no tool speed limit", Settings { max_tool_speed: [f64::INFINITY; 2], ..soft_y() }),
        ("y yields, manipulability", Settings { manipulability: 0.1, ..soft_y() }),
        ("y yields, integrating", Settings { integrate: 1.0, ..soft_y() }),
        ("impedance, y yields", Settings { law: Law::Impedance, ..soft_y() }),
        ("xyz", Settings { task: Task::of("xyz").expect("three axes"), ..Settings::default() }),
    ];
    let mut group = criterion.benchmark_group("step");
    group.throughput(Throughput::Elements(STATES as u64));
    for (name, settings) in cases {
        let mut controller =
            Controller::new(Arc::clone(&model), settings, Some(servos())).expect("settings that fit the bench arm");
        group.bench_function(name, |b| {
            b.iter(|| {
                for (q, target) in &states {
                    let command = controller.step(black_box(q), black_box(target), &StepInput::default());
                    black_box(command.is_ok());
                }
            });
        });
    }
    group.finish();

    let poses: Vec<Pose> =
        states.iter().map(|(q, _)| model.forward_kinematics(q).expect("a state of this arm")).collect();
    let mut group = criterion.benchmark_group("stage");
    group.throughput(Throughput::Elements(STATES as u64));
    group.bench_function("pose_error", |b| {
        b.iter(|| {
            for (pose, (_, target)) in poses.iter().zip(&states) {
                black_box(pose_error(black_box(pose), black_box(target)));
            }
        });
    });
    let mut controller = Controller::new(Arc::clone(&model), soft_y(), Some(servos())).expect("settings that fit");
    group.bench_function("reading A of the last step", |b| {
        b.iter(|| {
            for (q, target) in states.iter().take(1) {
                black_box(controller.step(q, target, &StepInput::default()).is_ok());
            }
            for _ in 0..STATES {
                black_box(controller.activation());
            }
        });
    });
    group.finish();
}

criterion_group!(benches, step);
criterion_main!(benches);
