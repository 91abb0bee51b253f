"""Messages while an arm is left: the reason, the progress and the final state."""

from __future__ import annotations

import contextlib
import logging
import time
from typing import TYPE_CHECKING

import numpy as np

from pliant.arm.signals import name_of, signal_of
from pliant.arm.speaker import SPEAKER

if TYPE_CHECKING:
    from pliant.arm.cycle import Cycle
    from pliant.arm.lowering import Lowering
    from pliant.arm.speaker import Message

#: Time between two progress messages [s].
PROGRESS = 1.0
#: Lowest torque at which a joint counts as loaded [N·m].
LEAST = 1e-3
#: Largest length of a reason in a message [characters].
LONGEST = 160
#: Text for each phase of a descent.
PHASES = {"rest": "to its rest pose", "down": "down", "ramp": "at rest, giving up its weight"}
#: Remedy for an arm that was left with torque on.
RECOVER = (
    "`pliant run ARM`, or your program started again, takes it over and lowers it at its end; or "
    "support the arm and cut the supply"
)


class Ending:
    """Messages of one exit of an arm.

    A planned exit is logged as INFO, or as DEBUG for an arm in simulated time; any other as
    WARNING.

    Args:
        name: Name of the arm.
        cycle: Cycle of the arm.
        cause: Reason for the exit; None: planned.
    """

    def __init__(self, name: str, cycle: Cycle, cause: str | None) -> None:
        """Store the start time; no message is sent yet."""
        self._name, self._cycle, self._cause = name, cycle, cause
        is_real = bool(getattr(cycle.clock, "real_time", False))
        planned = logging.INFO if is_real else logging.DEBUG
        self._level = planned if cause is None else logging.WARNING
        self._detail = logging.INFO if is_real else logging.DEBUG
        self._begin, self._spoke = cycle.clock.now(), time.monotonic()
        self._from: float | None = None

    def begin(self, *, interrupted: bool = False) -> Message:
        """Announce that the arm is being lowered, and what Ctrl-C does meanwhile.

        Args:
            interrupted: Whether a Ctrl-C is the reason.
        """
        why = "" if self._cause is None else f" ({self._cause})"
        again = "Ctrl-C again leaves" if interrupted else "Ctrl-C twice leaves"
        return SPEAKER.say(
            f"{self._name} is being lowered{why}. {again} at once, torque ON", self._level
        )

    def progress(self, lowering: Lowering) -> None:
        """Report progress, at most once a second."""
        now = time.monotonic()
        if self._from is None:
            self._from = self._height()
        if now - self._spoke < PROGRESS:
            return
        self._spoke = now
        # An error in a message must not end the descent.
        with contextlib.suppress(Exception):
            where = PHASES.get(lowering.phase, lowering.phase)
            SPEAKER.say(
                f"{self._name}: {where}, {self._fallen()}, {self._passed():.0f} s",
                self._detail,
                progress=True,
            )

    def down(self, *, heard: bool = False) -> str:
        """Report that the arm rests and torque is off.

        Args:
            heard: Whether a signal came during the descent; the message is then a WARNING.
        """
        return self._say(
            f"{self._name} was lowered: torque OFF, {self._fallen()}, {self._passed():.1f} s",
            logging.WARNING if heard else self._level,
        )

    def stays(self, *, stopped: bool = False) -> str:
        """Report that torque stays on, which joints carry the arm, and the remedy.

        Args:
            stopped: Whether a descent was aborted.
        """
        return self._say(
            f"{self._name} stays where it is, torque ON: {self._carrying()}. {RECOVER}",
            logging.WARNING if stopped else self._level,
        )

    def failed(self, error: BaseException, on: list[str] | None) -> str:
        """Report the error that ended a descent, and the torque state.

        Args:
            error: The reason.
            on: Joints whose torque is on; None: unknown, the servos do not answer.
        """
        if on is None:
            return self._say(
                f"{self._name} was not lowered, the bus is gone: servos that have power keep their "
                "last goal and limit, torque ON. Mend the connection and start again, which takes "
                "the arm over; or support the arm and cut the supply",
                logging.WARNING,
            )
        state = f"torque is ON in {', '.join(on)}. {RECOVER}" if on else "torque is OFF"
        return self._say(f"{self._name} was not lowered ({brief(error)}): {state}", logging.WARNING)

    def _say(self, text: str, level: int) -> str:
        SPEAKER.say(text, level)
        return text

    def _carrying(self) -> str:
        """Name the joints with a gravity torque above their friction, largest first."""
        with contextlib.suppress(Exception):
            cycle = self._cycle
            load = np.abs(cycle.gravity())
            friction = np.broadcast_to(np.asarray(cycle.servos.friction), load.shape)
            names = [
                cycle.model.joint_names[joint]
                for joint in np.argsort(-load)
                if load[joint] > max(float(friction[joint]), LEAST)
            ]
            if names:
                verb = "carry" if len(names) > 1 else "carries"
                return f"{', '.join(names)} {verb} it"
        return "no joint carries much"

    def _passed(self) -> float:
        """Return the time since the exit began [s], on the arm's clock."""
        return self._cycle.clock.now() - self._begin

    def _height(self) -> float:
        """Return the height of the tool [m], against gravity; NaN if unknown."""
        with contextlib.suppress(Exception):
            model = self._cycle.model
            gravity = np.asarray(model.gravity_vector)
            up = -gravity / max(float(np.linalg.norm(gravity)), 1e-9)
            return float(np.asarray(model.forward_kinematics(self._cycle.q))[:3, 3] @ up)
        return float("nan")

    def _fallen(self) -> str:
        height = self._height()
        fallen = 100.0 * ((height if self._from is None else self._from) - height)
        if not np.isfinite(fallen):
            return "height not known"
        way = "higher" if fallen < -0.5 else "lower"
        return f"tool {abs(fallen):.0f} cm {way}"


def cause_of(error: BaseException | None) -> str | None:
    """Return the reason for an exit after an exception; None: no exception, or a planned end."""
    if error is None or isinstance(error, GeneratorExit):
        return None
    number = signal_of(error)
    if number is not None:
        return name_of(number)
    if isinstance(error, SystemExit):
        return None
    return brief(error)


def brief(error: BaseException) -> str:
    """Return the first line of an error, cut at `LONGEST` characters."""
    lines = str(error).strip().splitlines()
    text = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."
