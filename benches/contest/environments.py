"""Python environment of each peer: this one if it has the library, else a separate one."""

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
    """A peer to time: one row of the table.

    Attributes:
        name: Name in the table.
        maker: Module and function of this package.
        module: Required module.
        package: Package that pip installs for it; "" if it must be installed already.
        environment: Variables of its process.
    """

    name: str
    maker: str
    module: str = "numpy"
    package: str = ""
    environment: dict[str, str] = field(default_factory=dict)


#: Forced instructions of pliant, fastest first; a build with one path has one row.
PATHS = ("avx512", "avx2", "baseline")
OURS = tuple(
    Entry(f"pliant ({path})", "pliant_peer:make", environment={"PLIANT_INSTRUCTIONS": path})
    for path in PATHS
)
PEERS = (
    Entry("C++ for this CPU", "cpp_peer:make"),
    Entry("Numba", "compiled_peers:numba", "numba", "numba"),
    # JAX computes in its own threads, so its process is not tied to one core.
    Entry("JAX", "compiled_peers:jax", "jax", "jax", {"PEERS_PIN": "0"}),
    Entry("Pinocchio + NumPy", "library_peers:pinocchio", "pinocchio", "pin"),
    Entry("MuJoCo + NumPy", "library_peers:mujoco", "mujoco", "mujoco"),
    Entry("dynibo + NumPy", "library_peers:dynibo", "dynibo", "dynibo"),
    Entry("optik-py + NumPy", "library_peers:optik", "optik", "optik-py"),
    Entry("placo + NumPy", "library_peers:placo", "placo", "placo"),
    Entry("NumPy", "numpy_peer:make"),
)


def python_for(entry: Entry) -> str:
    """Return the path of an interpreter that has the peer; make an environment if needed.

    Raises:
        RuntimeError: The package cannot be installed.
    """
    if not entry.package or importlib.util.find_spec(entry.module) is not None:
        return sys.executable
    home = BUILD / entry.package
    python, done = home / "bin" / "python", home / ".installed"
    if not done.exists():
        print(f"   making an environment for {entry.package}", file=sys.stderr, flush=True)
        venv.create(home, with_pip=True, clear=True)
        command = [str(python), "-m", "pip", "install", "--quiet", "numpy", entry.package]
        installed = subprocess.run(command, capture_output=True, text=True, check=False)
        if installed.returncode:
            last = installed.stderr.strip().splitlines()[-1:] or ["pip said nothing"]
            raise RuntimeError(f"pip install {entry.package}: {last[0]}")
        done.touch()
    return str(python)
