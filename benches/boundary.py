"""Time of pliant's calls from a Python loop, compared with a call of Pinocchio's kinematics.

    python benches/boundary.py

Positions and targets change with every call; goal and torque limit are read after a step. The
program prints medians over rounds, minus the time of an empty loop. Pinocchio (`pip install pin`)
is optional.
"""

from __future__ import annotations

import operator
import statistics
import timeit
from typing import Any

import numpy as np
from comparison import pliant_peer, problem

import pliant

#: Number of rounds, and approximate number of calls per statement and round.
ROUNDS, CALLS_PER_ROUND = 100, 1280
#: Number of states on the path of `followed`.
STATES = 1000
#: Timed Python statements by name.
CALLS = {
    "(the loop)": "for q, t in states: pass",
    "a call that does nothing": "for q, t in states: nothing(q, t); kept.goal; kept.torque_limit",
    "step, law cap": "for q, t in followed: c = cap(q, t); c.goal; c.torque_limit",
    "step, law paper as printed": "for q, t in states: c = paper(q, t); c.goal; c.torque_limit",
    "pose and Jacobian, own arrays": "for q, t in states: kinematics(q, out=arrays)",
    "pose and Jacobian, new arrays": "for q, t in states: kinematics(q)",
}
REFERENCE = "for q, t in states: jacobian(model, data, q, frame, axes); data.oMf[frame]"
#: Servo parameters of the bench arm, per joint from base to tool: stiffness [N·m/rad], torque
#: [N·m], friction [N·m] and damping [N·m·s/rad].
SERVOS = {
    "kp": [150.0] * 4 + [60.0] * 3,
    "max_torque": [10.7] * 4 + [6.4] * 3,
    "friction": [0.2] * 4 + [0.1] * 3,
    "damping": [1.2] * 4 + [0.8] * 3,
}


def names() -> dict[str, Any]:
    """Return the objects that the timed statements use, by variable name."""
    model = pliant.Model.from_urdf(problem.URDF, tip=problem.TOOL)
    states = problem.states(problem.bench_arm())
    cap = pliant.Controller(model, pliant.Settings.soft("y"), pliant.Servos(**SERVOS))
    return {
        "nothing": operator.is_,
        "kept": cap.step(*path_states(model)[0]),
        "states": [(q, model.forward_kinematics(target_q)) for q, target_q in states],
        "followed": path_states(model),
        "cap": cap.step,
        "paper": pliant_peer.controller(model).step,
        "kinematics": model.kinematics,
        "arrays": (np.empty((4, 4)), np.empty((6, model.n))),
    }


def path_states(model: pliant.Model) -> list[tuple[Any, Any]]:
    """Return pairs of joint positions q (n,) and target pose (4, 4) along a closed path.

    Each target is the tool's pose two ticks ahead, so that law `cap` follows as on a real arm.
    """
    middle, reach = 0.5 * (model.lower + model.upper), 0.05 * (model.upper - model.lower)
    phases = 2.0 * np.pi * np.arange(STATES) / STATES
    path = [middle + reach * np.sin(phase + 0.9 * np.arange(model.n)) for phase in phases]
    return [(path[i - 2], model.forward_kinematics(path[i])) for i in range(STATES)]


def reference(own_names: dict[str, Any]) -> dict[str, Any]:
    """Return Pinocchio's objects for the statement `REFERENCE`, by variable name.

    Raises:
        AssertionError: Its Jacobian differs from that of `own_names`, the result of `names`.
    """
    import pinocchio

    model = pinocchio.buildModelFromXML(problem.URDF.read_text(encoding="utf-8"))
    call = {
        "jacobian": pinocchio.computeFrameJacobian,
        "model": model,
        "data": model.createData(),
        "frame": model.getFrameId(problem.TOOL),
        "axes": pinocchio.LOCAL_WORLD_ALIGNED,
    }
    q = own_names["states"][3][0]
    peer_jacobian = call["jacobian"](model, call["data"], q, call["frame"], call["axes"])
    assert np.abs(peer_jacobian - own_names["kinematics"](q)[1]).max() < 1e-9  # the same work
    return call


def main() -> None:
    """Time the statements in turn, and print their median times."""
    known, calls = names(), dict(CALLS)
    try:
        known |= reference(known)
        calls["pose and Jacobian, Pinocchio"] = REFERENCE
    except ImportError:
        print("!! Pinocchio is not installed: its row is missing")
    timers = {name: timeit.Timer(call, globals=known) for name, call in calls.items()}
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, timer in timers.items():
            count = len(known["followed" if "followed" in calls[name] else "states"])
            repeats = max(CALLS_PER_ROUND // count, 1)
            times[name].append(timer.timeit(repeats) / (repeats * count))
    loop = statistics.median(times.pop("(the loop)"))
    for name, values in times.items():
        print(f"{name:32} {1e6 * (statistics.median(values) - loop):7.2f} µs")


if __name__ == "__main__":
    main()
