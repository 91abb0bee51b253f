"""Forces, deviations and times of an arm on one screen, from the simulator.

``python -m experiments.sheet so101`` holds the arm in one pose, moves it by hand along a soft axis,
pushes a stiff one, steps its target, and prints the results as a table.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import tyro

import pliant
from experiments import program, steps
from experiments.simulation import closed_loop
from pliant.sim import Drag, Plant, Push

if TYPE_CHECKING:
    from experiments.poses import Array
    from pliant.sim.hand import Hand


#: Pose of some arms with the tool in front of the arm (n,) [rad].
POSES = {
    "so101": (0.0, -0.3, 0.3, 0.9, 0.0),
    "koch": (0.0, -0.4, 0.8, 0.5, 0.0),
    "vx300s": (0.0, -0.5, 0.6, 0.0, 0.5, 0.0),
}
#: The hand: distance along a soft axis [m], largest pull there [N], push on a stiff axis [N].
LED, PULLS, PUSHES = 0.10, 15.0, 3.0


def held(name: str, settings: pliant.Settings, hand: Hand, seconds: float) -> tuple[Array, Array]:
    """Hold a pose; return tool positions (t, 3) [m] and the force of a hand (t, 3) [N]."""
    model = steps.arm(name).model
    controller = pliant.Controller(model, settings)
    plant = Plant(
        model,
        rate=steps.RATE,
        encoder_step=np.asarray(steps.arm(name).servos.encoder_step),
        scene=[hand],
    )
    plant.reset(POSES[name])
    target, places, forces = plant.tool, [], []
    for _ in closed_loop(plant, controller, target, seconds):
        places.append(plant.tool[:3, 3])
        forces.append(plant.hands[0].force)
    return np.array(places), np.array(forces)


def rows(name: str, count: int = 6) -> list[tuple[str, str]]:
    """Return rows of the table: an event, and its figures as text."""
    it = steps.arm(name)
    task = " ".join(it.axes)
    soft = pliant.Settings.soft("x y", task=task)
    out = []
    # A hand comes at 2 s, has moved the axis at 3.5 s and lets go at 5 s.
    path, force = held(name, soft, Drag(axis="y", distance=LED, limit=PULLS), 8.0)
    moved = path - path[190]
    leading = slice(350, 490)
    felt = np.linalg.norm(force[leading], axis=1)
    out.append(
        (
            f'`soft("x y")`: a hand leads the tool {1e3 * LED:.0f} mm along y',
            f"{felt.mean():.1f} N where it stays, {np.linalg.norm(force, axis=1).max():.1f} N on "
            f"the way; z drifts {1e3 * np.abs(moved[200:490, 2]).max():.0f} mm",
        )
    )
    window = round(steps.WINDOW * steps.RATE)
    freed = path[500:]
    back = np.linalg.norm(freed[window:] - freed[:-window], axis=1).max() / steps.WINDOW
    left = 1e3 * np.linalg.norm(path[-1] - path[190])
    out.append(("… and lets go", f"back at up to {back:.2f} m/s; {left:.0f} mm are left after 3 s"))
    firm = pliant.Settings.firm(task=task)
    for axis in range(3):
        push = np.eye(3)[axis] * PUSHES * (-1.0 if axis == 2 else 1.0)
        path, _ = held(name, firm, Push(force_vector=tuple(push)), 5.0)
        given = 1e3 * np.abs((path - path[190])[200:490, axis]).max()
        out.append(
            (
                f"all axes stiff: a push of {PUSHES:.0f} N along {'−' if axis == 2 else '+'}"
                f"{'xyz'[axis]}",
                f"gives way by {given:.0f} mm",
            )
        )
    report = pliant.Controller(it.model, soft).report(POSES[name])
    most = [report.axes[axis].host_loss_force for axis in "xyz"]
    out.append(
        (
            "the program dies, the servos keep their last goals: a hand meets at most",
            f"{np.min(most):.1f} to {np.max(most):.1f} N, by direction",
        )
    )
    for speed in steps.SPEEDS:
        of = steps.settings(name, "cap", speed)
        done = [steps.run(name, step, of) for step in steps.steps(name, count)]
        out.append(
            (
                f"steps of {1e3 * steps.WAY:.0f} mm, `max_tool_speed` {speed:g} m/s",
                f"{max(d.fastest for d in done):.2f} m/s at most, "
                f"{max(0.0, *(1e3 * d.overshoot for d in done)):.0f} mm past the target, "
                f"{1e3 * np.median([d.left for d in done]):.0f} mm left, within 10 mm after "
                f"{np.median([d.seconds for d in done]):.1f} s (median of {count})",
            )
        )
    return out


def main(robot: tyro.conf.Positional[str] = "so101", steps_each: int = 6) -> None:
    """Print the table.

    Args:
        robot: so101, koch, or vx300s where its URDF lies beside this checkout.
        steps_each: Steps of each speed.
    """
    if robot not in POSES:
        raise SystemExit(f"no pose for {robot!r}; there are {', '.join(POSES)}")
    print(program.markdown(("what", "how much"), rows(robot, steps_each)))


if __name__ == "__main__":
    program.start(main)
