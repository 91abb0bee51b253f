#!/bin/sh
# Interprets tests of the core with Miri, on the plain path and on AVX2; docs/security.md says which and why.
# Needs rustup's nightly toolchain with the components miri and rust-src.
set -eu
root=$(CDPATH= cd -- "$(dirname -- "$0")/.." && pwd)
cd "$root"

skip() {
    printf '\n!! SKIPPED: miri: %s\n' "$1"
    exit 0
}
cargo +nightly miri --version >/dev/null 2>&1 \
    || skip "no Miri (rustup toolchain install nightly --component miri,rust-src)"
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$root/build/miri}"
# Without deterministic floats, Miri adds rounding errors to sin and exp, and tests of accuracy fail.
export MIRIFLAGS="-Zmiri-deterministic-floats -Zmiri-disable-isolation -Zmiri-ignore-leaks"

for features in "" "-Ctarget-feature=+avx2,+fma,+bmi1,+bmi2"; do
    printf '\n== miri: %s\n' "${features:-baseline}"
    RUSTFLAGS="$features" cargo +nightly miri test -p pliant-core --lib -- --test-threads=1 math::simd math::ldlt6 \
        math::rotation
    RUSTFLAGS="$features" cargo +nightly miri test -p pliant-core --test all -- --test-threads=1 --exact \
        determinism::one_instruction_set_is_deterministic determinism::instruction_sets_differ_by_rounding_only
done
