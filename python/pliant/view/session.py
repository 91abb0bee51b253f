"""The loop behind a page: one arm, its controller, and the orders that come in between ticks."""

from __future__ import annotations

import contextlib
import itertools
import time
from typing import TYPE_CHECKING, Literal

import numpy as np

import pliant
from pliant import PliantError, ServoError
from pliant.loop import Loop
from pliant.view import orders, scenes
from pliant.view.body import Body
from pliant.view.desk import Desk
from pliant.view.hand import VisitorHand
from pliant.view.link import PageGone
from pliant.view.pace import Pace
from pliant.view.snapshot import Health, Shown, Snapshot, Stage, Step
from pliant.view.tap import Tap

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from pliant import Command, Controller
    from pliant.arm import Arm
    from pliant.log import Recorder
    from pliant.loop import Tick
    from pliant.view.link import Link
    from pliant.view.snapshot import Phase
    from pliant.view.source import Source

    Array = NDArray[np.float64]
    Next = Literal["stop", "start", "scene"]

#: How often the report is made anew [s].
REPORT = 1.0
#: How often orders are looked for while no loop runs [s].
IDLE = 0.03
#: Share of `hold` with which a visitor may push.
STRONG = 1.0


class Session:
    """Runs an arm for a page.

    Args:
        source: Where arms come from.
        link: The page.
        log: MCAP file to write; of later lives of the arm `-2`, `-3`, ... are added to its name.

    Attributes:
        phase: Of the arm's life.
        desk: The settings.
        target: Pose (4, 4) that the controller gets.
        loop: The loop of this life, or the last.
        said: How many errors and news there were, the last, and whether it is an error.
    """

    def __init__(self, source: Source, link: Link, log: Path | None = None) -> None:
        """Nothing moves yet."""
        self._source, self._link, self._log = source, link, log
        self._life = 0
        self.loop: Loop | None = None
        self.phase: Phase = "starting"
        self.desk = Desk(source.axes, source.rate, source.settings)
        self.said: tuple[int, str, bool] = (0, "", False)
        self.edit, self._fresh = 0, True
        self._shown: Shown | None = None
        self._report: tuple[float, tuple[str, ...]] = (-np.inf, ())
        self._health = Health(rate=source.rate)

    def run(self, lives: int | None = None) -> None:
        """Live, until the page or the program ends.

        Args:
            lives: How many lives of the arm, from torque on to torque off; None: any number.

        Raises:
            PageGone: The page has ended; the arm has been lowered.
            PliantError: There is no arm to begin with.
        """
        for self._life in itertools.count(1):
            self._next: Next | None = None
            try:
                self._live()
            except ServoError as error:
                if self._shown is None:
                    raise
                # Whoever looks at the page shall read it, and may try again.
                self.say(str(error), wrong=True)
            self.phase = "down"
            if self._life == lives:
                return
            self._wait()

    # One life.

    def _live(self) -> None:
        """Torque on, control, torque off."""
        arm = self._source.arm()
        self._tap = arm.drive = Tap(arm.drive)
        self._arm, self._body = arm, Body(arm)
        self._pace = Pace(arm.clock) if self._source.paced else None
        self._tap.on_read = self._on_read
        self.phase = "starting"
        self._step: Step | None = None
        with arm:
            try:
                self._control(arm)
            finally:
                # Whatever ends it, the page sees the arm come down.
                self.phase = "lowering"
            if self._next == "scene":
                arm.limp()

    def _control(self, arm: Arm) -> None:
        """The loop, with its log."""
        controller = self._begin(arm)
        if self._log is None:
            self._turns(arm, controller, None)
            return
        from pliant.log import Recorder

        path = self._log
        if self._life > 1:
            path = path.with_stem(f"{path.stem}-{self._life}")
        with Recorder(path, arm, controller, config=self._source.config) as recorder:
            self._turns(arm, recorder.controller, recorder)

    def _turns(self, arm: Arm, controller: Controller, recorder: Recorder | None) -> None:
        """Until somebody wants something else."""
        self.phase = "running"
        loop = self.loop = Loop(arm, controller, rate=self._source.rate)
        for tick in loop:
            self._take(controller)
            self._scripted(tick.time)
            command = controller.step(tick.q, self.target, dt=tick.dt)
            tick.write(command)
            if recorder is not None:
                recorder.add(tick, command)
            if self._link.due():
                self._look(controller, command, loop)
                self._publish(tick)
            if self._next is not None:
                return

    def _begin(self, arm: Arm) -> Controller:
        """The controller, the hand, and what the page must know first."""
        q = arm.read().q
        if self._source.scene is not None and self._fresh:
            self.desk.begin(self._source.scene.preset)
        self._fresh = False
        controller = pliant.Controller(arm.model, self.desk.effective, arm.servos)
        self.home = np.asarray(arm.model.forward_kinematics(q))
        self.target = self.home.copy()
        self._played: float | None = None
        strengths = controller.strengths
        strong = [STRONG * float(axis.hold or 0.0) for axis in strengths.values()]
        names = tuple(strengths)
        linear = [f for f, name in zip(strong, names, strict=True) if name in "xyz"]
        turning = [f for f, name in zip(strong, names, strict=True) if name not in "xyz"]
        self._hand: VisitorHand | None = None
        if self._body.simulated:
            plant = self._body.plant
            self._hand = VisitorHand(max(linear, default=0.0))
            plant.set_hands([*(felt.hand for felt in plant.hands), self._hand])
        push = None if self._hand is None else (max(linear, default=0.0), max(turning, default=0.0))
        self._shown = self.desk.show(controller, q)
        stage = Stage(
            figure=self._body.plant.mj_model,
            arm=arm.model.name,
            where=self._source.where,
            axes=names,
            joints=arm.model.joint_names,
            usable=np.asarray(arm.servos.torque),
            scene=self._source.name,
            scenes={name: scene.about for name, scene in self._source.scenes.items()},
            play=self._source.scene.play if self._source.scene is not None else "",
            presets=self.desk.presets,
            walls=scenes.planes(self._body.plant),
            home=self.home,
            strong=push,
        )
        self._link.send(stage)
        return controller

    # Orders.

    def _take(self, controller: Controller | None) -> None:
        """Do what the page has asked for since the last tick."""
        for order in orders.latest(self._link.orders()):
            self.take(order, controller)

    def take(self, order: orders.Order, controller: Controller | None) -> None:
        """Do one thing; what is refused is said, and nothing has changed."""
        match order:
            case orders.Edit(number=number):
                self.edit = number
                if controller is not None:
                    self._edit(order, controller)
            case orders.Target(pose=pose):
                self.target, self._played = np.asarray(pose, dtype=np.float64), None
            case orders.Home():
                self.target, self._played = self.home.copy(), None
            case orders.Stop():
                self._next = "stop"
            case orders.Start():
                self._next = "start"
            case orders.Scene(name=name):
                if name in self._source.scenes:
                    self._source.name, self._next, self._fresh = name, "scene", True
            case orders.Play():
                self._play()
            case _:
                self._touch(order)

    def _touch(self, order: orders.Order) -> None:
        """The visitor's hand."""
        hand = self._hand
        if hand is None:
            return
        match order:
            case orders.Push(force=force, torque=torque, seconds=seconds):
                hand.push(force, torque, self._body.plant.time + seconds)
            case orders.Grab(body=body, point=point, toward=toward):
                hand.grab(self._body.plant, body, point, toward)
            case orders.LetGo():
                hand.let_go()

    def _edit(self, order: orders.Edit, controller: Controller) -> None:
        try:
            self.desk.take(order, controller)
        except PliantError as error:
            self.say(str(error), wrong=True)
        self._shown = self.desk.show(controller)
        self._report = (-np.inf, ())

    def say(self, text: str, *, wrong: bool = False) -> None:
        """Tell the page something."""
        self.said = (self.said[0] + 1, text, wrong)

    def _play(self) -> None:
        if self._body.simulated and scenes.take(self._body.plant):
            return
        self._played = self._arm.clock.now()

    def _scripted(self, now: float) -> None:
        """The target of a scene that plays; hands that open."""
        scene = self._source.scene
        if scene is None:
            return
        scenes.let_go_when_taken(self._body.plant, self.home)
        if self._played is not None:
            pose = scene.target(self.home, now - self._played)
            if pose is None:
                self._played = None
            else:
                self.target = pose

    # Looking.

    def _look(self, controller: Controller, command: Command, loop: Loop) -> None:
        """What the step knew; the report once a second."""
        now = time.perf_counter()
        if now - self._report[0] > REPORT:
            self._report = (now, tuple(controller.report().sentences()))
        self._step = Step(
            target=self.target,
            reference=controller.reference,
            deviation=controller.deviation,
            compliance=controller.compliance,
            softness=controller.softness,
            strength=controller.holding_torque,
            wrench=controller.wrench,
            activation=controller.activation,
            limit=command.torque_limit,
            saturated=controller.saturated,
            locked=controller.locked,
        )
        late = loop.lateness if self._pace is None else self._pace.lateness
        self._health = Health(
            rate=1.0 / loop.period,
            ticks=len(late),
            p50=late.percentile(50.0),
            p99=late.percentile(99.0),
            largest=late.largest,
            missed=loop.missed,
            stale=loop.stale,
            refused=loop.refused,
            restarts=loop.restarts,
            delay=loop.delay,
            speed=1.0 if self._pace is None else self._pace.speed,
        )

    def _publish(self, tick: Tick) -> None:
        self._link.send(self._snapshot(tick.q, dict(tick.state.extra), tick.time))

    def _on_read(self) -> None:
        """After every reading: simulated time waits for life; the page sees the arm come down."""
        if self._pace is not None:
            self._pace.wait()
        if self.phase == "lowering" and self._link.due():
            # Whoever looks on, the arm comes down.
            with contextlib.suppress(PageGone):
                self._publish_still()

    def _publish_still(self) -> None:
        """Where the arm is without a step of the controller."""
        last, names = self._tap.last, self._arm.drive.names
        if last is None:
            return
        by_name = dict(zip(names, np.asarray(last.position).tolist(), strict=True))
        q = np.array([by_name.pop(name) for name in self._arm.model.joint_names])
        self._link.send(self._snapshot(q, by_name, self._arm.clock.now()))

    def _snapshot(self, q: Array, extra: dict[str, float], now: float) -> Snapshot:
        pull = None
        if self._hand is not None:
            pull = self._hand.felt
        return Snapshot(
            time=now,
            phase=self.phase,
            qpos=self._body.pose(q, extra),
            mocap=self._body.mocap(),
            tool=np.asarray(self._arm.model.forward_kinematics(q)),
            step=self._step if self.phase == "running" else None,
            pull=pull,
            health=self._health,
            report=self._report[1],
            said=self.said,
            edit=self.edit,
            shown=self._shown,
        )

    def _wait(self) -> None:
        """Torque is off; until somebody wants it on again."""
        if self._next == "scene":
            return
        self._next = None
        clock = self._arm.clock
        while self._next not in {"start", "scene"}:
            self._take(None)
            if self._link.due():
                self._publish_still()
            clock.wait_until(clock.now() + IDLE)
            if self._pace is not None:
                self._pace.wait()
