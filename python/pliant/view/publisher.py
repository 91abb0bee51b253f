"""Snapshots for the page, with and without steps of a controller."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pliant._core import ContactEstimator
from pliant.view.ipc import PageGone
from pliant.view.snapshot import ForceEstimate, LoopTiming, SettingsView, Snapshot, Step

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant._core import Command, Controller
    from pliant._typing import Array
    from pliant.arm import Arm
    from pliant.drive import Drive, JointReadings
    from pliant.loop import Loop, Tick
    from pliant.view.ipc import Link
    from pliant.view.mouse_force import MouseForce
    from pliant.view.robot_view import RobotView
    from pliant.view.snapshot import Phase
    from pliant.view.source import RealtimePacer


#: Cause of an error: a refused message of one kind, or the error that ended a run.
Cause = Literal["target", "hand", "settings", "fault"]
#: Period of the report [s].
REPORT = 1.0
#: Longest display time of a refused message [s].
REFUSED = 12.0


class DriveObserver:
    """Wraps a drive and keeps its last reading, also during the descent.

    Attributes:
        last: The last reading; None before the first.
        on_read: Called after every reading.
    """

    def __init__(self, drive: Drive) -> None:
        """Wrap a drive."""
        self._drive = drive
        self.last: JointReadings | None = None
        self.on_read: Callable[[], object] = lambda: None

    def read(self) -> JointReadings:
        """Read the positions of this cycle."""
        self.last = self._drive.read()
        self.on_read()
        return self.last

    def __getattr__(self, name: str) -> Any:
        return getattr(self._drive, name)


class Publisher:
    """Collects snapshots of successive arms and sends them when due.

    Attributes:
        phase: Phase of the arm's life.
        notice: Number of errors and messages so far, the last one, and True if it is an error.
        edit: Number of the last processed edit.
        shown: The settings in force; None before the first.
        hand: The visitor's hand, on a simulated arm.
    """

    def __init__(self, link: Link, rate: float) -> None:
        """Start without an arm."""
        self._link, self._health = link, LoopTiming(rate=rate)
        self.phase: Phase = "starting"
        self.notice: tuple[int, str, bool] = (0, "", False)
        self._cause: Cause | None = None
        self._notice_time = -np.inf
        self.edit, self.shown = 0, None
        self.hand: MouseForce | None = None
        self.request_report()

    shown: SettingsView | None

    def observe(
        self, arm: Arm, robot: RobotView, observer: DriveObserver, pacer: RealtimePacer | None
    ) -> None:
        """Publish the state of a new arm from now on."""
        self._arm, self._robot, self._observer, self._pacer = arm, robot, observer, pacer
        self._step: Step | None = None
        self._contact: ContactEstimator | None = None
        self.phase, self.hand = "starting", None

    def show_error(self, text: str, cause: Cause) -> None:
        """Show an error on the page until its cause is gone."""
        if (text, cause) != (self.notice[1], self._cause):
            self.notice = (self.notice[0] + 1, text, True)
        self._cause, self._notice_time = cause, time.perf_counter()

    def clear_error(self, *causes: Cause) -> None:
        """Remove the error if it has one of these causes."""
        if self._cause in causes:
            self.notice, self._cause = (self.notice[0] + 1, "", False), None

    def request_report(self) -> None:
        """Request a new report after a change of settings."""
        self._report: tuple[float, tuple[str, ...]] = (-np.inf, ())

    # With a controller.

    def estimate_contact(self, controller: Controller) -> None:
        """Start to estimate the force at the tool for this controller."""
        self._contact, self._restarts = ContactEstimator(controller), -1

    def before_step(self, tick: Tick, loop: Loop) -> None:
        """Update the contact estimate with a tick; reset it after a restart."""
        if self._contact is None:
            return
        if self._restarts != loop.restarts:
            self._restarts = loop.restarts
            self._contact.reset()
        self._contact.update(tick.q, dt=tick.dt)

    def after_step(
        self, tick: Tick, controller: Controller, command: Command, target: Array, loop: Loop
    ) -> None:
        """Send a snapshot of a tick if due; renew the report once a second."""
        if not self._link.due():
            return
        now = time.perf_counter()
        if now - self._report[0] > REPORT:
            self._report = (now, tuple(controller.report().summary()))
        last = controller.diagnostics
        self._step = Step(
            target=target,
            reference=last.reference,
            deviation=last.deviation,
            compliance=last.compliance,
            softness=last.softness,
            strength=last.axis_strength,
            wrench=last.wrench,
            activation=last.activation,
            limit=command.torque_limit,
            saturated=last.saturated,
            locked=last.locked,
        )
        self._health = self._punctuality(loop)
        self._link.send(self._snapshot(tick.q, dict(tick.state.extra), tick.began))

    def _punctuality(self, loop: Loop) -> LoopTiming:
        """Return the timing of the loop, or of the paced simulation."""
        late = loop.lateness if self._pacer is None else self._pacer.lateness
        return LoopTiming(
            rate=1.0 / loop.period,
            ticks=len(late),
            p50=late.percentile(50.0),
            p99=late.percentile(99.0),
            largest=late.largest,
            missed=loop.missed,
            stale=loop.missing,
            refused=loop.rejected,
            restarts=loop.restarts,
            delay=loop.delay,
            speed=1.0 if self._pacer is None else self._pacer.speed,
        )

    # Without a controller.

    def on_read(self) -> None:
        """Handle every reading: pace simulated time, and show the descent."""
        if self._pacer is not None:
            self._pacer.wait()
        if self.phase == "lowering":
            # The descent continues without the page.
            with contextlib.suppress(PageGone):
                self.publish_reading()

    def publish_reading(self) -> None:
        """Send a snapshot without a controller step, if due."""
        last, names = self._observer.last, self._arm.drive.names
        if last is None or not self._link.due():
            return
        by_name = dict(zip(names, np.asarray(last.position).tolist(), strict=True))
        q = np.array([by_name.pop(name) for name in self._arm.model.joint_names])
        self._link.send(self._snapshot(q, by_name, self._arm.clock.now()))

    def _snapshot(self, q: Array, extra: dict[str, float], now: float) -> Snapshot:
        if time.perf_counter() - self._notice_time > REFUSED:
            self.clear_error("target", "hand", "settings")
        running = self.phase == "running"
        tool = np.asarray(self._arm.model.forward_kinematics(q))
        felt = None
        if running and self._contact is not None:
            estimate = self._contact.estimate
            felt = ForceEstimate(force=estimate.force_base, bound=estimate.uncertainty_base)
        pull = None
        if self.hand is not None:
            pull = self.hand.felt
        elif felt is not None:
            pull = tool[:3, 3], felt.significant_force
        return Snapshot(
            time=now,
            phase=self.phase,
            qpos=self._robot.pose(q, extra),
            mocap=self._robot.mocap(),
            tool=tool,
            step=self._step if running else None,
            pull=pull,
            felt=felt,
            health=self._health,
            report=self._report[1],
            notice=self.notice,
            edit=self.edit,
            shown=self.shown,
        )
