"""The loop behind a page: one arm, its controller, and the orders between ticks."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ConfigError, Controller, PliantError, ServoError
from pliant.loop import Loop
from pliant.view import checks, orders, scenes
from pliant.view.body import Body
from pliant.view.desk import Desk
from pliant.view.hand import VisitorHand
from pliant.view.look import Look
from pliant.view.pace import Pace
from pliant.view.snapshot import Stage
from pliant.view.tap import Tap

if TYPE_CHECKING:
    from pathlib import Path

    from pliant._core import Command
    from pliant.arm import Arm
    from pliant.loop import Tick
    from pliant.view.link import Link
    from pliant.view.source import Source

    Next = Literal["stop", "start", "scene"]

#: Polling period of orders while no loop runs [s].
IDLE = 0.03
#: Display names of built-in arms, by the name in their URDF.
NAMES = {"so101_like": "SO-101 (simplified)", "koch_like": "Koch (simplified)"}
#: Largest push of a visitor, as a share of `hold`.
STRONG = 1.0


class Session:
    """Runs an arm for a page.

    Args:
        source: Source of the arm.
        link: The page.
        log: MCAP file to write; later runs of the arm add `-2`, `-3`, ... to its name.

    Attributes:
        look: Snapshots for the page.
        desk: The settings.
        target: Target pose (4, 4) of the controller.
        loop: The present loop, or the last.
    """

    def __init__(self, source: Source, link: Link, log: Path | None = None) -> None:
        """Prepare a session; the arm does not move yet."""
        self._source, self._link, self._log = source, link, log
        self._life = 0
        self.loop: Loop | None = None
        self._played: float | None = None
        self._strong = 0.0, 0.0
        self.target = self._accepted = np.eye(4)
        self.look = Look(link, source.rate)
        self.desk = Desk(source.axes, source.rate, source.settings)
        self._fresh = True

    def run(self, lives: int | None = None) -> None:
        """Run until the page or the program ends.

        Args:
            lives: Number of runs, from torque on to torque off; None: unlimited.

        Raises:
            PageGone: The page has ended; the arm has been lowered.
            PliantError: There is no arm.
        """
        for self._life in itertools.count(1):
            self._next: Next | None = None
            try:
                self._live()
            except ServoError as error:
                if self.look.shown is None:
                    raise
                # Show the error on the page; the visitor may try again.
                self.look.say(str(error), "fault")
            self.look.phase = "down"
            if self._life == lives:
                return
            self._wait()

    # One run.

    def _live(self) -> None:
        """Switch torque on, control the arm, and lower it."""
        arm = self._source.arm()
        tap = arm.drive = Tap(arm.drive)
        self._arm, self._body = arm, Body(arm, self._source.urdf)
        self._pace = Pace(arm.clock) if self._source.paced else None
        self.look.at(arm, self._body, tap, self._pace)
        tap.on_read = self.look.on_read
        # Check the settings before torque comes on.
        Controller(arm.model, self.desk.effective, arm.servos)
        with arm:
            try:
                self._control(arm)
            except ServoError as error:
                # Show the error before the descent, which may take a minute.
                self.look.say(str(error), "fault")
                raise
            finally:
                # The page shows the descent, whatever the cause.
                self.look.phase = "lowering"
            if self._next == "scene":
                arm.disable_torque()

    def _control(self, arm: Arm) -> None:
        """Run the loop, with its log."""
        controller = self._begin(arm)
        recorder = None
        if self._log is not None:
            from pliant.log import Recorder

            path = self._log
            if self._life > 1:
                path = path.with_stem(f"{path.stem}-{self._life}")
            recorder = Recorder(path, config=self._source.config)
        self.look.phase = "running"
        self.look.settle("target", "hand", "settings", "fault")
        loop = self.loop = Loop(arm, controller, rate=self._source.rate, recorder=recorder)
        controller = loop.controller
        for tick in loop:
            self._take(controller)
            self._scripted(tick.began)
            self.look.before_step(tick, loop)
            command = self._step(tick, controller)
            tick.write(command)
            self.look.after_step(tick, controller, command, self.target, loop)
            if self._next is not None:
                return

    def _step(self, tick: Tick, controller: Controller) -> Command:
        """Step toward the target, or toward the last one if the controller refuses it."""
        try:
            command = controller.step(tick.q, self.target, dt=tick.dt)
        except ServoError:
            raise
        except (PliantError, ValueError) as error:
            if self.target is self._accepted:
                raise
            self.target, self._played = self._accepted, None
            command = controller.step(tick.q, self.target, dt=tick.dt)
            self.look.say(str(error), "target")
        self._accepted = self.target
        return command

    def _begin(self, arm: Arm) -> Controller:
        """Make the controller and the hand, and send the stage."""
        q = arm.read().q
        if self._source.scene is not None and self._fresh:
            self.desk.begin(self._source.scene.preset)
        self._fresh = False
        controller = Controller(arm.model, self.desk.effective, arm.servos)
        self.home = np.asarray(arm.model.forward_kinematics(q))
        self.target = self._accepted = self.home.copy()
        self._played = None
        strengths = controller.axes
        strong = [STRONG * float(axis.hold or 0.0) for axis in strengths.values()]
        names = tuple(strengths)
        linear = [f for f, name in zip(strong, names, strict=True) if name in "xyz"]
        turning = [f for f, name in zip(strong, names, strict=True) if name not in "xyz"]
        self._hand: VisitorHand | None = None
        if self._body.simulated:
            plant = self._body.plant
            self._hand = self.look.hand = VisitorHand(max(linear, default=0.0))
            plant.set_hands([*(felt.hand for felt in plant.hands), self._hand])
        self._strong = max(linear, default=0.0), max(turning, default=0.0)
        push = None if self._hand is None else self._strong
        self.look.feel(controller)
        self.look.shown = self.desk.show(controller, q)
        stage = Stage(
            figure=self._body.plant.mj_model,
            arm=display_name(arm.model.name),
            where=self._source.where,
            axes=names,
            joints=arm.model.joint_names,
            start=self._body.pose(q, {}),
            usable=np.asarray(arm.servos.max_torque),
            scene=self._source.name,
            scenes={name: scene.about for name, scene in self._source.scenes.items()},
            play=self._source.scene.play if self._source.scene is not None else "",
            presets=self.desk.presets,
            walls=scenes.planes(self._body.plant),
            home=self.home,
            strong=push,
            force=max(linear, default=0.0),
            reach=arm.model.reach,
            visuals=self._body.visuals,
            table=self._source.table,
        )
        self._link.send(stage)
        return controller

    # Orders.

    def _take(self, controller: Controller | None) -> None:
        """Carry out the page's orders since the last tick."""
        for order in self._link.orders():
            self.take(order, controller)

    def take(self, order: orders.Order, controller: Controller | None) -> None:
        """Carry out one order; if it is refused, report why and change nothing."""
        if self._next == "stop" and not isinstance(order, orders.Edit):
            return
        match order:
            case orders.Edit(number=number):
                self.look.edit = number
                if controller is not None:
                    self._edit(order, controller)
            case orders.Target():
                self._lead(order)
            case orders.Home():
                self.target, self._played = self.home.copy(), None
                self.look.settle("target")
            case orders.Stop():
                self._next = "stop"
            case orders.Start():
                # A late click must not end the new run.
                if self.look.phase == "down":
                    self._next = "start"
            case orders.Scene(name=name):
                if name in self._source.scenes:
                    self._source.name, self._next, self._fresh = name, "scene", True
            case orders.Play():
                self._play()
            case _:
                self._touch(order)

    def _lead(self, order: orders.Target) -> None:
        """Set a new target if the arm can reach it."""
        try:
            pose = checks.target(order, self._arm.model)
        except ConfigError as error:
            self.look.say(f"{error}; the old target stays", "target")
            return
        self.target, self._played = pose, None
        self.look.settle("target")

    def _touch(self, order: orders.Order) -> None:
        """Apply an order to the visitor's hand."""
        hand = self._hand
        if hand is None:
            return
        try:
            match order:
                case orders.Push(force=force, torque=torque, seconds=seconds):
                    checks.push(order, self._strong)
                    hand.push(force, torque, self._body.plant.time + seconds)
                case orders.Grab(body=body, point=point, toward=toward):
                    checks.grab(order)
                    hand.grab(self._body.plant, body, point, toward)
                case orders.LetGo():
                    hand.let_go()
        except ConfigError as error:
            self.look.say(str(error), "hand")
            return
        self.look.settle("hand")

    def _edit(self, order: orders.Edit, controller: Controller) -> None:
        try:
            self.desk.take(order, controller)
        except PliantError as error:
            self.look.say(str(error), "settings")
        else:
            self.look.settle("settings")
        self.look.shown = self.desk.show(controller)
        self.look.forget_report()

    def _play(self) -> None:
        if self._body.simulated and scenes.take(self._body.plant):
            return
        self._played = self._arm.clock.now()

    def _scripted(self, now: float) -> None:
        """Update the scripted target of a scene, and release objects."""
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

    def _wait(self) -> None:
        """Wait with torque off until the next start."""
        if self._next == "scene":
            return
        self._next = None
        clock = self._arm.clock
        while self._next not in {"start", "scene"}:
            self._take(None)
            self.look.still()
            clock.wait_until(clock.now() + IDLE)
            if self._pace is not None:
                self._pace.wait()


def display_name(name: str) -> str:
    """Return the display name of an arm; a simplified model is marked as such."""
    return NAMES.get(name, name)
