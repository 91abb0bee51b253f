//! Fuzz targets of the core: each interprets arbitrary bytes as calls of the core, and panics if an invariant is
//! violated.
//!
//! The programs in `fuzz_targets` call them from libFuzzer; `rust/core/tests/fuzz_corpus.rs` includes this file and
//! replays the inputs in `corpus` with the stable compiler.

pub mod allocator;
pub mod arm;
pub mod batch;
pub mod contact;
pub mod equations;
pub mod settings;
pub mod step;
pub mod urdf;

mod arms;
mod checks;
mod input;

/// A fuzz target: accepts arbitrary bytes, and panics if an invariant is violated.
pub type Target = fn(&[u8]);

/// Names of the targets, as in `fuzz_targets` and `corpus`, and their functions.
pub const TARGETS: [(&str, Target); 7] = [
    ("arm", arm::run),
    ("batch", batch::run),
    ("contact", contact::run),
    ("equations", equations::run),
    ("settings", settings::run),
    ("step", step::run),
    ("urdf", urdf::run),
];
