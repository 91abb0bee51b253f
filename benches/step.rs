//! Time of one control step on the bench arm; 64 states in turn, so that no result can be reused.
//!
//! `paper`: fixed λ, the projector as printed in the paper, posture and limit cost, no gravity, no step limits. `defaults`: law `cap` with
//! default settings. The other benches show the time that an option adds.
#![allow(clippy::expect_used, reason = "a bench that cannot be set up has nothing to say")]

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pliant_core::params::{
    Axis, CompliantSide, Damping, Follow, Law, LimitRule, NullSpace, PaperOptions, Projector, Task, Tracking,
};
use pliant_core::task::pose_error;
use pliant_core::{Controller, Pose, Settings, StepInput};

mod setup;

use setup::{STATES, arm, paper, servos, states};

fn soft_y() -> Settings {
    let mut settings = Settings::default();
    settings.axes[1] = Axis { yields: Some(CompliantSide::Both), adaptation: 0.9, ..Axis::default() };
    settings
}

fn step(criterion: &mut Criterion) {
    let model = arm();
    let states = states(&model);
    let cases = vec![
        ("paper", paper()),
        (
            "paper, exact projector, adaptive damping",
            Settings {
                tracking: Tracking { damping: Damping::Auto, ..paper().tracking },
                null_space: NullSpace { projector: Projector::Exact, ..paper().null_space },
                ..paper()
            },
        ),
        ("defaults", Settings::default()),
        ("y yields", soft_y()),
        (
            "y yields, follow hold",
            Settings {
                paper_options: PaperOptions { follow: Some(Follow::Hold), ..soft_y().paper_options },
                ..soft_y()
            },
        ),
        (
            "y yields, sum of limits",
            Settings { paper_options: PaperOptions { limits: LimitRule::Sum, ..soft_y().paper_options }, ..soft_y() },
        ),
        ("y yields, no tool speed limit", Settings { max_tool_speed: [f64::INFINITY; 2], ..soft_y() }),
        (
            "y yields, manipulability",
            Settings { paper_options: PaperOptions { manipulability: 0.1, ..soft_y().paper_options }, ..soft_y() },
        ),
        ("y yields, integrating", Settings { tracking: Tracking { integrate: 1.0, ..soft_y().tracking }, ..soft_y() }),
        ("impedance, y yields", Settings { law: Law::Impedance, ..soft_y() }),
        ("xyz", Settings { task: Task::parse("xyz").expect("three axes"), ..Settings::default() }),
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
