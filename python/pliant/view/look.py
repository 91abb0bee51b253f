"""What the page is told of an arm: after steps of its controller, and while there are none."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Literal

import numpy as np

import pliant
from pliant.view.link import PageGone
from pliant.view.snapshot import Felt, Health, Shown, Snapshot, Step

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant import Command, Controller
    from pliant.arm import Arm
    from pliant.loop import Loop, Tick
    from pliant.view.body import Body
    from pliant.view.hand import VisitorHand
    from pliant.view.link import Link
    from pliant.view.pace import Pace
    from pliant.view.snapshot import Phase
    from pliant.view.tap import Tap

    Array = NDArray[np.float64]

#: Cause of a message: a refused order of one kind, or what ended the arm's life.
Cause = Literal["target", "hand", "settings", "fault"]
#: How often the report is made anew [s].
REPORT = 1.0
#: How long a refused order stays on the page, where nothing takes it away before [s].
REFUSED = 12.0


class Look:
    """Gathers snapshots of one arm after the other and sends those that are wanted.

    Attributes:
        phase: Of the arm's life.
        said: How many errors and news there were, the last, and whether it is an error.
        edit: Number of the last edit that was dealt with.
        shown: The settings in force; None before the first.
        hand: The visitor's, on a simulated arm.
    """

    def __init__(self, link: Link, rate: float) -> None:
        """There is no arm yet."""
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
        """Look at a new life of the arm from now on."""
        self._arm, self._body, self._tap, self._pace = arm, body, tap, pace
        self._step: Step | None = None
        self._contact: pliant.ContactEstimator | None = None
        self.phase, self.hand = "starting", None

    def say(self, text: str, cause: Cause) -> None:
        """Show an error on the page until its cause is gone."""
        if (text, cause) != (self.said[1], self._cause):
            self.said = (self.said[0] + 1, text, True)
        self._cause, self._said_at = cause, time.perf_counter()

    def settle(self, *causes: Cause) -> None:
        """Take the error away if it has one of these causes."""
        if self._cause in causes:
            self.said, self._cause = (self.said[0] + 1, "", False), None

    def forget_report(self) -> None:
        """Make it anew: settings have changed."""
        self._report: tuple[float, tuple[str, ...]] = (-np.inf, ())

    # With a controller.

    def feel(self, controller: Controller) -> None:
        """Estimate, from now on, what pushes at the tool of this controller's arm."""
        self._contact, self._restarts = pliant.ContactEstimator(controller), -1

    def before_step(self, tick: Tick, loop: Loop) -> None:
        """Take the reading of a tick; what was felt before a restart is void."""
        if self._contact is None:
            return
        if self._restarts != loop.restarts:
            self._restarts = loop.restarts
            self._contact.reset()
        self._contact.update(tick.q, dt=tick.dt)

    def after_step(
        self, tick: Tick, controller: Controller, command: Command, target: Array, loop: Loop
    ) -> None:
        """Show a tick, where the page wants one; the report once a second."""
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
        """Of the loop; where simulated time is paced, of that."""
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

    # Without one.

    def on_read(self) -> None:
        """After every reading: simulated time waits for life; the page sees the arm come down."""
        if self._pace is not None:
            self._pace.wait()
        if self.phase == "lowering":
            # Whoever looks on, the arm comes down.
            with contextlib.suppress(PageGone):
                self.still()

    def still(self) -> None:
        """Show where the arm is without a step of the controller, where the page wants to know."""
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
