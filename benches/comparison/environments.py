"""List of the compared implementations, and the Python environment in which each one runs."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import venv
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "peers"


@dataclass(frozen=True)
class Entry:
    """Description of one compared implementation.

    Attributes:
        name: Name in the table.
        maker: Function that returns the `Implementation`, as `module:function` of this package.
        module: Python module that the implementation needs.
        package: Name of the pip package with this module; "" if the module must be installed
            already.
        environment: Environment variables of the process that runs the implementation.
    """

    name: str
    maker: str
    module: str = "numpy"
    package: str = ""
    environment: dict[str, str] = field(default_factory=dict)


#: Instruction sets for which pliant has code, widest vectors first. The table has a row for each
#: one that the processor supports.
PATHS = ("avx512", "avx2", "baseline")
PLIANT_ENTRIES = tuple(
    Entry(f"pliant ({path})", "pliant_peer:make", environment={"PLIANT_INSTRUCTIONS": path})
    for path in PATHS
)
PEERS = (
    Entry("C++ for this CPU", "cpp_peer:make"),
    Entry("Numba", "compiled_peers:numba", "numba", "numba"),
    # Do not tie JAX to one core (PEERS_PIN), because it computes in several threads.
    Entry("JAX", "compiled_peers:jax", "jax", "jax", {"PEERS_PIN": "0"}),
    Entry("Pinocchio + NumPy", "library_peers:pinocchio", "pinocchio", "pin"),
    Entry("MuJoCo + NumPy", "library_peers:mujoco", "mujoco", "mujoco"),
    Entry("dynibo + NumPy", "library_peers:dynibo", "dynibo", "dynibo"),
    Entry("optik-py + NumPy", "library_peers:optik", "optik", "optik-py"),
    Entry("placo + NumPy", "library_peers:placo", "placo", "placo"),
    Entry("NumPy", "numpy_peer:make"),
)


def python_for(entry: Entry) -> str:
    """Return the path of a Python interpreter that has the module of an implementation.

    The running interpreter is used if it has the module. Otherwise an environment under build/peers
    is created, and the package is installed there.

    Raises:
        RuntimeError: The package cannot be installed.
    """
    if not entry.package or importlib.util.find_spec(entry.module) is not None:
        return sys.executable
    home = BUILD / entry.package
    python, marker = home / "bin" / "python", home / ".installed"
    if not marker.exists():
        print(f"   making an environment for {entry.package}", file=sys.stderr, flush=True)
        venv.create(home, with_pip=True, clear=True)
        command = [str(python), "-m", "pip", "install", "--quiet", "numpy", entry.package]
        installed = subprocess.run(command, capture_output=True, text=True, check=False)
        if installed.returncode:
            last = installed.stderr.strip().splitlines()[-1:] or ["pip said nothing"]
            raise RuntimeError(f"pip install {entry.package}: {last[0]}")
        marker.touch()
    return str(python)
