"""Scripted hand: a simulated force that pulls the tool of a simulated arm sideways and up."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.arm import Arm
    from pliant.sim import Drag

#: Displacement of the hand in y and z, as shares of the arm's reach [1].
SIDE_SHARE, UP_SHARE = 0.17, 0.06
#: Times after the call: start of the pull, duration of its rise, and release [s].
START_DELAY, RAMP_TIME, RELEASE_TIME = 0.5, 3.0, 4.5
#: Stiffness [N/m] and force limit [N] of the spring between hand and tool.
STIFFNESS, FORCE_LIMIT = 800.0, 30.0


def prepare(arm: Arm) -> Callable[[], None]:
    """Import the simulator, and return a function that starts the scripted hand.

    The import takes 0.6 s, which would be too long between two cycles of the control loop.

    Raises:
        ConfigError: The arm is real.
        ImportError: The extra `sim` is missing.
    """
    from pliant import sim  # noqa: F401 - so that `_hands` need not import it during the loop

    drive, reach = arm.drive, arm.model.reach
    plant, emulator = getattr(drive, "plant", None), getattr(drive, "emulator", None)
    if plant is None and emulator is None:
        raise ConfigError("a scripted hand leads only arms with --backend sim or emulator")

    def start() -> None:
        if plant is not None:
            plant.set_hands(_hands(plant.time, reach))
        elif emulator is not None:
            emulator.call("plant.set_hands", _hands(emulator.call("plant.time"), reach))

    return start


def lead(arm: Arm) -> None:
    """Start the scripted hand, which pulls the tool of the simulated arm and lets go.

    Raises:
        ConfigError: The arm is real.
    """
    prepare(arm)()


def _hands(now: float, reach: float) -> list[Drag]:
    """Return simulated hands that pull along y and z, starting `START_DELAY` after `now` [s]."""
    from pliant.sim import Drag, ForceProfile

    course = ForceProfile(start=now + START_DELAY, rise=RAMP_TIME, end=now + RELEASE_TIME)
    distances = {"y": SIDE_SHARE * reach, "z": UP_SHARE * reach}
    return [
        Drag(
            axis=axis,
            distance=distance,
            stiffness=STIFFNESS,
            limit=FORCE_LIMIT,
            at="tool",
            course=course,
        )
        for axis, distance in distances.items()
    ]
