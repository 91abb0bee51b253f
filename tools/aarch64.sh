#!/bin/sh
# Builds the aarch64 wheel with zig, runs the core's tests and uses the wheel, both under emulation. Slow.
# usage: aarch64.sh PYTHON   (the project's own; maturin stands beside it)
# Needs rustup, Debian's qemu-user and gcc-aarch64-linux-gnu; everything else goes into build/aarch64.
set -eu
python=$1
root=$(CDPATH= cd -- "$(dirname -- "$0")/.." && pwd)
cd "$root"
build=$root/build/aarch64
target=aarch64-unknown-linux-gnu
sysroot=$build/sysroot
mkdir -p "$build"

skip() {
    printf '\n!! SKIPPED: aarch64: %s\n' "$1"
    exit 0
}
for tool in rustup qemu-aarch64 aarch64-linux-gnu-gcc; do
    command -v $tool >/dev/null || skip "$tool is not installed (Debian: apt-get install qemu-user gcc-aarch64-linux-gnu)"
done
rustup target add $target 2>/dev/null || skip "rustup has no standard library for $target to offer"

printf '\n== core tests under emulation\n'
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64 -L /usr/aarch64-linux-gnu"
cargo test --target $target -p pliant-core --quiet --no-fail-fast --lib --tests

printf '\n== wheel\n'
[ -x "$build/zig/bin/python" ] || "$python" -m venv "$build/zig"
"$build/zig/bin/python" -m pip install --quiet ziglang 'maturin>=1.9.4,<2'
unset CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER
rm -rf "$build/wheels"
PATH="$build/zig/bin:$PATH" "$build/zig/bin/maturin" build --release --zig --target $target --compatibility manylinux_2_17 \
    --interpreter python3.11 --quiet --out "$build/wheels"
ls -l "$build"/wheels/*.whl

printf '\n== the wheel under emulation\n'
if [ ! -x "$sysroot/usr/bin/python3.11" ]; then
    command -v apt-get >/dev/null || skip "the wheel is built, but there is no apt-get to fetch a Python for aarch64"
    # Use a separate package index, so that the index of this machine is unchanged.
    mkdir -p "$build/apt/lists/partial" "$build/apt/cache/archives/partial" "$build/debs" "$sysroot"
    touch "$build/apt/status"
    apt="apt-get -qq -o APT::Architecture=arm64 -o APT::Architectures=arm64 -o Dir::State=$build/apt
        -o Dir::State::status=$build/apt/status -o Dir::State::lists=$build/apt/lists -o Dir::Cache=$build/apt/cache
        -o APT::Sandbox::User=root"
    $apt update
    (cd "$build/debs" && $apt download python3.11-minimal libpython3.11-minimal libpython3.11-stdlib libc6 libgcc-s1 \
        libstdc++6 zlib1g libexpat1 libssl3 libffi8 libbz2-1.0 liblzma5 libuuid1 libcrypt1)
    for deb in "$build"/debs/*.deb; do dpkg -x "$deb" "$sysroot"; done
fi
packages=$build/site
rm -rf "$packages"
"$build/zig/bin/python" -m pip install --quiet --no-deps --only-binary=:all: --python-version 3.11 --implementation cp \
    --platform manylinux_2_27_aarch64 --platform manylinux_2_28_aarch64 --platform manylinux_2_17_aarch64 \
    --target "$packages" 'numpy>=1.26' "$build"/wheels/*.whl
PYTHONHOME=$sysroot/usr PYTHONPATH=$packages qemu-aarch64 -L "$sysroot" "$sysroot/usr/bin/python3.11" tools/aarch64_check.py
