"""Snapshots for the page, with and without steps of a controller."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ContactEstimator
from pliant.view.link import PageGone
from pliant.view.snapshot import Felt, Health, Shown, Snapshot, Step

if TYPE_CHECKING:
    from pliant._core import Command, Controller
    from pliant._typing import Array
    from pliant.arm import Arm
    from pliant.loop import Loop, Tick
    from pliant.view.body import Body
    from pliant.view.hand import VisitorHand
    from pliant.view.link import Link
    from pliant.view.pace import Pace
    from pliant.view.snapshot import Phase
    from pliant.view.tap import Tap


#: Cause of a message: a refused order of one kind, or the error that ended a run.
Cause = Literal["target", "hand", "settings", "fault"]
#: Period of the report [s].
REPORT = 1.0
#: Longest display time of a refused order [s].
REFUSED = 12.0


class Look:
    """Collects snapshots of successive arms and sends them when due.

    Attributes:
        phase: Phase of the arm's life.
        said: Number of errors and messages so far, the last one, and True if it is an error.
        edit: Number of the last processed edit.
        shown: The settings in force; None before the first.
        hand: The visitor's hand, on a simulated arm.
    """

    def __init__(self, link: Link, rate: float) -> None:
        """Start without an arm."""
        self._link, self._health = link, Health(rate=rate)
        self.phase: Phase = "starting"
        self.said: tuple[int, str, bool] = (0, "", False)
        self._cause: Cause | None = None
        self._said_at = -np.inf
        self.edit, self.shown = 0, None
        self.hand: VisitorHand | None = None
        self.forget_report()

    shown: Shown | None

    def at(self, arm: Arm, body: Body, tap: Tap, pace: Pace | None) -> None:
        """Observe a new arm from now on."""
        self._arm, self._body, self._tap, self._pace = arm, body, tap, pace
        self._step: Step | None = None
        self._contact: ContactEstimator | None = None
        self.phase, self.hand = "starting", None

    def say(self, text: str, cause: Cause) -> None:
        """Show an error on the page until its cause is gone."""
        if (text, cause) != (self.said[1], self._cause):
            self.said = (self.said[0] + 1, text, True)
        self._cause, self._said_at = cause, time.perf_counter()

    def settle(self, *causes: Cause) -> None:
        """Remove the error if it has one of these causes."""
        if self._cause in causes:
            self.said, self._cause = (self.said[0] + 1, "", False), None

    def forget_report(self) -> None:
        """Request a new report after a change of settings."""
        self._report: tuple[float, tuple[str, ...]] = (-np.inf, ())

    # With a controller.

    def feel(self, controller: Controller) -> None:
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

    def _punctuality(self, loop: Loop) -> Health:
        """Return the timing of the loop, or of the paced simulation."""
        late = loop.lateness if self._pace is None else self._pace.lateness
        return Health(
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
            speed=1.0 if self._pace is None else self._pace.speed,
        )

    # Without a controller.

    def on_read(self) -> None:
        """Handle every reading: pace simulated time, and show the descent."""
        if self._pace is not None:
            self._pace.wait()
        if self.phase == "lowering":
            # The descent continues without the page.
            with contextlib.suppress(PageGone):
                self.still()

    def still(self) -> None:
        """Send a snapshot without a controller step, if due."""
        last, names = self._tap.last, self._arm.drive.names
        if last is None or not self._link.due():
            return
        by_name = dict(zip(names, np.asarray(last.position).tolist(), strict=True))
        q = np.array([by_name.pop(name) for name in self._arm.model.joint_names])
        self._link.send(self._snapshot(q, by_name, self._arm.clock.now()))

    def _snapshot(self, q: Array, extra: dict[str, float], now: float) -> Snapshot:
        if time.perf_counter() - self._said_at > REFUSED:
            self.settle("target", "hand", "settings")
        running = self.phase == "running"
        tool = np.asarray(self._arm.model.forward_kinematics(q))
        felt = None
        if running and self._contact is not None:
            estimate = self._contact.estimate
            felt = Felt(force=estimate.force_base, bound=estimate.uncertainty_base)
        pull = None
        if self.hand is not None:
            pull = self.hand.felt
        elif felt is not None:
            pull = tool[:3, 3], felt.certain
        return Snapshot(
            time=now,
            phase=self.phase,
            qpos=self._body.pose(q, extra),
            mocap=self._body.mocap(),
            tool=tool,
            step=self._step if running else None,
            pull=pull,
            felt=felt,
            health=self._health,
            report=self._report[1],
            said=self.said,
            edit=self.edit,
            shown=self.shown,
        )
