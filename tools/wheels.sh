#!/bin/sh
# Builds the wheel of every platform, the source distribution and the bill of materials into build/wheels-all, and
# checks them. The same commit gives the same bytes in every folder. Slow: two minutes of CPU time per wheel.
# usage: wheels.sh PYTHON [TARGET...]   (the project's own Python; Rust targets, all by default)
# WHEEL_TOOLS: environment of the tools, build/wheel-tools by default.
# Needs rustup, and Debian's gcc-mingw-w64-x86-64 for Windows; zig, the linker of the others, comes from a Python package.
set -eu
python=$1
shift
root=$(CDPATH= cd -- "$(dirname -- "$0")/.." && pwd)
cd "$root"
out=$root/build/wheels-all
tools=${WHEEL_TOOLS:-$root/build/wheel-tools}
targets=${*:-x86_64-unknown-linux-gnu aarch64-unknown-linux-gnu x86_64-unknown-linux-musl aarch64-unknown-linux-musl
    aarch64-apple-darwin x86_64-apple-darwin x86_64-pc-windows-gnu}

[ -x "$tools/bin/python" ] || "$python" -m venv "$tools"
# Another version of these may give other bytes.
"$tools/bin/python" -m pip install --quiet ziglang==0.17.1 maturin==1.16.0 zopflipy==1.14 twine==7.0.0 abi3audit==0.0.26 cyclonedx-python-lib[json-validation]==11.12.0
mkdir -p "$out"
export PATH="$tools/bin:$PATH"
# The flags of .cargo/config.toml stay; these keep the folders of this machine out of the binary.
export CARGO_BUILD_RUSTFLAGS="--remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}/registry/src= --remap-path-prefix=$root="
# Files in the archives have the time of the commit.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct)}
export SOURCE_DATE_EPOCH

"$tools/bin/maturin" sdist --manifest-path rust/py/Cargo.toml --out "$out"
twine check --strict "$out"/*.tar.gz
python tools/sbom.py "$out"
missing=0
for target in $targets; do
    printf '\n== wheel for %s\n' "$target"
    if ! rustup target add "$target" >/dev/null 2>&1; then
        printf '!! SKIPPED: rustup has no standard library for %s to offer\n' "$target"
        missing=1
        continue
    fi
    case $target in
        *-linux-gnu) linker="--zig --compatibility manylinux_2_17" ;;
        *-linux-musl) linker="--zig --compatibility musllinux_1_2" ;;
        *-apple-darwin) linker=--zig ;;
        *-windows-gnu) linker=
            if ! command -v x86_64-w64-mingw32-gcc >/dev/null; then
                printf '!! SKIPPED: no linker for Windows (Debian: apt-get install gcc-mingw-w64-x86-64)\n'
                missing=1
                continue
            fi ;;
        *) echo "error: no rule for the target $target" >&2; exit 2 ;;
    esac
    rm -rf "${out:?}/$target"
    # shellcheck disable=SC2086
    maturin build --release --locked --quiet --manifest-path rust/py/Cargo.toml --target "$target" $linker \
        --interpreter python3.11 --compression-level 9 --out "$out/$target"
    python tools/recompress_wheel.py "$out/$target"/*.whl
    twine check --strict "$out/$target"/*.whl
    abi3audit --strict "$out/$target"/*.whl
    ls -l "$out/$target"/*.whl
done
exit $missing
