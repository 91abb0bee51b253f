#!/bin/sh
# Runs the tests of arrays, batches, the pool and serial ports on an extension module built with AddressSanitizer.
# usage: asan.sh PYTHON   (the project's own)
# Needs rustup's nightly toolchain and a C compiler on Linux. Everything goes into build/asan; the installed module stays.
set -eu
python=$1
root=$(CDPATH= cd -- "$(dirname -- "$0")/.." && pwd)
cd "$root"
build=$root/build/asan

skip() {
    printf '\n!! SKIPPED: asan: %s\n' "$1"
    exit 0
}
[ "$(uname -sm)" = "Linux x86_64" ] || skip "only on Linux on x86-64"
library=$(rustup run nightly rustc --print sysroot 2>/dev/null) \
    || skip "no nightly toolchain (rustup toolchain install nightly)"
library=$library/lib/rustlib/x86_64-unknown-linux-gnu/lib/librustc-nightly_rt.asan.a
[ -f "$library" ] || skip "this nightly toolchain has no AddressSanitizer"

printf '\n== extension module with AddressSanitizer\n'
mkdir -p "$build"
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$build/target}"
# With an explicit target, build scripts and macros, which run in the compiler, are built without the sanitizer.
RUSTFLAGS="-Zsanitizer=address -Cdebug-assertions=on -Cllvm-args=-inline-threshold=60" PYO3_PYTHON=$python \
    CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16 \
    cargo +nightly build --quiet --release --target x86_64-unknown-linux-gnu -p pliant-py
rm -rf "$build/python"
cp -R python "$build/python"
rm -f "$build"/python/pliant/_core*.so
cp "$CARGO_TARGET_DIR/x86_64-unknown-linux-gnu/release/lib_core.so" "$build/python/pliant/_core.abi3.so"
# rustc links the sanitizer runtime into programs only. Here it is a separate library that is loaded before Python; the
# runtime rejects the name libasan.
# The linker rejects the early initialization of the runtime, which is for programs, in a library.
cp "$library" "$build/runtime.a"
ar d "$build/runtime.a" asan_preinit.cpp.o
cc -shared -o "$build/runtime.so" -Wl,--whole-archive "$build/runtime.a" -Wl,--no-whole-archive -lpthread -ldl -lm -lrt \
    -lresolv

printf '\n== tests with AddressSanitizer\n'
# CPython does not free all memory at exit; this is not a leak of the module.
export ASAN_OPTIONS=detect_leaks=0:abort_on_error=1 LD_PRELOAD="$build/runtime.so" PYTHONPATH="$build/python:$root"
"$python" -c 'import pliant._core; assert "build/asan" in pliant._core.__file__, pliant._core.__file__'
# The module takes debug assertions as a sign of a build without optimization.
"$python" -m pytest -n0 -q -p no:cacheprovider -W 'ignore:pliant was built:RuntimeWarning' \
    tests/python/test_arrays.py tests/python/test_batch.py tests/python/test_borrows.py tests/python/test_functions.py \
    tests/python/test_pickle.py tests/python/test_pool.py tests/servo/test_transport.py \
    tests/servo/test_hostile_replies.py
