"""Class `Arm`: switches torque on, reads and writes joints, and lowers the arm at the end."""

from __future__ import annotations

import atexit
import contextlib
import logging
import math
import os
import sys
from typing import TYPE_CHECKING, Literal, NoReturn

import numpy as np

from pliant._core import ArmPoints, ConfigError, ServoError, ServoFaultError
from pliant._validation import instance, real
from pliant.arm._checks import (
    TORQUE_OFF,
    check_rest,
    path_obstacle,
    posture,
    table_height,
    times,
)
from pliant.arm._guardian import Guardian, beat_all, is_available
from pliant.arm._io import ArmIO
from pliant.arm._messages import MESSAGES
from pliant.arm._shutdown import ExitMessages, descend, exit_cause, hold_position
from pliant.arm._signals import Signals, is_interrupted
from pliant.arm._startup import (
    TOLD_LOAD,
    check_reading_time,
    check_weight,
    check_within_limits,
    displacement,
    initial_commands,
    may_lie_on,
    measured_servos,
    stiffness_mismatch,
    stiffness_ratio,
    unloaded,
    wait_for_all,
)
from pliant.arm._supervisor import Supervisor
from pliant.arm._transfer import transfer_weight
from pliant.arm.gripper import Gripper, check_grippers, make_grippers
from pliant.arm.thermal import Budget

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager
    from threading import Thread
    from types import TracebackType

    from numpy.typing import ArrayLike

    from pliant._core import Lowering, Model
    from pliant._typing import Array
    from pliant.arm.gripper import GripperConfig
    from pliant.drive import Clock, Drive, State

    Exit = Literal["lower", "leave_enabled"]


#: Longest time for switching torque on [s]; after it, the guardian takes the program for hung.
#: Retries on a bad line take seconds.
ENABLE_TIME = 10.0


