//! Time of each stage of the kinematics on the bench arm; 64 states in turn, so that no result can be reused.
#![expect(clippy::expect_used, reason = "a bench without its robot cannot go on")]

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pliant_core::{JointFrames, JointVec, MAX_AXES, MAX_JOINTS, Model, ModelOptions};

const STATES: usize = 64;

fn arm() -> Model {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("arm7_bench.urdf");
    Model::from_urdf_file(path, &ModelOptions::default()).expect("the bench arm is part of the repository")
}

/// Returns states spread over the joint ranges by a golden-ratio sequence.
fn states(model: &Model) -> Vec<JointVec> {
    (0..STATES)
        .map(|i| {
            let mut q = [0.0; MAX_JOINTS];
            for k in 0..model.n() {
                let fraction = ((i * model.n() + k) as f64 * 0.618_033_988_749_895).fract();
                q[k] = model.lower()[k] + fraction * (model.upper()[k] - model.lower()[k]);
            }
            q
        })
        .collect()
}

fn kinematics(criterion: &mut Criterion) {
    let model = arm();
    let chain = model.chain();
    let masses = chain.masses(None);
    let states = states(&model);
    let mut frames = JointFrames::default();
    let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    let mut torque = [0.0; MAX_JOINTS];

    let mut group = criterion.benchmark_group("kinematics");
    group.throughput(Throughput::Elements(STATES as u64));
    group.bench_function("forward", |b| {
        b.iter(|| {
            for q in &states {
                chain.forward(black_box(q), &mut frames);
                black_box(&frames);
            }
        });
    });
    group.bench_function("jacobian", |b| {
        b.iter(|| {
            for _ in &states {
                chain.jacobian(black_box(&frames), &mut rows);
                black_box(&rows);
            }
        });
    });
    group.bench_function("forward_and_jacobian", |b| {
        b.iter(|| {
            for q in &states {
                chain.forward(black_box(q), &mut frames);
                chain.jacobian(&frames, &mut rows);
                black_box((&frames.tool, &rows));
            }
        });
    });
    group.bench_function("gravity", |b| {
        b.iter(|| {
            for _ in &states {
                chain.gravity(black_box(&frames), &masses, model.gravity_vector(), &mut torque);
                black_box(&torque);
            }
        });
    });
    group.finish();

    let target = model.forward_kinematics(&states[3][..model.n()]).expect("a state of this arm");
    let start = &states[4][..model.n()];
    criterion.bench_function("inverse_kinematics", |b| {
        b.iter(|| model.inverse_kinematics(black_box(&target), start, &pliant_core::IkOptions::default()));
    });
    let text = include_str!("arm7_bench.urdf");
    criterion
        .bench_function("from_urdf", |b| b.iter(|| Model::from_urdf_str(black_box(text), &ModelOptions::default())));
}

criterion_group!(benches, kinematics);
criterion_main!(benches);
