"""Shutdown of an arm: lower it or hold its present pose, with messages to the user."""

from __future__ import annotations

import contextlib
import logging
import re
import time
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from pliant._core import (
    SUPPORT,
    Lowering,
    PliantError,
    ServoError,
    ServoFaultError,
    torque_margin,
)
from pliant._validation import named_together
from pliant.arm._checks import join_faults
from pliant.arm._messages import MESSAGES
from pliant.arm._signals import name_of, signal_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pliant._typing import Array, Mask
    from pliant.arm._io import ArmIO
    from pliant.arm._messages import Message


#: Shortest time between two progress messages of a descent, the lowering of the arm [s].
PROGRESS = 1.0
#: Duration of a descent after which a message asks the user to free the arm, and time between two
#: such messages [s]. The descent of an arm that stands still ends earlier.
LONG_DESCENT, REMINDER_PERIOD = 45.0, 60.0
#: A descent that lowers the tool by less than this height [m] in this time [s], and goes on, does
#: not come to rest; progress messages say so.
STALL_HEIGHT, STALL_TIME = 0.05, 8.0
#: Minimum rate of the control loop of a descent [Hz]; a slow bus may still make it slower.
MIN_RATE = 20.0
#: Smallest gravity torque with which a message names a joint as loaded [N·m].
MIN_LOAD = 1e-3
#: Largest length of an error text of another library in a message [characters].
MAX_REASON = 160
#: Text in progress messages for each phase of a descent.
PHASES = {
    "rest": "to its rest pose",
    "down": "down",
    "ramp": "at rest, torque limits going to zero",
}
#: Remedy in messages about an arm that was left with torque on.
RECOVER = (
    "`pliant run ARM`, or your program started again, takes it over and lowers it at its end; or "
    "support the arm and cut the supply"
)


