//! Runs the fuzz targets with the stable compiler, on the inputs in `fuzz/corpus` and on random ones.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests and their helpers may panic, and print the input that fails"
)]

use std::fs;
use std::path::Path;

#[path = "common/seeded.rs"]
mod seeded;
#[path = "../../../fuzz/src/lib.rs"]
#[allow(
    unreachable_pub,
    clippy::pedantic,
    reason = "a library of its own for cargo-fuzz, which is linted as a module here"
)]
mod targets;

#[global_allocator]
static ALLOCATOR: targets::allocator::Counting = targets::allocator::Counting;

/// Returns the number of random inputs per target: the environment variable `PLIANT_FUZZ`, default 200.
fn random_inputs() -> usize {
    std::env::var("PLIANT_FUZZ").ok().and_then(|count| count.parse().ok()).unwrap_or(200)
}

fn replay(name: &str) {
    let (_, run) = targets::TARGETS.iter().find(|(known, _)| *known == name).unwrap();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus").join(name);
    let mut files: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(files.len() > 5, "{} holds {} inputs", folder.display(), files.len());
    for file in files {
        println!("{}", file.display()); // The last line printed before a panic names the input that fails.
        run(&fs::read(&file).unwrap());
    }
    let mut random = seeded::Random::new(7);
    for _ in 0..random_inputs() {
        let length = random.below(300);
        // Prefer small bytes: they select usual numbers, so that a run gets beyond its first call.
        let byte = |random: &mut seeded::Random| match random.below(3) {
            0 => random.next().to_le_bytes()[0],
            1 => random.next().to_le_bytes()[0] % 8,
            _ => 0,
        };
        let bytes: Vec<u8> = (0..length).map(|_| byte(&mut random)).collect();
        if let Err(panic) = std::panic::catch_unwind(|| run(&bytes)) {
            println!("random input: {bytes:?}");
            std::panic::resume_unwind(panic);
        }
    }
}

#[test]
fn arm() {
    replay("arm");
}

#[test]
fn batch() {
    replay("batch");
}

#[test]
fn contact() {
    replay("contact");
}

#[test]
fn equations() {
    replay("equations");
}

#[test]
fn settings() {
    replay("settings");
}

#[test]
fn step() {
    replay("step");
}

#[test]
fn urdf() {
    replay("urdf");
}
