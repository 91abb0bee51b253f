"""Times the calls of a control loop from Python, with Pinocchio's kinematics beside ours in turn.

    python benches/boundary.py

Prints medians over rounds of 64 different states, and the ratio within a round. Pinocchio (`pip
install pin`) is skipped loudly where it is absent.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import pliant
import pliant.robots

if TYPE_CHECKING:
    from collections.abc import Callable

ROUNDS, CALLS = 60, 2048
START = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])  # [rad]


def candidates() -> dict[str, Callable[[int], object]]:
    """What is timed; each takes the number of the call."""
    model = pliant.robots.arm7()
    states = [START + 0.05 * np.sin(np.arange(7) + i) for i in range(64)]
    target = model.forward_kinematics(START)
    pose, jacobian = np.empty((4, 4)), np.empty((6, 7))
    cap = pliant.Controller(model, pliant.Settings(axes={"y": pliant.Axis(soft=4.0, eta=0.9)}))
    paper = pliant.Controller(model, pliant.Settings.paper(axes={"y": pliant.Axis(soft=0.5)}))

    def step(controller: pliant.Controller) -> Callable[[int], object]:
        def call(i: int) -> object:
            command = controller.step(states[i & 63], target)
            return command.goal, command.torque_limit

        return call

    calls: dict[str, Callable[[int], object]] = {
        "(an empty call)": lambda i: states[i & 63],
        "step, law cap": step(cap),
        "step, law paper": step(paper),
        "pose and Jacobian, own arrays": lambda i: model.kinematics(
            states[i & 63], out=(pose, jacobian)
        ),
        "pose and Jacobian, new arrays": lambda i: model.kinematics(states[i & 63]),
    }
    try:
        import pinocchio
    except ImportError:
        print("!! Pinocchio is not installed: its row is missing")
        return calls
    urdf = Path(pliant.robots.__file__).with_name("arm7.urdf").read_text(encoding="utf-8")
    other = pinocchio.buildModelFromXML(urdf)
    data, frame = other.createData(), other.getFrameId("tool")

    def reference(i: int) -> object:
        return pinocchio.computeFrameJacobian(
            other, data, states[i & 63], frame, pinocchio.LOCAL_WORLD_ALIGNED
        ), data.oMf[frame]

    expected = model.jacobian(states[3])
    assert np.abs(np.asarray(reference(3)[0]) - expected).max() < 1e-9  # same work, then time
    calls["pose and Jacobian, Pinocchio"] = reference
    return calls


def main() -> None:
    """Take turns, print medians."""
    calls = candidates()
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            start = time.perf_counter()
            for i in range(CALLS):
                call(i)
            times[name].append((time.perf_counter() - start) / CALLS)
    empty = statistics.median(times.pop("(an empty call)"))
    for name, values in times.items():
        print(f"{name:32} {1e6 * (statistics.median(values) - empty):7.2f} µs")


if __name__ == "__main__":
    main()