class ExitMessages:
    """Messages of one shutdown of an arm.

    Messages of a planned shutdown have the level INFO, or DEBUG for an arm in simulated time.
    Messages of an unplanned shutdown have the level WARNING, except for its progress.

    Args:
        name: Name of the arm.
        io: Read and write access to the arm.
        cause: Reason for the shutdown; None if it is planned.
        ports: Ports of a real arm, in parentheses after a space; they tell apart the arms of a
            program.
    """

    def __init__(self, name: str, io: ArmIO, cause: str | None, *, ports: str = "") -> None:
        """Store the start time of the shutdown; send no message yet."""
        self._short_name, self._ports = name, ports
        self._name, self._io, self._cause = f"{name}{ports}", io, cause
        is_real = bool(getattr(io.clock, "real_time", False))
        planned = logging.INFO if is_real else logging.DEBUG
        self._level = planned if cause is None else logging.WARNING
        self._detail = logging.INFO if is_real else logging.DEBUG
        self._start_time, self._last_progress = io.clock.now(), time.monotonic()
        # Height at which a failed loop held the arm, if nothing was sent since; else that at the
        # first progress message. In between, an arm whose servos restart falls.
        self._start_height: float | None = None
        if io.held is not None and io.last_write <= io.held[0]:
            self._start_height = self._height_at(io.held[1])
        self._next_reminder = LONG_DESCENT
        # Height [m] and time since the start [s] from which `_stall` measures.
        self._mark = float("inf"), 0.0
        self._abort = "Ctrl-C twice leaves"
        self._known_faults: set[str] | None = None
        self._new_faults: list[str] = []

    def begin(self, *, interrupted: bool = False, abort: str | None = None) -> Message:
        """Send and return the message that the arm is being lowered, and how to abort it.

        Args:
            interrupted: True if a Ctrl-C is the reason for the shutdown.
            abort: Beginning of the sentence that tells how to abort; None: by Ctrl-C.
        """
        why = "" if self._cause is None else f" ({self._cause})"
        if abort is not None:
            self._abort = abort
        elif interrupted:
            self._abort = "Ctrl-C again leaves"
        return MESSAGES.post(
            f"{self._name} is being lowered{why}. {self._abort} at once, torque ON", self._level
        )

    def begin_again(self) -> Message:
        """Send and return the message of a Ctrl-C while another thread lowers the arm."""
        return MESSAGES.post(
            f"Ctrl-C: {self._name} is being lowered already. Ctrl-C again leaves at once, torque "
            "ON",
            self._level,
        )

    def progress(self, lowering: Lowering) -> None:
        """Send a message about the progress of a descent, at most once every `PROGRESS` seconds.

        A descent that takes long also gets reminders of how to end it.
        """
        now = time.monotonic()
        if self._start_height is None:
            self._start_height = self._height()
        if now - self._last_progress < PROGRESS:
            return
        self._last_progress = now
        # Ignore every error here: an error in a message must not end the descent.
        with contextlib.suppress(Exception):
            if self._elapsed() > self._next_reminder:
                self._next_reminder = self._elapsed() + REMINDER_PERIOD
                MESSAGES.post(
                    f"{self._name} is not down after {self._elapsed():.0f} s, because it does not "
                    "come to rest: take away the hand or object that moves it or holds it up. "
                    f"{self._abort} at once, torque ON",
                    logging.WARNING,
                )
            where = PHASES.get(lowering.phase, lowering.phase)
            # The ports come last: a narrow terminal has no room for them.
            MESSAGES.post(
                f"{self._short_name}: {where}, {self._height_change()}, {self._elapsed():.0f} s"
                f"{self._stall(lowering.phase)}{self._ports}",
                self._detail,
                progress=True,
            )

    def _stall(self, phase: str) -> str:
        """Return the end of a progress message of an arm that does not come to rest, or ""."""
        height, elapsed = self._height(), self._elapsed()
        if phase != "down" or height < self._mark[0] - STALL_HEIGHT:
            self._mark = height, elapsed
        if elapsed - self._mark[1] < STALL_TIME:
            return ""
        return ", not at rest: is a hand on it?"

    def faults(self) -> None:
        """Note the faults that have appeared since the first call, for the last message."""
        texts, known = self._io.faults(), self._known_faults
        if known is None:
            known = _kinds(texts)
        self._known_faults = _kinds(texts) | known
        self._new_faults += [text for text in texts if not _kinds((text,)) <= known]

    def lowered(self, *, has_signal: bool = False) -> str:
        """Send the message that the arm rests with torque off, and return its text.

        Args:
            has_signal: True if a signal came during the descent; the level is then WARNING.
        """
        return self._post(
            f"{self._name} was lowered: torque OFF, {self._height_change()}, "
            f"{self._elapsed():.1f} s",
            logging.WARNING if has_signal else self._level,
        )

    def left_enabled(self, *, stopped: bool = False) -> str:
        """Send the message that torque stays on, with loaded joints and remedy; return its text.

        Args:
            stopped: True if a descent was aborted; the level is then WARNING.
        """
        return self._post(
            f"{self._name} stays where it is, torque ON: {self._loaded_joints()}. {RECOVER}",
            logging.WARNING if stopped else self._level,
        )

    def failed(
        self,
        error: BaseException,
        on: list[str] | None,
        unknown: Sequence[str] = (),
        *,
        down: bool = False,
        has_guardian: bool = False,
    ) -> str:
        """Send the message that a descent failed, with error and torque state; return its text.

        Args:
            error: Error that ended the descent.
            on: Joints whose torque is on; None if unknown, because the servos do not answer.
            unknown: Joints whose torque is unknown, and which may be among those in `on`.
            down: True if the arm rests, and torque off failed.
            has_guardian: True if the guardian tries to lower the arm, once the program has closed
                it.
        """
        if on is None:
            again = "start the program again, which takes the arm over"
            if has_guardian:
                again = (
                    "its guardian lowers it in the 30 s after this program has closed the arm or "
                    f"ended; later {again}"
                )
            return self._post(
                f"{self._name} was not lowered, the bus is gone: servos that have power keep their "
                f"last goal and limit, torque ON. Repair the connection; {again}; or support the "
                "arm and cut the supply",
                logging.WARNING,
            )
        on = [name for name in on if name not in unknown]
        states = [f"torque is ON in {', '.join(on)}"] if on else []
        states += [f"torque is not known in {', '.join(unknown)}"] if unknown else []
        state = f"{' and '.join(states)}. {RECOVER}" if states else "torque is OFF"
        what = "rests, but torque off failed" if down else "was not lowered"
        return self._post(f"{self._name} {what} ({brief(error)}): {state}", logging.WARNING)

    def unrestored(self, names: Sequence[str]) -> None:
        """Warn that the joints `names` still have the torque limits and speeds of this program."""
        self._post(
            f"{self._name}: the torque limits and speeds of {', '.join(names)} could not be "
            "restored: switch the supply off and on before another program drives these joints",
            logging.WARNING,
        )

    def _post(self, text: str, level: int) -> str:
        """Send a last message, after one with the faults of the descent; return its text."""
        if self._new_faults:
            told = f"{self._name}, while it was lowered: {join_faults(self._new_faults)}"
            MESSAGES.post(told, logging.WARNING)
            self._new_faults.clear()
        MESSAGES.post(text, level)
        return text

    def _loaded_joints(self) -> str:
        """Return a text that lists joints whose gravity torque exceeds friction, largest first."""
        with contextlib.suppress(Exception):
            io = self._io
            load = np.abs(io.gravity())
            friction = np.broadcast_to(np.asarray(io.servos.friction), load.shape)
            names = [
                io.model.joint_names[joint]
                for joint in np.argsort(-load)
                if load[joint] > max(float(friction[joint]), MIN_LOAD)
            ]
            if names:
                verb = "carry" if len(names) > 1 else "carries"
                return f"{', '.join(names)} {verb} it"
        return "no joint carries much"

    def _elapsed(self) -> float:
        """Return the time since the start of the shutdown [s], on the arm's clock."""
        return self._io.clock.now() - self._start_time

    def _height(self) -> float:
        """Return the height of the tool above the base's origin [m]; NaN if unknown.

        It is unknown while a joint of the chain is silent.
        """
        with contextlib.suppress(Exception):
            if not self._io.outdated().any():
                return self._height_at(self._io.q)
        return float("nan")

    def _height_at(self, q: Array) -> float:
        """Return the height of the tool above the base's origin [m] at q (n,) [rad]."""
        model = self._io.model
        gravity = np.asarray(model.gravity_vector)
        up = -gravity / max(float(np.linalg.norm(gravity)), 1e-9)
        return float(np.asarray(model.forward_kinematics(q))[:3, 3] @ up)

    def _height_change(self) -> str:
        height = self._height()
        drop = 100.0 * ((height if self._start_height is None else self._start_height) - height)
        if not np.isfinite(drop):
            return "height not known"
        direction = "higher" if drop < -0.5 else "lower"
        return f"tool {abs(drop):.0f} cm {direction}"


