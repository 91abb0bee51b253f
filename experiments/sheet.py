"""Data sheet of a simulated arm: forces, deviations and times under the default law.

``python -m experiments.sheet so101`` simulates an arm that holds a pose, is dragged along a soft
axis, is pushed along a stiff axis, and follows a step of its target. It prints a table.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import tyro

import pliant
from experiments import command_line, markdown, steps
from experiments.simulation import closed_loop
from pliant.sim import Drag, Plant, Push

if TYPE_CHECKING:
    from experiments.poses import Array
    from pliant.sim.hand import Hand


#: Pose of each arm, with the tool in front of the arm (n,) [rad].
POSES = {
    "so101": (0.0, -0.3, 0.3, 0.9, 0.0),
    "koch": (0.0, -0.4, 0.8, 0.5, 0.0),
    "vx300s": (0.0, -0.5, 0.6, 0.0, 0.5, 0.0),
}
#: Distance [m] and largest force [N] of a hand that drags the tool along a soft axis, and force of
#: a push along a stiff axis [N].
DRAG_DISTANCE, DRAG_FORCE, PUSH_FORCE = 0.10, 15.0, 3.0


def hold_against(
    name: str, settings: pliant.Settings, hand: Hand, seconds: float
) -> tuple[Array, Array]:
    """Hold the pose of `POSES` against a hand for `seconds` [s].

    Returns:
        Positions of the tool (N, 3) [m] and forces of the hand (N, 3) [N] at every tick.
    """
    model = steps.arm(name).model
    controller = pliant.Controller(model, settings)
    plant = Plant(
        model,
        rate=steps.RATE,
        encoder_step=np.asarray(steps.arm(name).servos.encoder_step),
        scene=[hand],
    )
    plant.reset(POSES[name])
    target, positions, forces = plant.tool, [], []
    for _ in closed_loop(plant, controller, target, seconds):
        positions.append(plant.tool[:3, 3])
        forces.append(plant.hands[0].force)
    return np.array(positions), np.array(forces)


def rows(name: str, count: int = 6) -> list[tuple[str, str]]:
    """Simulate the arm; return the rows of the table: event, and its results as text.

    `count` is the number of target steps at each speed limit.
    """
    it = steps.arm(name)
    task = " ".join(it.axes)
    soft = pliant.Settings.soft("x y", task=task)
    out = []
    # The hand pulls from 2 s, reaches its distance at 3.5 s, and releases the arm at 5 s. Indices
    # below are ticks of 10 ms.
    path, force = hold_against(
        name, soft, Drag(axis="y", distance=DRAG_DISTANCE, limit=DRAG_FORCE), 8.0
    )
    displacement = path - path[190]
    pull = slice(350, 490)
    forces = np.linalg.norm(force[pull], axis=1)
    out.append(
        (
            f'`soft("x y")`: a hand leads the tool {1e3 * DRAG_DISTANCE:.0f} mm along y',
            f"{forces.mean():.1f} N where it stays, {np.linalg.norm(force, axis=1).max():.1f} N on "
            f"the way; z drifts {1e3 * np.abs(displacement[200:490, 2]).max():.0f} mm",
        )
    )
    window = round(steps.WINDOW * steps.RATE)
    released = path[500:]
    back = np.linalg.norm(released[window:] - released[:-window], axis=1).max() / steps.WINDOW
    error = 1e3 * np.linalg.norm(path[-1] - path[190])
    out.append(
        ("… and lets go", f"back at up to {back:.2f} m/s; {error:.0f} mm are left after 3 s")
    )
    firm = pliant.Settings.firm(task=task)
    for axis in range(3):
        push = np.eye(3)[axis] * PUSH_FORCE * (-1.0 if axis == 2 else 1.0)
        path, _ = hold_against(name, firm, Push(force_vector=tuple(push)), 5.0)
        deviation = 1e3 * np.abs((path - path[190])[200:490, axis]).max()
        out.append(
            (
                f"all axes stiff: a push of {PUSH_FORCE:.0f} N along {'−' if axis == 2 else '+'}"
                f"{'xyz'[axis]}",
                f"gives way by {deviation:.0f} mm",
            )
        )
    report = pliant.Controller(it.model, soft).report(POSES[name])
    bounds = [report.axes[axis].host_loss_force for axis in "xyz"]
    out.append(
        (
            "the program dies, the servos keep their last goals: a hand meets at most",
            f"{np.min(bounds):.1f} to {np.max(bounds):.1f} N, by direction",
        )
    )
    for speed in steps.SPEEDS:
        of = steps.settings(name, "cap", speed)
        results = [steps.run(name, step, of) for step in steps.steps(name, count)]
        out.append(
            (
                f"steps of {1e3 * steps.STEP_LENGTH:.0f} mm, `max_tool_speed` {speed:g} m/s",
                f"{max(d.fastest for d in results):.2f} m/s at most, "
                f"{max(0.0, *(1e3 * d.overshoot for d in results)):.0f} mm past the target, "
                f"{1e3 * np.median([d.left for d in results]):.0f} mm left, within 10 mm after "
                f"{np.median([d.seconds for d in results]):.1f} s (median of {count})",
            )
        )
    return out


def main(robot: tyro.conf.Positional[str] = "so101", steps_each: int = 6) -> None:
    """Print the data sheet.

    Args:
        robot: so101, koch, or vx300s if its URDF is available.
        steps_each: Number of target steps at each speed.
    """
    if robot not in POSES:
        raise SystemExit(f"no pose for {robot!r}; there are {', '.join(POSES)}")
    print(markdown.table(("what", "how much"), rows(robot, steps_each)))


if __name__ == "__main__":
    command_line.start(main)
