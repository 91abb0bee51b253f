"""A hand for arms that nobody can touch: it leads a simulated or emulated tool aside and up."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.arm import Arm
    from pliant.sim import Drag

#: How far it leads the tool, as shares of the arm's reach: to y, and up [1].
ASIDE, UP = 0.17, 0.06
#: When it takes hold after it was asked, how long it takes, and when it lets go [s].
AFTER, TAKES, LETS_GO = 0.5, 3.0, 4.5
#: Of its grip [N/m], [N].
STIFFNESS, LIMIT = 800.0, 30.0


def prepare(arm: Arm) -> Callable[[], None]:
    """Load what a hand needs: importing the simulator takes 0.6 s, too long between two ticks.

    Args:
        arm: A simulated or emulated arm.

    Returns:
        A function that lets the hand lead the tool, beginning then; it returns at once.

    Raises:
        ConfigError: A real arm: there are hands enough.
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
    """Let a hand lead the tool, beginning now.

    Args:
        arm: A simulated or emulated arm.

    Raises:
        ConfigError: A real arm: there are hands enough.
    """
    prepare(arm)()


def _hands(now: float, reach: float) -> list[Drag]:
    """One per direction, from `now` [s] on."""
    from pliant.sim import Course, Drag

    course = Course(start=now + AFTER, rise=TAKES, end=now + LETS_GO)
    ways = {"y": ASIDE * reach, "z": UP * reach}
    return [
        Drag(axis=axis, distance=way, stiffness=STIFFNESS, limit=LIMIT, at="tool", course=course)
        for axis, way in ways.items()
    ]