def _kinds(faults: Sequence[str]) -> set[str]:
    """Return the texts of faults without their numbers, which differ from reading to reading."""
    return {re.sub(r"[\d.]+", "", text) for text in faults}


def exit_cause(error: BaseException | None) -> str | None:
    """Return the reason for a shutdown that the exception `error` caused; None if it is planned."""
    if error is None or isinstance(error, GeneratorExit):
        return None
    number = signal_of(error)
    if number is not None:
        return name_of(number)
    if isinstance(error, SystemExit):
        return None
    return brief(error)


def brief(error: BaseException) -> str:
    """Return type and first line of an exception, cut at `MAX_REASON` characters.

    Errors of this package are not cut: they name servos and remedies.
    """
    lines = str(error).strip().splitlines()
    text = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
    return (
        text
        if isinstance(error, PliantError) or len(text) <= MAX_REASON
        else f"{text[: MAX_REASON - 3]}..."
    )


#: Factors by which the true stiffness of a servo may be larger or smaller than the assumed one, in
#: `hold_position`.
STIFFER, SOFTER = 2.5, 2.0
#: Speed limit of a silent joint in `hold_position` [rad/s].
CREEP_SPEED = 0.01
#: Silence of the bus after which a descent ends with an error [s].
MAX_SILENCE = 2.0
#: Longest time since the last write at which a descent may end with torque off [s]. After a longer
#: one torque stays on, because the servos lack the last torque limits.
MAX_UNSENT = 0.2
#: Largest number of times that a descent is restarted because servos rejected its goals; it is not
#: restarted while a joint is silent.
MAX_RESTARTS = 2
#: Time for which an arm at rest waits for joints whose torque is unknown, before torque off [s].
UNKNOWN_TIME = 20.0
#: Distance of a joint from the rest pose above which the pose counts as missed [rad].
MISSED_POSE = 0.05


