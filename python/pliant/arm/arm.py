"""Class `Arm`: switches torque on, reads and writes joints, and lowers the arm at the end."""

from __future__ import annotations

import atexit
import contextlib
import logging
import os
import sys
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ArmPoints, ConfigError, ServoError
from pliant._validation import instance, real
from pliant.arm._checks import check_rest, path_obstacle, posture, times
from pliant.arm._io import ArmIO
from pliant.arm._messages import MESSAGES
from pliant.arm._shutdown import ExitMessages, descend, exit_cause, hold_position
from pliant.arm._signals import Signals, is_interrupted
from pliant.arm._startup import (
    check_within_limits,
    initial_commands,
    stiffness_mismatch,
    transfer_weight,
    wait_for_all,
)
from pliant.arm._supervisor import Supervisor
from pliant.arm.gripper import Gripper, check_grippers, make_grippers
from pliant.arm.thermal import Budget

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager
    from types import TracebackType

    from numpy.typing import ArrayLike

    from pliant._core import Model
    from pliant._typing import Array
    from pliant.arm.gripper import GripperConfig
    from pliant.drive import Clock, Drive, State

    Exit = Literal["lower", "leave_enabled"]


class Arm:
    """Robot arm whose joints a `Drive` moves.

    `with` opens and enables the arm. At its end, also after an exception, it acts as `on_exit` says
    and closes the drive. Only the process that switched torque on may use the arm until torque is
    off: in a process forked from it, `close` and the end of the program do nothing, and `read` and
    `write` raise.

    Args:
        model: The robot; its joint names are matched with the drive's.
        drive: Interface to the servos or the simulator.
        rest_q: Joint positions (n,) [rad] to which `lower` moves first, if the path is clear of the
            table; None: straight down.
        on_exit: What `close` and the end of `with` do while torque is on: `lower`, or
            `leave_enabled`.
        rate: Rate of the arm's own loops in `enable` and `lower` [Hz].
        comm_timeout: Time without positions or without commands after which a `Loop` raises [s],
            at most 60.
        power_budget: Thermal and supply limits; None: the default.
        grippers: Configurations of joints off the chain, by name; a joint that is not listed has
            the default `GripperConfig`.
        watchdog: Silence after which servos stop by themselves, where supported [s]; 0: never. A
            stopped servo holds its present position and loses the lead that carries the weight:
            the arm sinks by ``g/k_p``.
        handle_signals: Whether SIGINT, SIGTERM, SIGHUP and SIGQUIT lower the arm.
        table: Height of the table in base axes [m]; None: no table, or its height is unknown.

    Attributes:
        model: The given model with the parameters of `servos`.
        drive, rate, rest_q, comm_timeout, table: As given.
        detour: Reason why the last descent skipped the rest pose; None if there was no reason.
        servos: Servo parameters of the chain, n entries, from the drive; updated when it opens.
        grippers: Grippers by joint name; created again when the drive opens.
        leads: Goal minus position that carried each joint at torque on (n,) [rad]; NaN if unknown:
            the joint rested on something, or torque was never on.

    Raises:
        ConfigError: The drive lacks a joint of the model, or an argument is out of range.
        TypeError: `power_budget` or a gripper has another type.
        ShapeError, OutOfRangeError: The rest pose is not valid.
    """

    def __init__(
        self,
        model: Model,
        drive: Drive,
        *,
        rest_q: ArrayLike | None = None,
        on_exit: Exit = "lower",
        rate: float = 100.0,
        comm_timeout: float = 0.5,
        power_budget: Budget | None = None,
        grippers: Mapping[str, GripperConfig] | None = None,
        watchdog: float = 0.0,
        handle_signals: bool = True,
        table: float | None = None,
    ) -> None:
        """Match the drive's joints with the model's; open no port and move nothing."""
        if on_exit not in {"lower", "leave_enabled"}:
            raise ConfigError(f"on_exit must be 'lower' or 'leave_enabled', got {on_exit!r}")
        self.model, self.drive = model, drive
        self.rate, self.comm_timeout, self._watchdog = times(rate, comm_timeout, watchdog)
        self._on_exit = on_exit
        self._budget = (
            Budget() if power_budget is None else instance(power_budget, Budget, "power_budget")
        )
        self._gripper_configs = check_grippers(grippers)
        self._supervisor = Supervisor(self._take_down)
        self._signals = Signals(self._supervisor.abort.set) if handle_signals else None
        self._exit_message: str | None = None
        self._build()
        self.table = None if table is None else real(table, "table [m]")
        self.detour: str | None = None
        self.rest_q = None if rest_q is None else posture(self.model, rest_q, "rest_q")
        if self.rest_q is not None:
            check_rest(self.model, self._points, self.rest_q, self.table)
        self._opened = False
        self.leads: Array = np.full(model.n, np.nan)

    def _build(self) -> None:
        """Create the parts that depend on servo parameters; called again once `open` read them."""
        self._io = ArmIO(self.model, self.drive, self._budget)
        self.servos = self._io.servos
        # The model's own servo parameters may differ from the drive's.
        self.model = self.model.with_servos(self.servos)
        self._points = ArmPoints(self.model, self.servos.armature)
        self.grippers = make_grippers(self._io, self._gripper_configs, self._send_gripper)

    @property
    def enabled(self) -> bool:
        """True if torque is on and this process switched it on."""
        return self._supervisor.owner == os.getpid()

    def open(self) -> None:
        """Connect and identify the servos; torque stays as it is.

        Raises:
            ServoError: The servos cannot be reached or identified.
        """
        if not self._opened:
            self.drive.open()
            self._opened = True
            self._build()

    def enable(self) -> None:
        """Switch torque on at the present positions, and let the servos take up the weight.

        The first limits are little above the gravity torques; then all limits rise within 0.5 s.
        Joints whose torque is on already keep the goals and limits that hold them, and an arm that
        lies on a table stays there. Signal handlers are installed before torque comes on.

        Raises:
            ServoTimeoutError: Joints do not answer; the message names them.
            ServoError: A joint reads outside its limits, and nothing was sent; or joints moved or
                did not confirm when torque came on.
        """
        with self._supervisor.exclusive():
            if not self.enabled:
                self._enable()

    def _enable(self) -> None:
        """Enable the arm; the caller holds the lock."""
        self.open()
        self._supervisor.reason = None
        io = self._io
        wait_for_all(io, self.rate)
        names = io.joints.names
        on = np.broadcast_to(getattr(self.drive, "enabled", False), len(names))[io.joints.chain]
        check_within_limits(io, on)
        start_q = io.q
        start, limit, carried = initial_commands(io, on)
        for name, gripper in self.grippers.items():
            io.orders[name] = (gripper.position, gripper.limit)
        MESSAGES.start()
        try:
            if self._signals is not None:
                self._signals.install()
            atexit.register(self._at_exit)
            self._supervisor.owner = os.getpid()
            io.start(start, limit)
        except ServoError:
            self._release()
            raise
        except BaseException:
            # A signal before torque on: no descent follows that would remove the handlers.
            if not self.enabled:
                self._release()
            raise
        self.leads = transfer_weight(io, start_q, carried, self.rate)
        if text := stiffness_mismatch(io, self.leads):
            MESSAGES.post(text, logging.WARNING)
        io.set_watchdog(self._watchdog)

    def lower(self) -> None:
        """Lower the arm: to the rest pose if set, then down at 0.15 m/s until it rests; torque off.

        Raises:
            ServoError: The bus is gone, or torque of a joint stayed on.
        """
        self._descend(self.rest_q)

    def park(self, pose: ArrayLike | None = None) -> None:
        """Move to a pose (n,) [rad], by default the rest pose, straight in joint space; then lower.

        Raises:
            ConfigError, ShapeError, OutOfRangeError: The pose is not valid, or inside the table;
                nothing has moved.
            ServoError: As `lower`.
        """
        if pose is None and self.rest_q is None:
            raise ConfigError("no pose to park in: arm.park([...]) or connect(..., rest_q=[...])")
        if pose is None:
            self._descend(self.rest_q)
            return
        target = posture(self.model, pose, "pose")
        check_rest(self.model, self._points, target, self.table)
        self._descend(target)

    def leave_enabled(self) -> None:
        """Hold the present pose with torque on, also after the program ends.

        The servos heat up, because nothing reduces their limits any more.
        """
        with self._supervisor.exclusive():
            if self.enabled:
                hold_position(self._io)
                self._exit_message = self._exit_messages(exit_cause(sys.exception())).left_enabled()
                self._release()

    def disable_torque(self) -> None:
        """Switch torque off in the present pose: the arm falls. Every joint is tried.

        Raises:
            ServoError: Torque of a joint stayed on.
        """
        with self._supervisor.exclusive(at_once=True):
            try:
                self.drive.disable(self._io.joints.names)
            finally:
                self._release()

    def close(self) -> None:
        """If torque is on, lower the arm or leave it enabled, as `on_exit` says; close the drive.

        If another process switched torque on, do nothing.
        """
        if self._supervisor.is_owned_elsewhere:
            return
        try:
            if self.enabled:
                self.lower() if self._on_exit == "lower" else self.leave_enabled()
        finally:
            self._release()
            if self._opened:
                self._opened = False
                self.drive.close()
            MESSAGES.flush()

    def _descend(self, rest: Array | None) -> None:
        """Lower the arm through `rest` (n,) [rad]; a second Ctrl-C aborts, with torque on."""
        if not self.enabled:
            return
        error, signals = sys.exception(), self._signals
        messages = self._exit_messages(self._supervisor.reason or exit_cause(error))
        announcement = messages.begin(interrupted=is_interrupted(error))
        if signals is not None:
            signals.begin(announcement)
        try:
            with self._supervisor.exclusive():
                try:
                    if self.enabled:
                        self._run_descent(rest, messages)
                finally:
                    self._release()
        finally:
            self._release()
            MESSAGES.flush()
            if signals is not None:
                signals.deliver()

    def _run_descent(self, rest: Array | None, messages: ExitMessages) -> None:
        """Descend and switch torque off; if the descent is aborted, keep the arm held."""
        down = False
        rest = self._reachable(rest)
        if self.detour is not None:
            MESSAGES.post(f"{self.detour}: the arm is lowered straight down")
        try:
            down = descend(
                self._io,
                rest,
                self.rate,
                self._supervisor.abort.is_set,
                on_tick=messages.progress,
            )
            if down:
                with contextlib.suppress(ServoError):
                    self._io.set_watchdog(0.0)
                self.drive.disable(self._io.joints.names)
        except BaseException as error:
            # SystemExit after an abort: a third Ctrl-C ended a call on a bus that hangs. Another
            # call could hang too.
            hangs = isinstance(error, SystemExit) and self._supervisor.abort.is_set()
            if not down and not hangs:
                self._hold()
            # Without a connection the torque state is unknown.
            is_unknown = isinstance(error, ServoError) and not down
            self._exit_message = messages.failed(
                error, None if is_unknown else self._powered_joints()
            )
            raise
        if down:
            has_signal = self._signals is not None and self._signals.has_pending
            self._exit_message = messages.lowered(has_signal=has_signal)
        else:
            self._hold()
            self._exit_message = messages.left_enabled(stopped=True)

    def _hold(self) -> None:
        """Try to send goals and limits that hold the arm; ignore errors."""
        with contextlib.suppress(Exception):
            hold_position(self._io)

    def _powered_joints(self) -> list[str]:
        """Return the joints whose torque is on, as far as the drive knows."""
        names = self._io.joints.names
        on = np.broadcast_to(getattr(self.drive, "enabled", True), len(names))
        return [name for name, powered in zip(names, on, strict=True) if powered]

    def _exit_messages(self, cause: str | None) -> ExitMessages:
        return ExitMessages(self.model.name, self._io, cause)

    def _reachable(self, rest: Array | None) -> Array | None:
        """Return the rest pose if the path is free; else set `detour` and return None."""
        self.detour = None
        if rest is None:
            return None
        self.detour = path_obstacle(self.model, self._points, self._io.q, rest, self.table)
        return rest if self.detour is None else None

    def _take_down(self) -> None:
        """Lower the arm or leave it enabled, in the watchdog thread, after the program stalled."""
        try:
            if not self.enabled:
                return
            messages = self._exit_messages(self._supervisor.reason)
            if self._on_exit == "lower":
                messages.begin()
                self._run_descent(self.rest_q, messages)
            else:
                hold_position(self._io)
                self._exit_message = messages.left_enabled()
        finally:
            self._supervisor.owner = None

    def _release(self) -> None:
        """Give up ownership, stop the watchdog thread and restore the signal handlers."""
        self._supervisor.owner = None
        self._supervisor.end_supervision()
        atexit.unregister(self._at_exit)
        if self._signals is not None:
            self._signals.restore()

    def _at_exit(self) -> None:
        """Close the arm when the interpreter exits with torque on."""
        if not self._supervisor.is_owned_elsewhere:
            self._supervisor.reason = self._supervisor.reason or "the program ends"
        self.close()

    def __repr__(self) -> str:
        """Return a one-line description."""
        torque = "on" if self.enabled else "off"
        return f"<Arm {self.model.name}, {self.model.n} joints, torque {torque}>"

    def __enter__(self) -> Arm:
        try:
            self.enable()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._exit_message = None
        try:
            self.close()
        except ServoError as worse:
            if error is None:
                raise
            # The first error is the cause; attach the error of the descent as a note.
            error.add_note(f"while the arm was being lowered: {worse}")
        else:
            if error is not None and self._exit_message is not None:
                # The traceback is printed after the summary: repeat the summary below it.
                error.add_note(f"pliant: {self._exit_message}")
        finally:
            if isinstance(error, KeyboardInterrupt):
                _end_at_the_caller(error)

    def read(self) -> State:
        """Return the state of the joints in this cycle.

        A joint without an answer, or with an implausible one, keeps its last position, and its age
        grows: see `State.fresh`, `State.age`.

        Raises:
            ServoTimeoutError: The program stalled for too long, and the arm was lowered meanwhile.
            ServoError: The connection is gone, or another process switched torque on.
        """
        with self._supervisor:
            return self._io.state(self._io.sample())

    def write(
        self,
        goal: ArrayLike,
        limit: ArrayLike | None = None,
        extra: Mapping[str, tuple[float, float]] | None = None,
        *,
        lead: bool = False,
        velocity: ArrayLike | None = None,
    ) -> None:
        """Send goals and torque limits, within position limits and budgets.

        Low limits are sent unchanged: with a limit below the weight the arm sinks, with 0 it falls.
        A `RuntimeWarning` is issued once if a limit stays below half of the weight for 0.2 s, but
        not for a `Controller`'s commands in `Tick.write`.

        Args:
            goal: Joint goals (n,) [rad]. They are clipped to the position limits, extended by the
                lead that the gravity torque needs.
            limit: Torque limits (n,) [N·m]; None keeps those sent last.
            extra: Goal [rad] and limit [N·m] of joints off the chain by name; others keep theirs.
            lead: Whether goals may lie beyond the position limits to exert a force. A `Controller`
                makes sure that this moves no joint out of its range; `Tick.write` sets `lead` for
                its commands.
            velocity: Largest velocity (n,) [rad/s] toward the goals, for the servos' speed
                registers; None or inf: no speed limit.

        Raises:
            ShapeError, OutOfRangeError, ConfigError, TypeError: Invalid argument; nothing was sent.
            ServoTimeoutError: As `read`.
            ServoError: Torque is off, or was switched on by another process, or the connection is
                gone.
        """
        with self._supervisor:
            self._check_enabled()
            self._io.write(goal, limit, extra, lead=lead, velocity=velocity)

    def supervised(self, patience: float) -> AbstractContextManager[Callable[[], None]]:
        """Return a context in which a thread acts as `on_exit` says if the program stalls.

        It acts after `patience` [s] without a call of the arm; in simulated time, never. The
        context yields a function that raises `ServoTimeoutError` once the thread has acted. `Loop`
        uses this.
        """
        real = getattr(self.clock, "real_time", False)
        return self._supervisor.supervised(patience if real else None)

    def ramp_limits(self) -> None:
        """Start a ramp of 0.5 s that bounds limits, from those that hold the arm to the largest.

        `Loop` calls it after a gap, when goals may be far from the present positions.
        """
        self._io.ramp_limits()

    @property
    def gripper(self) -> Gripper:
        """The gripper, if it is the only joint off the chain.

        Raises:
            ConfigError: There is no such joint, or several; use `grippers`.
        """
        if len(self.grippers) != 1:
            there = ", ".join(self.grippers) or "none"
            raise ConfigError(f"arm.gripper needs one joint off the chain; there are: {there}")
        return next(iter(self.grippers.values()))

    @property
    def clock(self) -> Clock:
        """Clock of the drive."""
        return self._io.clock

    @property
    def heat(self) -> dict[str, float]:
        """Used share of each joint's thermal budget, by joint name; limits fall from 0.8 on."""
        return dict(zip(self._io.joints.names, self._io.thermal.heat.tolist(), strict=True))

    @property
    def counters(self) -> dict[str, int]:
        """Event counters: those of the drive, and `jumps`, the readings rejected for a jump."""
        return {**self.drive.counters, "jumps": self._io.positions.jumps}

    def _send_gripper(self, name: str, goal: float, limit: float) -> None:
        """Send goal and limit of a joint off the chain at once; the chain's stay unchanged."""
        with self._supervisor:
            self._check_enabled()
            self._io.orders[name] = (goal, limit)
            self._io.send(self._io.goal, self._io.limit)

    def _check_enabled(self) -> None:
        if not self.enabled:
            raise ServoError("torque is off: use `with connect(...) as arm`, or arm.enable()")


def _end_at_the_caller(error: KeyboardInterrupt) -> None:
    """Cut this package's frames off the traceback of a Ctrl-C; they do not help the user."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        module = trace.tb_next.tb_frame.f_globals.get("__name__", "")
        if module.partition(".")[0] == "pliant":
            trace.tb_next = None
        trace = trace.tb_next
