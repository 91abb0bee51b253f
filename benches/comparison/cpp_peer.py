"""C++ implementation of kinematics and control step, for comparison with pliant.

Array sizes are fixed at compile time. The code is compiled when the benchmark starts, for the CPU
of this machine.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sysconfig
from pathlib import Path

import numpy as np

from comparison import problem
from comparison.peer import Implementation, Pair
from comparison.problem import Array

SOURCES = Path(__file__).resolve().parents[1] / "cpp"
FLAGS = ("-std=c++17", "-O3", "-march=native", "-shared", "-fPIC", "-Wall", "-Wextra", "-Wno-psabi")


def compiler() -> str:
    """Return the name of the C++ compiler.

    Raises:
        ImportError: No C++ compiler is installed.
    """
    name = os.environ.get("CXX") or next(filter(shutil.which, ("c++", "g++", "clang++")), "")
    if not name:
        raise ImportError("no C++ compiler (c++, g++, clang++; CXX names another)")
    return name


def constants(arm: problem.Arm) -> Array:
    """Return arm data and law parameters as one array, in the order of the C++ struct's members."""
    is_soft = np.arange(6) == problem.YIELDS
    parts = (
        arm.links,
        arm.middle,
        arm.limit_weights,
        arm.rest,
        problem.D_MINUS,
        problem.D_PLUS,
        np.where(is_soft, problem.SOFT, problem.HOLD),
        np.where(is_soft, problem.FIRM, problem.HOLD),
        np.where(is_soft, 1.0 - problem.ETA, 1.0),
        [problem.DAMPING, problem.GAIN, problem.HORIZON, problem.ALPHA, problem.NULL],
    )
    return np.concatenate([np.ravel(part) for part in parts])


def make() -> Implementation:
    """Compile the C++ code, load it as a Python extension, and return the implementation.

    Raises:
        ImportError: There is no compiler, or the code does not compile.
    """
    built = Path(os.environ["PEERS_BUILD"]) / "fixed_arm.so"
    include = [f"-I{sysconfig.get_path('include')}", f"-I{np.get_include()}"]
    command = [compiler(), *FLAGS, *include, str(SOURCES / "module.cpp"), "-o", str(built)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        raise ImportError(f"{' '.join(command)}: {result.stderr}")
    spec = importlib.util.spec_from_file_location("fixed_arm", built)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    arm = problem.bench_arm()
    module.configure(constants(arm))
    pose, jacobian = np.empty((4, 4)), np.empty((6, arm.n))
    goal, limit = np.empty(arm.n), np.empty(arm.n)
    pairs: dict[int, Pair] = {}

    def kinematics(q: Array) -> Pair:
        module.kinematics(q, pose, jacobian)
        return pose.copy(), jacobian.copy()

    def step(q: Array, target: Array) -> Pair:
        module.step(q, target, goal, limit)
        return goal.copy(), limit.copy()

    def batch(configurations: Array) -> Pair:
        count = len(configurations)
        if count not in pairs:
            pairs[count] = (np.empty((count, 4, 4)), np.empty((count, 6, arm.n)))
        module.batch(configurations, *pairs[count])
        return pairs[count]

    version = subprocess.run(
        [compiler(), "-dumpfullversion"], capture_output=True, text=True, check=False
    )
    return Implementation(
        version=f"{Path(compiler()).name} {version.stdout.strip()} -O3 -march=native",
        kinematics=kinematics,
        kinematics_call="k(q, T, J)",
        step=step,
        step_call="s(q, t, goal, limit)",
        names={
            **{"k": module.kinematics, "s": module.step, "T": pose, "J": jacobian},
            **{"goal": goal, "limit": limit},
        },
        batch=batch,
    )
