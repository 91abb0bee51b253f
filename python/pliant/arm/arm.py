"""An arm that is not dropped: torque on in order, limits within budget, a way down at the end."""

from __future__ import annotations

import atexit
import contextlib
import logging
import os
import sys
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant import ConfigError, ServoError
from pliant.arguments import instance, real
from pliant.arm.budget import Budget
from pliant.arm.checks import posture, times
from pliant.arm.cycle import Cycle
from pliant.arm.ending import Ending, cause_of
from pliant.arm.entry import first_orders, hear_all, stand_within, strange_leads, take_up
from pliant.arm.exits import descend, settle
from pliant.arm.gripper import Gripper, check_grippers, make_grippers
from pliant.arm.keeper import Keeper
from pliant.arm.points import Points
from pliant.arm.rest import check_rest, obstacle
from pliant.arm.signals import Signals, is_interrupted
from pliant.arm.speaker import SPEAKER

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager
    from types import TracebackType

    from numpy.typing import ArrayLike, NDArray

    from pliant import Model
    from pliant.arm.drive import Clock, Drive
    from pliant.arm.gripper import GripperConfig
    from pliant.arm.state import State

    Array = NDArray[np.float64]
    Exit = Literal["lower", "leave_enabled"]


class Arm:
    """An arm over any drive, with its life cycle.

    `with` opens, identifies and enables it, and lowers it at the end, whatever the reason. With
    torque on it belongs to the process that switched it on: in one forked from that, exits do
    nothing, and `read` and `write` raise.

    Args:
        model: The robot; its joint names are looked up among the drive's.
        drive: What moves the joints.
        rest_q: Joint positions (n,) [rad] where `lower` goes first, where the way is free of the
            table; None: straight down.
        on_exit: Action on leaving: `lower`, or `leave_enabled`.
        rate: Of the arm's own loops, enabling and leaving [Hz].
        comm_timeout: Time without an answer from the bus or the program after which the arm is
            lowered [s], at most 60.
        budget: What servos and supply give for long; None: the default.
        grippers: How joints off the chain open and close, by name; others take the model's limits.
        watchdog: Silence after which servos that can stop by themselves do [s]; 0: never. One that
            stops holds the position where it is then and loses the lead that carries the weight:
            the arm sinks by ``g/k_p``.
        signals: Whether SIGINT, SIGTERM, SIGHUP and SIGQUIT lower the arm.
        table: Height of the table that it stands on, in base axes [m]; None: there is none, or it
            is not known.

    Attributes:
        model: As given, driven by `servos`.
        drive, rate, rest_q, comm_timeout, table: As given.
        detour: Why the last descent left the rest pose out; None where it did not.
        servos: The chain's servos, n entries, as the drive has them; better known once open.
        grippers: The joints off the chain by name; made anew when the drive opens.
        leads: Goal minus position that carried each joint when torque came on (n,) [rad], NaN
            where that is not known: a joint that rested on something, or torque was never on.

    Raises:
        ConfigError: The drive lacks a joint of the model, or an argument is out of range.
        TypeError: A budget or gripper of another kind.
        ShapeError, OutOfRangeError: The rest pose is none.
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
        budget: Budget | None = None,
        grippers: Mapping[str, GripperConfig] | None = None,
        watchdog: float = 0.0,
        signals: bool = True,
        table: float | None = None,
    ) -> None:
        """Sort the joints; nothing is opened or moved yet."""
        if on_exit not in {"lower", "leave_enabled"}:
            raise ConfigError(f"on_exit must be 'lower' or 'leave_enabled', got {on_exit!r}")
        self.model, self.drive = model, drive
        self.rate, self.comm_timeout, self._watchdog = times(rate, comm_timeout, watchdog)
        self._on_exit = on_exit
        self._budget = Budget() if budget is None else instance(budget, Budget, "budget")
        self._gripper_configs = check_grippers(grippers)
        self._keeper = Keeper(self._leave)
        self._signals = Signals(self._keeper.unwanted.set) if signals else None
        self._left: str | None = None
        self._meet()
        self.table = None if table is None else real(table, "table [m]")
        self.detour: str | None = None
        self.rest_q = None if rest_q is None else posture(self.model, rest_q, "rest_q")
        if self.rest_q is not None:
            check_rest(self.model, self._points, self.rest_q, self.table)
        self._opened = False
        self.leads: Array = np.full(model.n, np.nan)

    def _meet(self) -> None:
        """Make all that depends on what the servos are: a drive that is open knows it better."""
        self._cycle = Cycle(self.model, self.drive, self._budget)
        self.servos = self._cycle.servos
        # What is made from the model alone must not believe the table that it came with.
        self.model = self.model.with_servos(self.servos)
        self._points = Points(self.model, self.servos.armature)
        self.grippers = make_grippers(self._cycle, self._gripper_configs, self._order)

    # Life.

    @property
    def enabled(self) -> bool:
        """Whether torque is on, and this process switched it on."""
        return self._keeper.owner == os.getpid()

    def open(self) -> None:
        """Connect and identify; torque stays as it is.

        Raises:
            ServoError: What is wrong on the bus.
        """
        if not self._opened:
            self.drive.open()
            self._opened = True
            self._meet()

    def enable(self) -> None:
        """Torque on: limits first, goals where the joints are, then a ramp of half a second.

        The first limits carry the weight of the arm and little more: one that holds itself up is
        taken over, one that lies on a table stays there. Signal handlers come first.

        Raises:
            ServoTimeoutError: Joints do not answer; names them.
            ServoError: A joint is believed to be outside its limits, and nothing was sent; or
                joints moved or did not obey when torque came on.
        """
        with self._keeper.alone():
            if not self.enabled:
                self._enable()

    def _enable(self) -> None:
        """With the lock held."""
        self.open()
        self._keeper.reason = None
        cycle = self._cycle
        hear_all(cycle, self.rate)
        names = cycle.roster.names
        on = np.broadcast_to(getattr(self.drive, "enabled", False), len(names))[cycle.roster.chain]
        stand_within(cycle, on)
        stood = cycle.q
        start, limit, taken = first_orders(cycle, on)
        for name, gripper in self.grippers.items():
            cycle.orders[name] = (gripper.position, gripper.limit)
        SPEAKER.start()
        try:
            if self._signals is not None:
                self._signals.install()
            atexit.register(self._at_exit)
            self._keeper.owner = os.getpid()
            cycle.begin(start, limit)
        except ServoError:
            self._forget()
            raise
        except BaseException:
            # A signal before torque could come on leaves no handler behind; later ones lower.
            if not self.enabled:
                self._forget()
            raise
        self.leads = take_up(cycle, stood, taken, self.rate)
        if text := strange_leads(cycle, self.leads):
            SPEAKER.say(text, logging.WARNING)
        cycle.guard(self._watchdog)

    def lower(self) -> None:
        """To the rest pose if there is one, then down at 0.15 m/s until it rests; torque off.

        Raises:
            ServoError: The bus is gone, or a joint kept its torque.
        """
        self._descend(self.rest_q)

    def park(self, pose: ArrayLike | None = None) -> None:
        """To a pose (n,) [rad], by default the rest pose, straight through joint space; then lower.

        Raises:
            ConfigError, ShapeError, OutOfRangeError: No pose of this arm, or it is inside the
                table; nothing has moved.
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
        """Stay here with torque on, also when the program ends. Servos that hold get hot."""
        with self._keeper.alone():
            if self.enabled:
                settle(self._cycle)
                self._left = self._ending(cause_of(sys.exception())).stays()
                self._forget()

    def disable_torque(self) -> None:
        """Torque off where the arm stands: it falls. Every joint is tried.

        Raises:
            ServoError: A joint kept its torque.
        """
        with self._keeper.alone(at_once=True):
            try:
                self.drive.disable(self._cycle.roster.names)
            finally:
                self._forget()

    def close(self) -> None:
        """Leave as `on_exit` says where torque is on, then let go of the bus."""
        if self._keeper.elsewhere:
            return
        try:
            if self.enabled:
                self.lower() if self._on_exit == "lower" else self.leave_enabled()
        finally:
            self._forget()
            if self._opened:
                self._opened = False
                self.drive.close()
            SPEAKER.flush()

    def _descend(self, rest: Array | None) -> None:
        """Lower the arm; a second Ctrl-C leaves it where it is, torque on."""
        if not self.enabled:
            return
        error, signals = sys.exception(), self._signals
        ending = self._ending(self._keeper.reason or cause_of(error))
        told = ending.begin(interrupted=is_interrupted(error))
        if signals is not None:
            signals.begin(told)
        try:
            with self._keeper.alone():
                try:
                    if self.enabled:
                        self._bring_down(rest, ending)
                finally:
                    self._forget()
        finally:
            self._forget()
            SPEAKER.flush()
            if signals is not None:
                signals.deliver()

    def _bring_down(self, rest: Array | None, ending: Ending) -> None:
        """Descend and switch torque off; what ends the descent before leaves the arm carried."""
        down = False
        rest = self._reachable(rest)
        if self.detour is not None:
            SPEAKER.say(f"{self.detour}: the arm is lowered straight down")
        try:
            down = descend(
                self._cycle,
                self._points,
                rest,
                self.rate,
                self._keeper.unwanted.is_set,
                on_tick=ending.progress,
            )
            if down:
                with contextlib.suppress(ServoError):
                    self._cycle.guard(0.0)
                self.drive.disable(self._cycle.roster.names)
        except BaseException as error:
            # A bus that hangs, left by a third Ctrl-C, would hang once more.
            hangs = isinstance(error, SystemExit) and self._keeper.unwanted.is_set()
            if not down and not hangs:
                self._stay()
            # A connection that is gone cannot be asked.
            unknown = isinstance(error, ServoError) and not down
            self._left = ending.failed(error, None if unknown else self._powered())
            raise
        if down:
            heard = self._signals is not None and self._signals.heard
            self._left = ending.down(heard=heard)
        else:
            self._stay()
            self._left = ending.stays(stopped=True)

    def _stay(self) -> None:
        """Leave goals and limits that carry the arm, as far as the bus takes them."""
        with contextlib.suppress(Exception):
            settle(self._cycle)

    def _powered(self) -> list[str]:
        """Joints that have torque, as far as the drive knows."""
        names = self._cycle.roster.names
        on = np.broadcast_to(getattr(self.drive, "enabled", True), len(names))
        return [name for name, powered in zip(names, on, strict=True) if powered]

    def _ending(self, cause: str | None) -> Ending:
        return Ending(self.model.name, self._cycle, cause)

    def _reachable(self, rest: Array | None) -> Array | None:
        """Return the rest pose where the way there is free; else None, and note why not."""
        self.detour = None
        if rest is None:
            return None
        self.detour = obstacle(self.model, self._points, self._cycle.q, rest, self.table)
        return rest if self.detour is None else None

    def _leave(self) -> None:
        """Leave in the place of a program that stands still; its signals stay its own."""
        try:
            if not self.enabled:
                return
            ending = self._ending(self._keeper.reason)
            if self._on_exit == "lower":
                ending.begin()
                self._bring_down(self.rest_q, ending)
            else:
                settle(self._cycle)
                self._left = ending.stays()
        finally:
            self._keeper.owner = None

    def _forget(self) -> None:
        """Nothing is left to be brought down."""
        self._keeper.owner = None
        self._keeper.dismiss()
        atexit.unregister(self._at_exit)
        if self._signals is not None:
            self._signals.restore()

    def _at_exit(self) -> None:
        """The program ends and torque is on."""
        if not self._keeper.elsewhere:
            self._keeper.reason = self._keeper.reason or "the program ends"
        self.close()

    def __repr__(self) -> str:
        """The arm in one line."""
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
        self._left = None
        try:
            self.close()
        except ServoError as worse:
            if error is None:
                raise
            # The first error is the cause; what went wrong on the way down stands beside it.
            error.add_note(f"while the arm was being lowered: {worse}")
        else:
            if error is not None and self._left is not None:
                # A traceback comes after the summary, and would bury it.
                error.add_note(f"pliant: {self._left}")
        finally:
            if isinstance(error, KeyboardInterrupt):
                _end_at_the_caller(error)

    # Every cycle.

    def read(self) -> State:
        """What the joints report in this cycle.

        Joints that did not answer, or whose answer cannot be true, keep their last position and
        grow older: `State.fresh`, `State.age`.

        Raises:
            ServoTimeoutError: The program was away for too long, and the arm has been lowered
                meanwhile.
            ServoError: The connection is gone, or another process switched torque on.
        """
        with self._keeper:
            return self._cycle.state(self._cycle.sample())

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

        Limits are sent however low they are: with less than the weight of a pose the arm sinks,
        with 0 it falls. A `RuntimeWarning` says so once where a limit has been below half of the
        weight for 0.2 s, but not of a `Controller`'s commands in `Tick.write`.

        Args:
            goal: Joint goals (n,) [rad], cut at the position limits and what the weight needs
                beyond them.
            limit: Torque limits (n,) [N·m]; None keeps the last.
            extra: Goal [rad] and limit [N·m] of joints off the chain by name; others keep theirs.
            lead: Whether goals may lead beyond the position limits to exert a force: a `Controller`
                sees to it that no joint is driven out by that, and `Tick.write` lets its commands.
            velocity: Fastest motion (n,) [rad/s] to the goals, for the servos' speed registers;
                None, or inf: as fast as they can.

        Raises:
            ShapeError, OutOfRangeError, ConfigError, TypeError: What cannot be sent; nothing was.
            ServoTimeoutError: As `read`.
            ServoError: Torque is off, or was switched on by another process, or the connection is
                gone.
        """
        with self._keeper:
            self._on()
            self._cycle.write(goal, limit, extra, lead=lead, velocity=velocity)

    def watched(self, patience: float) -> AbstractContextManager[Callable[[], None]]:
        """Inside, an arm in real time leaves by itself after so long without read or write [s].

        `Loop` does this. Gives a function that raises `ServoTimeoutError` once that has happened.
        """
        real = getattr(self.clock, "real_time", False)
        return self._keeper.watched(patience if real else None)

    def ease(self) -> None:
        """Let limits rise again from what carries the arm, within 0.5 s: after a silence."""
        self._cycle.ease()

    @property
    def gripper(self) -> Gripper:
        """The only joint off the chain.

        Raises:
            ConfigError: There is none, or there are several: those are in `grippers`.
        """
        if len(self.grippers) != 1:
            there = ", ".join(self.grippers) or "none"
            raise ConfigError(f"arm.gripper needs one joint off the chain; there are: {there}")
        return next(iter(self.grippers.values()))

    @property
    def clock(self) -> Clock:
        """The drive's time."""
        return self._cycle.clock

    @property
    def heat(self) -> dict[str, float]:
        """Share of the thermal budget in use, by joint; limits come down from 0.8 on."""
        return dict(zip(self._cycle.roster.names, self._cycle.meter.heat.tolist(), strict=True))

    @property
    def counters(self) -> dict[str, int]:
        """What has happened so far: the drive's counters, and readings refused for a jump."""
        return {**self.drive.counters, "jumps": self._cycle.belief.jumps}

    def _order(self, name: str, goal: float, limit: float) -> None:
        """Give a joint off the chain its order at once; the chain keeps its own."""
        with self._keeper:
            self._on()
            self._cycle.orders[name] = (goal, limit)
            self._cycle.send(self._cycle.goal, self._cycle.limit)

    def _on(self) -> None:
        if not self.enabled:
            raise ServoError("torque is off: use `with connect(...) as arm`, or arm.enable()")


def _end_at_the_caller(error: KeyboardInterrupt) -> None:
    """Cut this package's frames off a traceback: Ctrl-C came wherever it came."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        module = trace.tb_next.tb_frame.f_globals.get("__name__", "")
        if module.partition(".")[0] == "pliant":
            trace.tb_next = None
        trace = trace.tb_next