def descend(
    io: ArmIO,
    rest: Array | None,
    rate: float,
    is_aborted: Callable[[], bool],
    *,
    on_tick: Callable[[Lowering], None] | None = None,
    on_detour: Callable[[str], None] = lambda _: None,
) -> bool:
    """Lower the arm until its torque limits are zero, so that torque can be switched off.

    Joints off the chain (grippers) keep goal and limit until the arm rests. Single errors of the
    drive do not end the descent, but `MAX_SILENCE` without a read or without a write does; the
    servos then keep their last goal and limit. The torque limits go to zero only when the torque of
    all joints is known.

    Args:
        io: Read and write access to the arm.
        rest: Rest pose to move to first (n,) [rad]; None: straight down. The move ends when a
            joint is silent or has a fault.
        rate: Rate of the arm's loops [Hz]; the descent uses at least `MIN_RATE`.
        is_aborted: Function that returns True to abort the descent; torque then stays on.
        on_tick: Function to call with the descent in each cycle; None: no call.
        on_detour: Function to call with the reason if the move to the rest pose is given up.

    Returns:
        True if the torque limits are zero; False if the descent was aborted.

    Raises:
        ServoError: The bus is gone; torque stays on.
        ServoFaultError: Servos reject goals, or rejected them before joints became silent, or the
            torque of a joint stays unknown; torque stays on.
        Exception: The drive raises another error for `MAX_SILENCE`; torque stays on.
    """
    clock, model = io.clock, io.model
    period = 1.0 / max(rate, MIN_RATE)
    # Disable the servos' watchdogs: after a trip, a servo would reject the goals of the descent.
    with contextlib.suppress(Exception):
        io.set_watchdog(0.0)
    refused = 0
    unsent: Exception | None = None
    lowering = Lowering(model, io.servos, io.q, goal=io.goal, limit=io.limit, rest=rest)
    before = deadline = heard = begin = clock.now()
    while not is_aborted():
        now = clock.now()
        ok = np.zeros(model.n, dtype=bool)
        try:
            ok = io.sample()
            heard = now
            if (found := io.resume_silent()) is not None:
                lowering.take_over(found, io.q, io.goal, io.limit)
        except Exception as error:
            # Errors of a drive's own code must not keep the arm up either.
            if now - heard > MAX_SILENCE:
                _end(error)
        if lowering.phase == "rest" and (unfit := io.unfit_joints(now)):
            # Without this joint, the others would move along another path, which may lead upward.
            reasons = [f"{names} ({reason})" for names, reason in named_together(unfit.items())]
            on_detour(f"{', '.join(reasons)} may not follow to the rest pose")
            rest = None
            lowering.skip_rest()
        is_on_way = lowering.phase == "rest"
        order = lowering.step(io.q, ok, dt=now - before, age=io.delay(now))
        if is_on_way and lowering.phase != "rest" and (reason := _missed_pose(io, rest, lowering)):
            on_detour(reason)
        if lowering.phase == "ramp" and io.torque_unknown.any():
            if (found := _wait_for_silent(io, rate, is_aborted)) is not None:
                lowering.take_over(found, io.q, io.goal, io.limit)
            before = deadline = heard = begin = clock.now()
            continue
        gap = now - max(io.last_write, begin)
        if unsent is not None and gap > (MAX_SILENCE if order is not None else MAX_UNSENT):
            # The servos lack these goals and limits: if torque went off now, the arm would fall.
            _end(unsent)
        if order is None and not io.is_refused():
            return True
        if order is None:
            refused += 1
            # Do not start again from an old position: the arm may be lower, and would rise to it.
            if refused > MAX_RESTARTS or io.outdated().any():
                raise ServoFaultError(
                    "servos do not take the goals that lower the arm, and torque stays on: support "
                    "the arm, then cut the supply"
                )
            lowering = Lowering(model, io.servos, io.q, rest=rest)
            continue
        if on_tick is not None:
            on_tick(lowering)
        speed_limit = order.speed_limit if np.isfinite(order.speed_limit).any() else None
        try:
            io.send(order.goal, order.torque_limit, speed_limit)
            unsent = None
        except Exception as error:
            unsent = error
        before, deadline = now, max(deadline + period, now)
        clock.wait_until(deadline)
    return False


