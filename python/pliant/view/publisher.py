"""`Publisher`: sends snapshots of the arm to the browser page, also while no controller runs."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pliant._core import ContactEstimator
from pliant.view.ipc import PageGone
from pliant.view.snapshot import ForceEstimate, LoopTiming, Notice, SettingsView, Snapshot, Step

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


#: Cause of an error on the page: a rejected message about target, hand or settings, or the error
#: that ended a run (`fault`).
Cause = Literal["target", "hand", "settings", "fault"]
#: Time between two reports on the forces that the arm can exert in its pose [s].
REPORT_PERIOD = 1.0
#: Time for which an error about a rejected message is shown [s].
MAX_NOTICE_TIME = 12.0


class DriveObserver:
    """Wrapper of a drive that keeps the last reading and calls a function after each reading.

    `Arm` also reads through this wrapper while it lowers the arm and no controller runs.

    Attributes:
        last: The last reading; None before the first reading.
        on_read: Function that is called after each reading.
    """

    def __init__(self, drive: Drive) -> None:
        """Wrap a drive; attributes that this class does not define are those of the drive."""
        self._drive = drive
        self.last: JointReadings | None = None
        self.on_read: Callable[[], object] = lambda: None

    def read(self) -> JointReadings:
        """Read the joints, keep the reading, call `on_read`, and return the reading."""
        self.last = self._drive.read()
        self.on_read()
        return self.last

    def __getattr__(self, name: str) -> Any:
        return getattr(self._drive, name)


class Publisher:
    """Sends snapshots (states of the arm) to the browser page, at a bounded rate.

    Attributes:
        phase: Phase of the run: `starting`, `running`, `lowering` or `down`.
        notice: Message to the user.
        edit: Number of the last change of the settings that was handled.
        shown: The settings in force; None before the first run.
        hand: Force of the user on a simulated arm; None on a real arm.
    """

    def __init__(self, link: Link, rate: float) -> None:
        """Create a publisher without an arm; `rate` is the control rate [Hz]."""
        self._link, self._loop_timing = link, LoopTiming(rate=rate)
        self.phase: Phase = "starting"
        self.notice = Notice()
        self._cause: Cause | None = None
        self._notice_time = -np.inf
        self.edit, self.shown = 0, None
        self.hand: MouseForce | None = None
        self.request_report()

    shown: SettingsView | None

    def observe(
        self, arm: Arm, robot: RobotView, observer: DriveObserver, pacer: RealtimePacer | None
    ) -> None:
        """Start a new run, whose snapshots show `arm`.

        Args:
            arm: The arm of the run.
            robot: Data to draw the arm.
            observer: Wrapper of the arm's drive, which keeps the last reading.
            pacer: Object that keeps a simulation in real time; None: no pacing.
        """
        self._arm, self._robot, self._observer, self._pacer = arm, robot, observer, pacer
        self._step: Step | None = None
        self._contact: ContactEstimator | None = None
        self.phase, self.hand = "starting", None

    def show_error(self, text: str, cause: Cause) -> None:
        """Show an error until `clear_error`; a rejected message at most for `MAX_NOTICE_TIME`."""
        if (text, cause) != (self.notice.text, self._cause):
            self.notice = Notice(self.notice.number + 1, text, is_error=True)
        self._cause, self._notice_time = cause, time.perf_counter()

    def clear_error(self, *causes: Cause) -> None:
        """Remove the shown error if its cause is one of `causes`."""
        if self._cause in causes:
            self.notice, self._cause = Notice(self.notice.number + 1), None

    def request_report(self) -> None:
        """Mark the report on forces as outdated: the next snapshot gets a new one."""
        self._report: tuple[float, tuple[str, ...]] = (-np.inf, ())

    # Methods for a run with a controller.

    def estimate_contact(self, controller: Controller) -> None:
        """Start to estimate the force on the tool, from the steps of a new controller."""
        self._contact, self._restarts = ContactEstimator(controller), -1

    def before_step(self, tick: Tick, loop: Loop) -> None:
        """Update the estimate of the force on the tool; reset it if the loop had a gap."""
        if self._contact is None:
            return
        if self._restarts != loop.restarts:
            self._restarts = loop.restarts
            self._contact.reset()
        self._contact.update(tick.q, dt=tick.dt)

    def after_step(
        self, tick: Tick, controller: Controller, command: Command, target: Array, loop: Loop
    ) -> None:
        """Send a snapshot of a tick, if the page is ready for one.

        The report on forces in the present pose is computed again every `REPORT_PERIOD`.
        """
        if not self._link.due():
            return
        now = time.perf_counter()
        if now - self._report[0] > REPORT_PERIOD:
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
        self._loop_timing = self._measure_timing(loop)
        self._link.send(self._snapshot(tick.q, dict(tick.state.extra), tick.began))

    def _measure_timing(self, loop: Loop) -> LoopTiming:
        """Return the timing of the loop; with a pacer, lateness is measured against real time."""
        lateness = loop.lateness if self._pacer is None else self._pacer.lateness
        return LoopTiming(
            rate=1.0 / loop.period,
            ticks=len(lateness),
            p50=lateness.percentile(50.0),
            p99=lateness.percentile(99.0),
            largest=lateness.largest,
            missed=loop.missed,
            missing=loop.missing,
            rejected=loop.rejected,
            restarts=loop.restarts,
            delay=loop.delay,
            speed=1.0 if self._pacer is None else self._pacer.speed,
        )

    # Methods that need no controller.

    def on_read(self) -> None:
        """Handle a new reading: pace a simulation; during a descent, send a snapshot."""
        if self._pacer is not None:
            self._pacer.wait()
        if self.phase == "lowering":
            # Ignore the end of the page's process: the descent of the arm must be completed.
            with contextlib.suppress(PageGone):
                self.publish_reading()

    def publish_reading(self) -> None:
        """While no controller runs, send a snapshot of the last reading if the page is ready."""
        last, names = self._observer.last, self._arm.drive.names
        if last is None or not self._link.due():
            return
        by_name = dict(zip(names, np.asarray(last.position).tolist(), strict=True))
        q = np.array([by_name.pop(name) for name in self._arm.model.joint_names])
        self._link.send(self._snapshot(q, by_name, self._arm.clock.now()))

    def _snapshot(self, q: Array, extra: dict[str, float], now: float) -> Snapshot:
        if time.perf_counter() - self._notice_time > MAX_NOTICE_TIME:
            self.clear_error("target", "hand", "settings")
        running = self.phase == "running"
        tool = np.asarray(self._arm.model.forward_kinematics(q))
        contact_force = None
        if running and self._contact is not None:
            estimate = self._contact.estimate
            contact_force = ForceEstimate(
                force=estimate.force_base, bound=estimate.uncertainty_base
            )
        hand_force = None
        if self.hand is not None:
            hand_force = self.hand.applied
        elif contact_force is not None:
            hand_force = tool[:3, 3], contact_force.significant_force
        return Snapshot(
            time=now,
            phase=self.phase,
            qpos=self._robot.qpos(q, extra),
            mocap=self._robot.mocap(),
            tool=tool,
            step=self._step if running else None,
            hand_force=hand_force,
            contact_force=contact_force,
            health=self._loop_timing,
            report=self._report[1],
            notice=self.notice,
            edit=self.edit,
            shown=self.shown,
        )
