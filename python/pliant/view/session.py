"""The loop behind a page: one arm, its controller, and the messages between ticks."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ConfigError, Controller, PliantError, ServoError
from pliant.loop import Loop
from pliant.view import messages, scenes
from pliant.view.mouse_force import MouseForce
from pliant.view.publisher import DriveObserver, Publisher
from pliant.view.robot_view import RobotView
from pliant.view.settings_editor import SettingsEditor
from pliant.view.snapshot import SceneInfo
from pliant.view.source import RealtimePacer

if TYPE_CHECKING:
    from pathlib import Path

    from pliant._core import Command
    from pliant.arm import Arm
    from pliant.loop import Tick
    from pliant.view.ipc import Link
    from pliant.view.source import Source

    Next = Literal["stop", "start", "scene"]

#: Polling period of messages while no loop runs [s].
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
        publisher: Snapshots for the page.
        editor: The settings.
        target: Target pose (4, 4) of the controller.
        loop: The present loop, or the last.
    """

    def __init__(self, source: Source, link: Link, log: Path | None = None) -> None:
        """Prepare a session; the arm does not move yet."""
        self._source, self._link, self._log = source, link, log
        self._session_number = 0
        self.loop: Loop | None = None
        self._played: float | None = None
        self._max_push = 0.0, 0.0
        self.target = self._accepted = np.eye(4)
        self.publisher = Publisher(link, source.rate)
        self.editor = SettingsEditor(source.axes, source.rate, source.settings)
        self._fresh = True

    def run(self, max_sessions: int | None = None) -> None:
        """Run until the page or the program ends.

        Args:
            max_sessions: Number of runs, from torque on to torque off; None: unlimited.

        Raises:
            PageGone: The page has ended; the arm has been lowered.
            PliantError: There is no arm.
        """
        for self._session_number in itertools.count(1):
            self._next: Next | None = None
            try:
                self._run_session()
            except ServoError as error:
                if self.publisher.shown is None:
                    raise
                # Show the error on the page; the visitor may try again.
                self.publisher.show_error(str(error), "fault")
            self.publisher.phase = "down"
            if self._session_number == max_sessions:
                return
            self._wait()

    # One run.

    def _run_session(self) -> None:
        """Switch torque on, control the arm, and lower it."""
        arm = self._source.arm()
        observer = arm.drive = DriveObserver(arm.drive)
        self._arm, self._robot = arm, RobotView(arm, self._source.urdf)
        self._pacer = RealtimePacer(arm.clock) if self._source.paced else None
        self.publisher.observe(arm, self._robot, observer, self._pacer)
        observer.on_read = self.publisher.on_read
        # Check the settings before torque comes on.
        Controller(arm.model, self.editor.effective, arm.servos)
        with arm:
            try:
                self._control(arm)
            except ServoError as error:
                # Show the error before the descent, which may take a minute.
                self.publisher.show_error(str(error), "fault")
                raise
            finally:
                # The page shows the descent, whatever the cause.
                self.publisher.phase = "lowering"
            if self._next == "scene":
                arm.disable_torque()

    def _control(self, arm: Arm) -> None:
        """Run the loop, with its log."""
        controller = self._begin(arm)
        recorder = None
        if self._log is not None:
            from pliant.log import Recorder

            path = self._log
            if self._session_number > 1:
                path = path.with_stem(f"{path.stem}-{self._session_number}")
            recorder = Recorder(path, config=self._source.config)
        self.publisher.phase = "running"
        self.publisher.clear_error("target", "hand", "settings", "fault")
        loop = self.loop = Loop(arm, controller, rate=self._source.rate, recorder=recorder)
        controller = loop.controller
        for tick in loop:
            self._handle_messages(controller)
            self._scripted(tick.began)
            self.publisher.before_step(tick, loop)
            command = self._step(tick, controller)
            tick.write(command)
            self.publisher.after_step(tick, controller, command, self.target, loop)
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
            self.publisher.show_error(str(error), "target")
        self._accepted = self.target
        return command

    def _begin(self, arm: Arm) -> Controller:
        """Make the controller and the hand, and describe the scene to the page."""
        q = arm.read().q
        if self._source.scene is not None and self._fresh:
            self.editor.begin(self._source.scene.preset)
        self._fresh = False
        controller = Controller(arm.model, self.editor.effective, arm.servos)
        self.home = np.asarray(arm.model.forward_kinematics(q))
        self.target = self._accepted = self.home.copy()
        self._played = None
        strengths = controller.axes
        max_push = [STRONG * float(axis.hold or 0.0) for axis in strengths.values()]
        names = tuple(strengths)
        linear = [f for f, name in zip(max_push, names, strict=True) if name in "xyz"]
        turning = [f for f, name in zip(max_push, names, strict=True) if name not in "xyz"]
        self._hand: MouseForce | None = None
        if self._robot.simulated:
            plant = self._robot.plant
            self._hand = self.publisher.hand = MouseForce(max(linear, default=0.0))
            plant.set_hands([*(record.hand for record in plant.hands), self._hand])
        self._max_push = max(linear, default=0.0), max(turning, default=0.0)
        push = None if self._hand is None else self._max_push
        self.publisher.estimate_contact(controller)
        self.publisher.shown = self.editor.describe(controller, q)
        info = SceneInfo(
            figure=self._robot.plant.mj_model,
            arm=display_name(arm.model.name),
            where=self._source.where,
            axes=names,
            joints=arm.model.joint_names,
            start=self._robot.pose(q, {}),
            usable=np.asarray(arm.servos.max_torque),
            scene=self._source.name,
            scenes={name: scene.about for name, scene in self._source.scenes.items()},
            play=self._source.scene.play if self._source.scene is not None else "",
            presets=self.editor.presets,
            walls=scenes.wall_planes(self._robot.plant),
            home=self.home,
            max_push=push,
            force=max(linear, default=0.0),
            reach=arm.model.reach,
            visuals=self._robot.visuals,
            table=self._source.table,
        )
        self._link.send(info)
        return controller

    # Orders.

    def _handle_messages(self, controller: Controller | None) -> None:
        """Carry out the page's messages since the last tick."""
        for message in self._link.messages():
            self.handle(message, controller)

    def handle(self, message: messages.Message, controller: Controller | None) -> None:
        """Carry out one message; if it is refused, report why and change nothing."""
        if self._next == "stop" and not isinstance(message, messages.Edit):
            return
        match message:
            case messages.Edit(number=number):
                self.publisher.edit = number
                if controller is not None:
                    self._edit(message, controller)
            case messages.Target():
                self._set_target(message)
            case messages.Home():
                self.target, self._played = self.home.copy(), None
                self.publisher.clear_error("target")
            case messages.Stop():
                self._next = "stop"
            case messages.Start():
                # A late click must not end the new run.
                if self.publisher.phase == "down":
                    self._next = "start"
            case messages.Scene(name=name):
                if name in self._source.scenes:
                    self._source.name, self._next, self._fresh = name, "scene", True
            case messages.Play():
                self._play()
            case _:
                self._apply_to_hand(message)

    def _set_target(self, message: messages.Target) -> None:
        """Set a new target if the arm can reach it."""
        try:
            pose = messages.check_target(message, self._arm.model)
        except ConfigError as error:
            self.publisher.show_error(f"{error}; the old target stays", "target")
            return
        self.target, self._played = pose, None
        self.publisher.clear_error("target")

    def _apply_to_hand(self, message: messages.Message) -> None:
        """Apply a message to the visitor's hand."""
        hand = self._hand
        if hand is None:
            return
        try:
            match message:
                case messages.Push(force=force, torque=torque, seconds=seconds):
                    messages.check_push(message, self._max_push)
                    hand.push(force, torque, self._robot.plant.time + seconds)
                case messages.Grab(body=body, point=point, toward=toward):
                    messages.check_grab(message)
                    hand.grab(self._robot.plant, body, point, toward)
                case messages.LetGo():
                    hand.let_go()
        except ConfigError as error:
            self.publisher.show_error(str(error), "hand")
            return
        self.publisher.clear_error("hand")

    def _edit(self, message: messages.Edit, controller: Controller) -> None:
        try:
            self.editor.apply(message, controller)
        except PliantError as error:
            self.publisher.show_error(str(error), "settings")
        else:
            self.publisher.clear_error("settings")
        self.publisher.shown = self.editor.describe(controller)
        self.publisher.request_report()

    def _play(self) -> None:
        if self._robot.simulated and scenes.take(self._robot.plant):
            return
        self._played = self._arm.clock.now()

    def _scripted(self, now: float) -> None:
        """Update the scripted target of a scene, and release objects."""
        scene = self._source.scene
        if scene is None:
            return
        scenes.release_when_pulled(self._robot.plant, self.home)
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
            self._handle_messages(None)
            self.publisher.publish_reading()
            clock.wait_until(clock.now() + IDLE)
            if self._pacer is not None:
                self._pacer.wait()


def display_name(name: str) -> str:
    """Return the display name of an arm; a simplified model is marked as such."""
    return NAMES.get(name, name)