def _end(error: Exception) -> NoReturn:
    """Raise the error that ends a descent whose drive raises `error` in every cycle."""
    if not isinstance(error, ServoError):
        raise error
    raise ServoError(
        "the bus is gone while the arm was being lowered: servos that have power keep their last "
        "goal and limit; support the arm before you cut the supply"
    ) from error


def _missed_pose(io: ArmIO, rest: Array | None, lowering: Lowering) -> str | None:
    """Return a text about an arm that stands away from its rest pose; None if it is there."""
    if rest is None:
        return None
    if lowering.blind:
        return "no servo answers on the way to the rest pose"
    away = np.abs(np.asarray(rest) - io.q)
    joint = int(np.argmax(away))
    if away[joint] < MISSED_POSE:
        return None
    name = io.model.joint_names[joint]
    return f"the arm gets no closer to the rest pose, {name} is {away[joint]:.2f} rad away"


def _wait_for_silent(io: ArmIO, rate: float, is_aborted: Callable[[], bool]) -> Mask | None:
    """Wait until a joint whose torque is unknown has answered, and take it over; send nothing.

    Returns:
        Mask (n,) of the joints that have answered, see `ArmIO.resume_silent`; None after an abort.

    Raises:
        ServoFaultError: No such joint answered within `UNKNOWN_TIME`.
    """
    end = io.clock.now() + UNKNOWN_TIME
    while io.clock.now() < end and not is_aborted():
        with contextlib.suppress(ServoError):
            io.sample()
            if (found := io.resume_silent()) is not None:
                return found
        io.clock.wait_until(io.clock.now() + 1.0 / rate)
    if not is_aborted():
        raise ServoFaultError(
            f"no answer from {', '.join(io.unknown_joints())}, which may hold the arm up: torque "
            "stays as it is"
        )
    return None


def hold_position(io: ArmIO) -> None:
    """Send goals and torque limits that hold the present pose; disable the servos' watchdogs.

    A joint that is silent keeps the goal and limit last sent: its position is unknown. Its servo
    may have missed this goal, so it moves there at `CREEP_SPEED`.
    """
    kp, gravity = np.asarray(io.servos.kp), io.gravity()
    push, need = torque_margin(io.servos, gravity), gravity / kp
    # Keep the present lead (goal minus position) if it can hold the weight at some stiffness.
    ends = np.sort((need / STIFFER, need * SOFTER), axis=0)
    lead = np.clip(io.goal - io.q, ends[0] - push / kp, ends[1] + push / kp)
    limit = SUPPORT * np.abs(gravity) + push
    # Do not raise the limit of a servo that holds the weight at its torque limit: the joint
    # would move.
    full = (kp * np.abs(lead) > io.limit) & (io.limit >= np.abs(gravity))
    held = np.where(full, np.minimum(io.limit, limit), limit)
    goal, old = io.q + lead, io.outdated()
    if old.any():
        goal, held = np.where(old, io.goal, goal), np.where(old, io.limit, held)
        io.send(goal, held, np.where(old, CREEP_SPEED, np.inf))
    else:
        io.send(goal, held)
    io.set_watchdog(0.0)