class Arm:
    """Robot arm whose joints a `Drive` moves.

    `with` opens and enables the arm. At the end of the block, also after an exception, the arm is
    lowered or left enabled, see `on_exit`, and the drive is closed. Only the process that switched
    torque on may use the arm: in a forked process, `close` does nothing, and `read` and `write`
    raise an error.

    Args:
        model: The robot; its joint names are matched with the drive's.
        drive: Interface to the servos or the simulator.
        rest_q: Joint positions (n,) [rad] to which `lower` moves first, if the path is clear of the
            table; None: straight down.
        on_exit: Action of `close` and of the end of `with` if torque is on: `lower` or
            `leave_enabled`.
        rate: Rate of the arm's own loops in `enable` and `lower` [Hz]; `lower` runs at 20 Hz or
            more.
        comm_timeout: Time without positions or without commands after which a `Loop` raises [s],
            at most 60.
        power_budget: Thermal and supply limits; None: the default.
        grippers: Configurations of joints off the chain, by name; a joint that is not listed has
            the default `GripperConfig`.
        watchdog: Bus silence after which servos stop by themselves, if supported [s]; 0: never. A
            stopped servo takes its present position as goal, so that the joint sinks by
            ``g/k_p`` [rad], gravity torque over stiffness of the servo.
        handle_signals: True if SIGINT, SIGTERM, SIGHUP and SIGQUIT lower the arm.
        table: Height of the table in base axes [m]; None: no table, or its height is unknown.
        guardian: True: a separate process performs `on_exit` if the program is killed, crashes or
            hangs with torque on. It kills a program that hangs or is stopped. The drive must have
            servos that keep their torque without the program, as `ServoBus` has; other drives get
            no guardian.
        name: Name of the arm in messages; None: that of the model. `connect` sets it to the name of
            the built-in arm or of the file.

    Attributes:
        model: The robot, with the servo parameters of the drive.
        name: Name of the arm in messages.
        drive, rate, rest_q, comm_timeout, table: The arguments of the same names.
        detour: Reason why the last lowering skipped the rest pose or gave it up; None if it did
            not.
        servos: Servo parameters of the chain, n entries; updated when the drive opens. At torque on
            a `stiffness_known` that does not hold the arm becomes False, and a `kp` that is not
            known becomes the measured one, also in `model`.
        grippers: Grippers by joint name; created again when the drive opens.
        leads: Goal minus position that held each joint against gravity at torque on (n,) [rad]; NaN
            for a joint that rested on an object, and before the first torque on.
        load: Mass at the tool beyond the model's payload, measured at torque on [kg]; 0 where the
            stiffness of the servos is known.

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
        guardian: bool = True,
        name: str | None = None,
    ) -> None:
        """Match the drive's joints with the model's; open no port and move nothing."""
        if on_exit not in {"lower", "leave_enabled"}:
            raise ConfigError(f"on_exit must be 'lower' or 'leave_enabled', got {on_exit!r}")
        self.model, self.drive = model, drive
        self.name: str = model.name if name is None else instance(name, str, "name")
        self.rate, self.comm_timeout, self._watchdog = times(rate, comm_timeout, watchdog)
        self._on_exit = on_exit
        self._budget = (
            Budget() if power_budget is None else instance(power_budget, Budget, "power_budget")
        )
        self._gripper_configs = check_grippers(grippers)
        self._supervisor = Supervisor(self._take_down)
        self._signals = Signals(self._supervisor.abort.set) if handle_signals else None
        self._has_guardian = instance(guardian, bool, "guardian") and is_available(drive)
        self._guardian: Guardian | None = None
        #: True from the beginning of a descent or of torque off until torque is off or was left on
        #: deliberately. If one of them fails, it stays True, and the guardian takes the arm over.
        self._is_unfinished = False
        #: True while torque is on without control, at the user's request.
        self._is_left_on = False
        #: True from the time at which `close` left the arm to its guardian until the next `enable`.
        self._is_handed_over = False
        self._exit_message: str | None = None
        #: Threads that `close` waits for once torque is off.
        self._unfinished_threads: list[Thread] = []
        self._build()
        self.table = None if table is None else table_height(table)
        self.detour: str | None = None
        self.rest_q = None if rest_q is None else posture(self.model, rest_q, "rest_q")
        if self.rest_q is not None:
            check_rest(self.model, self._points, self.rest_q, self.table)
        self._opened = False
        self.leads: Array = np.full(model.n, np.nan)
        self.load = 0.0
        #: Joints that torque did not hold when it came on, as a text; None if there is none.
        self._doubt: str | None = None
        # Positions at which the leads were measured, and those that no object makes smaller; the
        # others are NaN (n,) [rad].
        self._leads_q: Array = np.zeros(model.n)
        self._free_leads = self.leads
        # Since torque on: payload of the first controller [kg], and controllers with the load.
        self._leads_mass: float | None = None
        self._loaded: list[object] = []

    def _build(self) -> None:
        """Create the parts that depend on servo parameters; `open` calls this again."""
        self._io = ArmIO(self.model, self.drive, self._budget)
        self.servos = self._io.servos
        # Replace the servo parameters of the model, which may differ from those of the drive.
        self.model = self.model.with_servos(self.servos)
        self._points = ArmPoints(self.model, self.servos.armature)
        self.grippers = make_grippers(
            self._io, self._gripper_configs, self._send_gripper, self._gripper_position
        )

    @property
    def enabled(self) -> bool:
        """True if torque is on and this process switched it on."""
        return self._supervisor.owner == os.getpid()

    def open(self) -> None:
        """Connect to the servos and identify them; torque stays as it is.

        Raises:
            ServoError: The servos cannot be reached or identified.
        """
        if not self._opened:
            self.drive.open()
            self._opened = True
            self._build()

    def enable(self) -> None:
        """Switch torque on at the present positions, and let the servos take up the weight.

        The first torque limits are close to the gravity torques. If k_p is unknown, or does not
        hold the arm as assumed, the goals then move until each joint stands still under the real
        load, and the lead (goal − q) that holds it is measured; this takes at most 7.7 s. Then the
        limits rise within 0.5 s. Joints with torque on keep their goals and limits, and an arm that
        lies on a table stays there. Signal handlers are installed before torque comes on.

        Raises:
            ServoTimeoutError: Joints do not answer; the message names them.
            ServoError: Before anything is sent: a joint reads outside its limits, its gravity
                torque is more than twice the usable torque of its servo, or the bus is too slow
                for `rate`. Afterwards: joints moved when torque came on, did not confirm, or lost
                their torque again, as a servo that restarts does; the others keep theirs then. Or
                a joint moved against its weight by more than 0.15 rad, as with a wrong sign; the
                arm is `enabled` then and holds with all torque.
        """
        with self._supervisor.exclusive():
            if not self.enabled:
                self._enable()

    def _enable(self) -> None:
        """Do the work of `enable`; the caller holds the supervisor's lock."""
        if self._has_guardian and (self._guardian is None or not self._guardian.is_ours):
            # The guardian imports its modules while the bus opens.
            self._guardian = Guardian(self._supervisor)
        self.open()
        self._supervisor.reason = None
        io = self._io
        duration = wait_for_all(io, self.rate)
        on = io.drive_mask("enabled")[io.joints.chain]
        # A joint that has torque already must be taken over, however slow the bus is.
        warning = check_reading_time(io, duration, self.rate, required=not on.any())
        check_within_limits(io, on)
        check_weight(io, on)
        start_q = io.q
        start, limit, lead, carried = initial_commands(io, on)
        for name, gripper in self.grippers.items():
            # A gripper with torque on may hold an object.
            io.orders[name] = io.stored_order(name) or (gripper.position, gripper.limit)
        MESSAGES.start()
        if warning is not None:
            MESSAGES.post(warning, logging.WARNING)
        former = self._is_unfinished, self._is_left_on
        try:
            if self._signals is not None:
                self._signals.install()
            # Register twice: a signal could end the first call before it defers signals.
            atexit.register(self._at_exit)
            atexit.register(self._at_exit)
            self._start_guardian()
            self._is_unfinished = self._is_left_on = self._is_handed_over = False
            # Until this method returns, accesses to the drive do not restart this timeout.
            self._supervisor.heartbeat[1] = ENABLE_TIME
            self._supervisor.owner = os.getpid()
            io.start(start, limit, lead)
        except ServoError:
            # Joints that had torque before keep it: the guardian, or the user, still owns them.
            self._is_unfinished, self._is_left_on = former
            self._release()
            raise
        except BaseException:
            # A signal came before torque on, so no descent will follow that removes the signal
            # handlers.
            if not self.enabled:
                self._is_unfinished, self._is_left_on = former
                self._release()
            raise
        try:
            self.leads = transfer_weight(io, self._points, start_q, carried, self.rate)
        finally:
            self._doubt = displacement(io, start_q)
        self._leads_q, self._leads_mass, self._loaded = io.q.copy(), None, []
        is_supported = may_lie_on(self.table, self._points, io.q)
        self.load = 0.0 if is_supported else io.load
        ratio = stiffness_ratio(io, self.leads, is_supported=is_supported)
        self._free_leads = np.where(np.isnan(ratio) & is_supported, np.nan, self.leads)
        if not io.servos.stiffness_known:
            # Without the balance, a load is not known, and looks like soft servos.
            self.servos = io.servos if carried.any() else measured_servos(io, ratio)
            self.model = self.model.with_servos(self.servos)
        # A sagging supply changes the leads as wrong servo parameters do: report only the sag.
        mismatch = io.watch_supply() or stiffness_mismatch(io, ratio)
        displaced = self._doubt and (
            f"{self._doubt}: signs or zeros are wrong (`pliant servos doctor ARM --watch`), "
            "a load is too heavy, or a hand pushed the arm"
        )
        light = None
        if self.table is not None and not is_supported:
            light = unloaded(io, self.leads)
            self._doubt = self._doubt or light
        for text in filter(None, (displaced, light, mismatch)):
            MESSAGES.post(text, logging.WARNING)
        if self.load > TOLD_LOAD:
            MESSAGES.post(
                f"{self.name} carries some {self.load * 1e3:.0f} g at its tool beyond its model, "
                "and loops count on it. Did a hand press it down? Then switch torque off and on"
            )
        self._set_watchdog()
        self._supervisor.heartbeat[1] = 0.0

    def _set_watchdog(self) -> None:
        """Set the servos' watchdog; a silence of the line shorter than `comm_timeout` is no error.

        Raises:
            ServoError: A servo did not confirm the new watchdog time.
        """
        end = self.clock.now() + self.comm_timeout
        while True:
            try:
                self._io.set_watchdog(self._watchdog)
            except ServoError:
                if self.clock.now() >= end:
                    raise
                self.clock.wait_until(self.clock.now() + 1.0 / self.rate)
            else:
                return

    def lower(self) -> None:
        """Move to the rest pose if set, descend at 0.15 m/s until the arm rests, switch torque off.

        If the table blocks the path to the rest pose, the arm descends from the present pose.

        Raises:
            ServoError: The bus is gone, or torque of a joint stayed on, or was left on before.
        """
        self._descend(self.rest_q)

    def park(self, pose: ArrayLike | None = None) -> None:
        """Move to a pose (n,) [rad], by default the rest pose, and lower the arm there.

        The path is straight in joint space. If the table blocks it, or the arm gets no closer to
        the pose, the arm is lowered from where it is instead, see `detour`.

        Raises:
            ConfigError, ShapeError, OutOfRangeError: The pose is not valid, or inside the table;
                nothing has moved.
            ServoError: The bus is gone, or torque of a joint stayed on, or was left on before.
        """
        target = self.rest_q
        if pose is not None:
            target = posture(self.model, pose, "pose")
            check_rest(self.model, self._points, target, self.table, name="pose")
        if target is None:
            raise ConfigError("no pose to park in: arm.park([...]) or connect(..., rest_q=[...])")
        self._descend(target)

    def leave_enabled(self) -> None:
        """Hold the present pose with torque on, also after the program ends.

        The servos may overheat, because the thermal budget no longer reduces their limits.
        `enable` takes the arm over again; `lower` and `park` need that.
        """
        with self._supervisor.exclusive():
            if self.enabled:
                hold_position(self._io)
                self._is_left_on = True
                self._exit_message = self._exit_messages(exit_cause(sys.exception())).left_enabled()
                self._release()

    def disable_torque(self) -> None:
        """Switch torque off in the present pose: the arm falls.

        After an error or an interruption, the guardian lowers the arm as after a failed descent.

        Raises:
            ServoError: Torque of a joint stayed on, or servos do not answer; the others are off.
        """
        with self._supervisor.exclusive(at_once=True):
            self._is_unfinished |= self.enabled
            try:
                self.drive.disable(self._io.joints.names)
                self._is_unfinished = self._is_left_on = False
            finally:
                self._release()

    def close(self) -> None:
        """Lower the arm or leave it enabled, see `on_exit`, and close the drive.

        Do nothing if another process switched torque on.
        """
        try:
            self._close()
        except (KeyboardInterrupt, SystemExit):
            # A signal came before `_close` deferred signals: torque is still on.
            if self.enabled:
                self._close()
            raise

    def _close(self) -> None:
        """Lower the arm or leave it enabled, close the drive, then deliver stored signals.

        If a signal raises before signals are deferred, torque is still on, and `close` retries.
        """
        if self._supervisor.is_owned_elsewhere:
            return
        if self._signals is not None:
            self._signals.hold()
        try:
            if self.enabled:
                self.lower() if self._on_exit == "lower" else self.leave_enabled()
        finally:
            self._release()
            if self._opened:
                self._opened = False
                self.drive.close()
                if self._guardian is None:  # a guardian asks these joints again
                    self._report_unrestored(self._exit_messages(None), is_off=False)
            if self._guardian is not None:
                self._guardian.close(hand_over=self._is_unfinished)
                self._is_handed_over = self._is_unfinished
                self._guardian, self._is_unfinished = None, False
            MESSAGES.flush()
            if self._signals is not None:
                self._signals.deliver()
        while self._unfinished_threads:
            self._unfinished_threads.pop().join()

    def _finish_later(self, thread: Thread) -> None:
        """Make `close` wait for this thread after torque off: `Loop` closes its recorder in it."""
        self._unfinished_threads.append(thread)

    def _descend(self, rest: Array | None) -> None:
        """Lower the arm via the pose `rest` (n,) [rad], or straight down if it is None.

        A second Ctrl-C aborts the descent; torque then stays on.
        """
        if not self.enabled:
            if self._is_unfinished or self._is_left_on:
                raise self._torque_error()
            return
        error, signals = sys.exception(), self._signals
        messages = self._exit_messages(self._supervisor.reason or exit_cause(error))
        interrupted = is_interrupted(error)
        if not self._supervisor.is_leaving:
            announcement = messages.begin(interrupted=interrupted)
        elif interrupted:
            announcement = messages.begin_again()
        else:
            announcement = None
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
        """Descend and switch torque off; if the descent is aborted, hold the present pose."""
        down = False
        supervisor = self._supervisor
        self._is_unfinished = True
        # The descent accesses the drive in each cycle, without the supervisor's lock.
        supervisor.heartbeat[1] = self.comm_timeout

        def on_tick(lowering: Lowering) -> None:
            supervisor.beat()
            beat_all()
            messages.progress(lowering)
            messages.faults()

        def on_detour(reason: str) -> None:
            self.detour = reason
            MESSAGES.post(f"{reason}: the arm is lowered straight down")

        rest = self._reachable(rest)
        if self.detour is not None:
            on_detour(self.detour)
        try:
            down = descend(
                self._io,
                rest,
                self.rate,
                supervisor.abort.is_set,
                on_tick=on_tick,
                on_detour=on_detour,
            )
            # No timeout: torque off may be slow on a bad line.
            supervisor.heartbeat[1] = 0.0
            if down:
                with contextlib.suppress(ServoError):
                    self._io.set_watchdog(0.0)
                self.drive.disable(self._io.joints.names)
        except BaseException as error:
            # After an abort, SystemExit comes from a third Ctrl-C while a bus call hangs: make no
            # more bus calls.
            hangs = isinstance(error, SystemExit) and self._supervisor.abort.is_set()
            self._is_unfinished = not hangs
            if not down and not hangs:
                self._hold()
            # If the bus failed before the arm was down, its torque state is unknown.
            is_answering = isinstance(error, ServoFaultError)
            is_unknown = isinstance(error, ServoError) and not is_answering and not down
            self._exit_message = messages.failed(
                error,
                None if is_unknown else self._io.joints_where("enabled", default=True),
                self._io.joints_where("torque_unknown"),
                down=down,
                has_guardian=self._guardian is not None,
            )
            if down and self._guardian is None:  # a guardian restores them
                self._report_unrestored(messages)
            raise
        self._report_unrestored(messages)
        self._is_unfinished = False
        if down:
            has_signal = self._signals is not None and self._signals.has_pending
            self._exit_message = messages.lowered(has_signal=has_signal)
        else:
            self._hold()
            self._is_left_on = True
            self._exit_message = messages.left_enabled(stopped=True)

    def _report_unrestored(self, messages: ExitMessages, *, is_off: bool = True) -> None:
        """Name the joints that keep torque limits of this program, and whose torque is off.

        With `is_off` False, name those whose torque is unknown instead.
        """
        unknown = self._io.joints_where("torque_unknown")
        unrestored = self._io.joints_where("unrestored")
        if names := [name for name in unrestored if (name in unknown) != is_off]:
            messages.unrestored(names)

    def _hold(self) -> None:
        """Send goals and torque limits that hold the present pose; ignore all errors."""
        with contextlib.suppress(Exception):
            hold_position(self._io)

    @property
    def _ports(self) -> str:
        """Ports of a real arm in parentheses after a space, for messages; else an empty text."""
        is_real = getattr(self.drive, "outlives_program", False)
        ports = dict.fromkeys(s.port for s in getattr(self.drive, "specs", ()) if is_real)
        return f" ({', '.join(ports)})" if ports else ""

    @property
    def _label(self) -> str:
        """Name in messages, with the ports of a real arm."""
        return f"{self.name}{self._ports}"

    def _exit_messages(self, cause: str | None) -> ExitMessages:
        return ExitMessages(self.name, self._io, cause, ports=self._ports)

    def _reachable(self, rest: Array | None) -> Array | None:
        """Return `rest` if the path to it is safe; else set `detour`, and return None.

        The path is safe if it is clear of the table, and torque held all joints with their weights
        when it came on: otherwise a sign, a zero or an id may be wrong, and the real arm would take
        another path.
        """
        self.detour = None
        if rest is None:
            return None
        self.detour = self._doubt or path_obstacle(
            self.model, self._points, self._io.q, rest, self.table
        )
        return rest if self.detour is None else None

    def _start_guardian(self) -> None:
        """Start the guardian's watch over the program, if the arm has a guardian.

        Raises:
            ServoError: The guardian did not start; torque stays as it is.
        """
        if self._guardian is None:
            return
        arguments = {
            "model": self.model,
            "rest_q": self.rest_q,
            "on_exit": self._on_exit,
            "rate": self.rate,
            "comm_timeout": self.comm_timeout,
            "power_budget": self._budget,
            "grippers": self._gripper_configs,
            "table": self.table,
            "name": self.name,
        }
        self._guardian.watch(self.drive, arguments)

    def _resume(self, cause: str) -> None:
        """Lower the arm of an ended program, or leave it enabled; the guardian calls this.

        If no joint has torque, only restore the registers that the program changed.

        Args:
            cause: Reason for taking the arm over, for messages.

        Raises:
            ServoError: The ports cannot be opened, or the arm was not lowered.
        """
        if not self._io.resume(self.rate):
            self.drive.disable(self._io.joints.names)
            return
        self._supervisor.owner, self._supervisor.reason = os.getpid(), cause
        self._take_down(abort=f"`kill -9 {os.getpid()}` leaves")

    def _take_down(self, abort: str | None = None) -> None:
        """Lower the arm or leave it enabled, after the program stalled or ended.

        The watchdog thread or the guardian calls this method. `abort` is the beginning of the
        message on how to abort the descent; None: by Ctrl-C.
        """
        try:
            if not self.enabled:
                return
            messages = self._exit_messages(self._supervisor.reason)
            if self._on_exit == "lower":
                messages.begin(abort=abort)
                self._run_descent(self.rest_q, messages)
            else:
                hold_position(self._io)
                self._is_left_on = True
                self._exit_message = messages.left_enabled()
        finally:
            self._supervisor.owner = None
            self._rest_guardian()

    def _rest_guardian(self) -> None:
        """Tell the guardian that torque is off or was left on deliberately.

        After a failed descent, the guardian continues to watch.
        """
        if self._is_unfinished:
            return
        self._supervisor.heartbeat[1] = 0.0
        if self._guardian is not None:
            self._guardian.rest()

    def _release(self) -> None:
        """End this process's control of the arm: stop watchdogs and signal handling."""
        self._supervisor.owner = None
        self._supervisor.end_supervision()
        self._rest_guardian()
        atexit.unregister(self._at_exit)
        if self._signals is not None:
            self._signals.restore()

    def _at_exit(self) -> None:
        """Close the arm when the interpreter exits with torque on."""
        if not self._supervisor.is_owned_elsewhere:
            self._supervisor.reason = self._supervisor.reason or "the program ends"
        self.close()

    def __repr__(self) -> str:
        """Return name, number of joints and whether the arm is enabled in one line."""
        state = "" if self.enabled else "not "
        return f"<Arm {self.name}, {self.model.n} joints, {state}enabled>"

    def __reduce__(self) -> NoReturn:
        """Refuse to copy and to pickle: two objects would control the same servos.

        Raises:
            TypeError: Always.
        """
        raise TypeError(
            "an Arm cannot be copied or pickled, because only one process and object may drive its "
            "servos: connect in the process that moves the arm, and send positions and goals to "
            "the others; its model, its servo parameters and a Controller can be pickled"
        )

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
            # `error` is the cause: let it propagate, with the error of the descent as a note.
            error.add_note(f"while the arm was being lowered: {worse}")
        else:
            if error is not None and self._exit_message is not None:
                # Repeat the exit message as a note: Python prints the traceback last, the note
                # below it.
                error.add_note(f"pliant: {self._exit_message}")
        finally:
            if isinstance(error, KeyboardInterrupt):
                _end_at_the_caller(error)

    def read(self) -> State:
        """Read all joints and return their state.

        A joint without a reply, or with an implausible position, keeps its last position, and the
        age of that position grows: see `State.fresh` and `State.age`.

        Raises:
            ServoTimeoutError: The program stalled for too long, and the arm was lowered meanwhile.
            ServoError: The connection is gone, or another process switched torque on.
        """
        with self._supervisor:
            return self._io.read()

    def write(
        self,
        goal: ArrayLike,
        limit: ArrayLike | None = None,
        extra: Mapping[str, tuple[float, float]] | None = None,
        *,
        lead: bool = False,
        velocity: ArrayLike | None = None,
    ) -> None:
        """Send goals and torque limits, bounded by position limits and by the power budget.

        Low limits are sent unchanged: with limits below the gravity torques the arm sinks, with 0
        it falls. A `RuntimeWarning` is issued once if a limit stays below half of the gravity
        torque for 0.2 s, except for commands of a `Controller`.

        Args:
            goal: Joint goals (n,) [rad]. They are clipped to the position limits, extended by the
                lead (goal minus position) that the gravity torque needs.
            limit: Torque limits (n,) [N·m]; None keeps the last limits.
            extra: Goal [rad] and limit [N·m] of joints off the chain by name; joints that are not
                listed keep their last values.
            lead: True if goals may lie beyond the position limits to exert a force. `Tick.write`
                sets it for commands of a `Controller`, which keeps joints within their range.
            velocity: Largest velocity (n,) [rad/s] toward the goals, for the servos' speed
                registers; None or inf: no speed limit.

        Raises:
            ShapeError, OutOfRangeError, ConfigError, TypeError: Invalid argument; nothing was sent.
            ServoTimeoutError: The program stalled for too long, and the arm was lowered meanwhile.
            ServoError: Torque is off, or was switched on by another process, or the connection is
                gone.
        """
        with self._supervisor:
            if self._supervisor.owner is None:
                raise self._torque_error()
            self._io.write(goal, limit, extra, lead=lead, velocity=velocity)

    def supervised(self, patience: float) -> AbstractContextManager[Callable[[], None]]:
        """Return a context with a watchdog thread that lowers the arm if the program stalls.

        The thread performs `on_exit` after `patience` [s] without a read or write. With
        ``patience=math.inf`` the program may stall for any time: there is no such thread, and the
        guardian detects no hang. In simulated time there is none either. The context yields a
        function that raises `ServoTimeoutError` after the thread has performed `on_exit`. `Loop`
        uses this context.

        Raises:
            ConfigError: `patience` is not a number above 0.
        """
        seconds = real(patience, "patience")
        if not seconds > 0.0:
            raise ConfigError(f"patience must be above 0 s, got {patience!r}")
        has_thread = getattr(self.clock, "real_time", False) and seconds < math.inf
        return self._supervisor.supervised(seconds if has_thread else None)

    def ramp_limits(self) -> None:
        """Limit torque for 0.5 s by a ramp from holding torques to usable torques.

        A holding torque keeps a joint in its pose. `Loop` calls this method after missed cycles,
        because goals may then be far from the present positions.
        """
        self._io.ramp_limits()

    @property
    def gripper(self) -> Gripper:
        """The gripper, if it is the only joint off the chain.

        Raises:
            ConfigError: There is no joint off the chain, or there are several: use `grippers`.
        """
        if len(self.grippers) != 1:
            there = ", ".join(self.grippers) or "none"
            raise ConfigError(f"arm.gripper needs one joint off the chain; there are: {there}")
        return next(iter(self.grippers.values()))

    @property
    def clock(self) -> Clock:
        """Clock of the drive: real time, or the simulated time of a simulator."""
        return self._io.clock

    @property
    def heat(self) -> dict[str, float]:
        """Used share of the thermal budget by joint name; above 0.8 torque limits are reduced."""
        return dict(zip(self._io.joints.names, self._io.thermal.heat.tolist(), strict=True))

    @property
    def counters(self) -> dict[str, int]:
        """Event counters of the drive by name, and `jumps`, the number of implausible positions."""
        return {**self.drive.counters, "jumps": self._io.positions.jumps}

    def _send_gripper(self, name: str, goal: float, limit: float) -> None:
        """Send goal [rad] and torque limit [N·m] of a joint off the chain.

        The last goals and limits of the chain's joints are sent again.
        """
        with self._supervisor:
            if self._supervisor.owner is None:
                raise self._torque_error()
            self._io.orders[name] = (goal, limit)
            self._io.send(self._io.goal, self._io.limit)

    def _gripper_position(self, name: str) -> float:
        """Return the last measured position [rad] of a joint off the chain."""
        io = self._io
        return float(io.positions.position[io.joints.index(name)])

    def _check_usable(self) -> None:
        """Raise the error of `write` if this process may not write, or if torque is off."""
        with self._supervisor:
            if self._supervisor.owner is None:
                raise self._torque_error()

    def _torque_error(self) -> ServoError:
        """Return the error for a use of the arm while no process controls it: state and remedy."""
        if self._is_unfinished:
            guardian = ", arm.close() leaves it to its guardian" if self._guardian else ""
            unknown = self._io.joints_where("torque_unknown")
            on = [
                name
                for name in self._io.joints_where("enabled", default=True)
                if name not in unknown
            ]
            states = [f"ON in {', '.join(on)}"] if on else []
            states += [f"not known in {', '.join(unknown)}"] if unknown else []
            return ServoError(
                "the last descent or torque off failed; at the last replies torque was "
                f"{', '.join(states) or 'off'}: arm.enable() takes the arm over{guardian}"
            )
        if self._is_handed_over:
            return ServoError(
                "the last descent or torque off failed, and the arm's guardian lowers it: "
                "arm.enable() takes it over once the guardian has released the port"
            )
        if self._is_left_on:
            return ServoError(
                "torque was left ON: arm.enable() takes the arm over, then arm.lower() lowers it; "
                "arm.disable_torque() lets it fall"
            )
        return ServoError(TORQUE_OFF)


def _end_at_the_caller(error: KeyboardInterrupt) -> None:
    """Remove frames of this package from the traceback of a Ctrl-C."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        module = trace.tb_next.tb_frame.f_globals.get("__name__", "")
        if module.partition(".")[0] == "pliant":
            trace.tb_next = None
        trace = trace.tb_next
