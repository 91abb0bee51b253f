#![no_main]

use pliant_fuzz::allocator::Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

libfuzzer_sys::fuzz_target!(|data: &[u8]| pliant_fuzz::urdf::run(data));
