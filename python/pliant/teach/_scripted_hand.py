"""A scripted hand that leads a simulated or emulated tool sideways and up."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.arm import Arm
    from pliant.sim import Drag

#: Displacement of the tool in y and z, as shares of the arm's reach [1].
ASIDE, UP = 0.17, 0.06
#: Delay of the start, duration of the ramp, and time of the release [s].
AFTER, TAKES, LETS_GO = 0.5, 3.0, 4.5
#: Stiffness [N/m] and force limit [N] of the grip.
STIFFNESS, LIMIT = 800.0, 30.0


def prepare(arm: Arm) -> Callable[[], None]:
    """Import the simulator in advance: the import takes 0.6 s, too long between two ticks.

    Returns:
        A function that starts the hand and returns immediately.

    Raises:
        ConfigError: The arm is real.
        ImportError: The extra `sim` is missing.
    """
    from pliant import sim  # noqa: F401 - loaded here, used in _hands

    drive, reach = arm.drive, arm.model.reach
    plant, emulator = getattr(drive, "plant", None), getattr(drive, "emulator", None)
    if plant is None and emulator is None:
        raise ConfigError("a scripted hand leads only arms with --backend sim or emulator")

    def lead() -> None:
        if plant is not None:
            plant.set_hands(_hands(plant.time, reach))
        elif emulator is not None:
            emulator.call("plant.set_hands", _hands(emulator.call("plant.time"), reach))

    return lead


def lead(arm: Arm) -> None:
    """Start the hand that leads the tool.

    Raises:
        ConfigError: The arm is real.
    """
    prepare(arm)()


def _hands(now: float, reach: float) -> list[Drag]:
    """Return one hand per direction, from `now` [s] on."""
    from pliant.sim import Drag, ForceProfile

    course = ForceProfile(start=now + AFTER, rise=TAKES, end=now + LETS_GO)
    ways = {"y": ASIDE * reach, "z": UP * reach}
    return [
        Drag(
            axis=axis, distance=distance, stiffness=STIFFNESS, limit=LIMIT, at="tool", course=course
        )
        for axis, distance in ways.items()
    ]
