#!/bin/sh
# Runs unit tests against the wheel of build/wheels on every CPython from 3.11 to 3.14 that is installed.
# usage: pythons.sh [ARGUMENT OF PYTEST...]     Each gets an environment in build/python-VERSION.
set -eu
root=$(CDPATH= cd -- "$(dirname -- "$0")/.." && pwd)
cd "$root"
wheel=$(ls build/wheels/*.whl)
unset PYTHONPATH
failed=
for version in 3.11 3.12 3.13 3.14; do
    interpreter=
    for python in "python$version" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$version".*/bin/python3 \
        "${XDG_DATA_HOME:-$HOME/.local/share}/uv/python/cpython-$version".*/bin/python3; do
        if "$python" -c 'import venv, ensurepip' >/dev/null 2>&1; then
            interpreter=$python
            break
        fi
    done
    if [ -z "$interpreter" ]; then
        printf '\n!! SKIPPED: no CPython %s (pyenv install %s, or uv python install %s)\n' "$version" "$version" "$version"
        continue
    fi
    venv=build/python-$version
    [ -x "$venv/bin/python" ] || "$interpreter" -m venv "$venv"
    printf '\n== %s\n' "$("$venv/bin/python" -VV)"
    install() { "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary rustypot "$@"; }
    # The driver package is compiled for each Python version, and may appear later than the interpreter.
    if ! install "${wheel}[sim,servo,log,gym]" 2>/dev/null; then
        printf '!! rustypot has no wheel for this version: without the extra servo\n'
        install "${wheel}[sim,log,gym]"
    fi
    install --force-reinstall --no-deps "$wheel"
    install 'pytest>=8' 'hypothesis>=6.100' 'pytest-xdist>=3.6'
    [ $# != 0 ] || set -- tests/python tests/config tests/gym
    "$venv/bin/python" -m pytest -m 'not slow and not full' "$@" || failed="$failed $version"
done
if [ -n "$failed" ]; then
    echo "error: tests failed on CPython$failed" >&2
    exit 1
fi
