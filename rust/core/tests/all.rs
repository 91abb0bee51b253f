//! Tests of the public API, in one program, so that it is linked once and shared code is compiled once.
//!
//! Tests with their own global allocator are separate programs: `no_alloc`, `fuzz_corpus`.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests and their helpers may panic and print"
)]

mod arm;
mod batch;
mod bounds;
#[path = "oracle/cases.rs"]
mod cases;
mod clearance;
mod common;
mod contact;
mod determinism;
mod golden;
mod guards;
mod hostile;
mod hostile_step;
mod imports;
mod kinematics;
#[path = "common/many.rs"]
mod many;
mod model;
mod names;
#[path = "oracle.rs"]
mod oracle;
mod promises;
mod properties;
mod refused;
mod report;
mod robots;
mod running;
#[path = "common/seeded.rs"]
mod seeded;
mod units;
mod urdf_oracle;
