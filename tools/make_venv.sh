#!/bin/sh
# Makes a virtual environment at $1 from the first Python >= $2 (3.11) that can make one. PYTHON=... names another.
set -eu
venv=$1
least=${2:-3.11}

good() {
    "$1" -c "import sys, venv, ensurepip; sys.exit(sys.version_info < tuple(map(int, '$least'.split('.'))))" >/dev/null 2>&1
}

versions="$HOME/.pyenv/versions ${PYENV_ROOT:-$HOME/.pyenv}/versions"
found=
# Unquoted on purpose: the shell expands the pattern to every Python of pyenv, active or not.
for python in ${PYTHON:-python3 python3.14 python3.13 python3.12 python3.11 python \
    $(for folder in $versions; do ls -d "$folder"/3.1[1-9]*/bin/python3 2>/dev/null || true; done)}; do
    if good "$python"; then
        found=$python
        break
    fi
done

if [ -n "$found" ]; then
    echo "using $found ($("$found" -c 'import platform; print(platform.python_version())'))"
    "$found" -m venv --clear "$venv"
elif command -v uv >/dev/null; then
    uv venv --quiet --seed --clear --python ">=$least" "$venv"
else
    echo "error: no Python >= $least with venv and ensurepip among ${PYTHON:-python3, python3.14 ... python3.11, pyenv}." >&2
    echo "       Install one (Debian: python3 and python3-venv) or name it: make setup PYTHON=/path/to/python3" >&2
    exit 1
fi
