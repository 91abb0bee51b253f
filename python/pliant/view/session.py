"""Control of an arm for the browser page: control loop, and messages of the page between ticks."""

from __future__ import annotations

import contextlib
import itertools
import re
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ConfigError, Controller, PliantError, ServoError
from pliant.loop import Loop
from pliant.view import messages, scenes
from pliant.view.ipc import PageGone
from pliant.view.mouse_force import MouseForce
from pliant.view.publisher import DriveObserver, Publisher
from pliant.view.robot_view import RobotView
from pliant.view.settings_editor import SettingsEditor
from pliant.view.snapshot import Ended, SceneInfo
from pliant.view.source import RealtimePacer

if TYPE_CHECKING:
    from pathlib import Path

    from pliant._core import Command
    from pliant.arm import Arm
    from pliant.loop import Tick
    from pliant.view.ipc import Link
    from pliant.view.source import Source

    Next = Literal["stop", "start", "scene"]

#: Time between two checks for messages of the page while the torque is off [s].
POLL_PERIOD = 0.03
#: Display names of built-in arms by the robot name in their URDF.
DISPLAY_NAMES = {"so101_like": "SO-101 (simplified)", "koch_like": "Koch (simplified)"}
#: Maximum push by a user of the page, as a share of the largest force cap `Axis.hold` [1].
PUSH_SHARE = 1.0


class Session:
    """Controls an arm for the browser page, in one or more runs from torque on to torque off.

    Args:
        source: Object that creates the arm for each run.
        link: Connection to the process of the page.
        log: MCAP file to write; later runs add `-2`, `-3`, ... to its name. None: no log.

    Attributes:
        publisher: Object that sends snapshots (states of the arm) to the page.
        editor: Settings of the controller, which users of the page can change.
        target: Target pose (4, 4) of the controller.
        loop: Control loop of the present or the last run; None before the first run.
    """

    def __init__(self, source: Source, link: Link, log: Path | None = None) -> None:
        """Create a session without a run."""
        self._source, self._link, self._log = source, link, log
        self._session_number = 0
        self.loop: Loop | None = None
        self._play_start: float | None = None
        self._max_push = 0.0, 0.0
        self.target = self._accepted_target = np.eye(4)
        self.publisher = Publisher(link, source.rate)
        self.editor = SettingsEditor(source.axes, source.rate, source.settings)
        self._is_new_scene = True

    def run(self, max_sessions: int | None = None) -> None:
        """Control the arm until the page ends.

        Args:
            max_sessions: Number of runs, from torque on to torque off; None: unlimited.

        Raises:
            PageGone: The process of the page has ended; the arm has been lowered.
            ServoError: The first run failed before its controller was created. Errors of later
                runs are shown on the page instead.
            PliantError: The arm or the settings cannot be used.
        """
        try:
            self._run_sessions(max_sessions)
        finally:
            # Ctrl-C and SIGTERM come here after the descent.
            self._send_end()

    def _run_sessions(self, max_sessions: int | None) -> None:
        for self._session_number in itertools.count(1):
            self._next: Next | None = None
            try:
                self._run_session()
            except ServoError as error:
                if self.publisher.shown is None:
                    raise
                # Show the error on the page, so that the user can start another run.
                self.publisher.show_error(str(error), "fault")
            self.publisher.phase = "down"
            if self._session_number == max_sessions:
                return
            self._wait_for_start()

    def _send_end(self) -> None:
        """Send the final state of the arm to the page, if it has shown the arm."""
        if self.publisher.shown is None:
            return
        arm = self._arm
        is_off = not (arm._is_unfinished or arm._is_left_on or arm._is_handed_over)
        text = arm._exit_message or f"{arm.name}: torque {'OFF' if is_off else 'ON'}"
        with contextlib.suppress(PageGone):
            self._link.send(Ended(text, is_off))

    # One run, from torque on to torque off.

    def _run_session(self) -> None:
        """Switch torque on, control the arm, and lower it.

        If the user changes the scene, the torque is switched off without a descent.
        """
        arm = self._source.arm()
        observer = arm.drive = DriveObserver(arm.drive)
        self._arm, self._robot = arm, RobotView(arm, self._source.urdf)
        self._pacer = RealtimePacer(arm.clock) if self._source.paced else None
        self.publisher.observe(arm, self._robot, observer, self._pacer)
        observer.on_read = self.publisher.on_read
        # Check the settings here, to raise errors before torque is on.
        Controller(arm.model, self.editor.effective, arm.servos)
        with arm:
            try:
                self._control(arm)
            except ServoError as error:
                # Show the error on the page before the arm is lowered, which may take a minute.
                self.publisher.show_error(str(error), "fault")
                raise
            finally:
                # In this phase the publisher sends the readings of the descent to the page.
                self.publisher.phase = "lowering"
            if self._next == "scene":
                arm.disable_torque()

    def _control(self, arm: Arm) -> None:
        """Run the control loop until the user wants to stop or change the scene; log if wanted."""
        controller = self._prepare(arm)
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
            self._update_scripted_target(tick.began)
            self.publisher.before_step(tick, loop)
            command = self._step(tick, controller)
            tick.write(command)
            self.publisher.after_step(tick, controller, command, self.target, loop)
            if self._next is not None:
                return

    def _step(self, tick: Tick, controller: Controller) -> Command:
        """Return the controller's command; if it rejects the target, use the last accepted one."""
        try:
            command = controller.step(tick.q, self.target, dt=tick.dt)
        except ServoError:
            raise
        except (PliantError, ValueError) as error:
            if self.target is self._accepted_target:
                raise
            self.target, self._play_start = self._accepted_target, None
            command = controller.step(tick.q, self.target, dt=tick.dt)
            self.publisher.show_error(str(error), "target")
        self._accepted_target = self.target
        return command

    def _prepare(self, arm: Arm) -> Controller:
        """Prepare a run, and return its controller.

        Create the controller and the user's force, and send a description of the scene to the page.
        """
        q = arm.read().q
        if self._source.scene is not None and self._is_new_scene:
            self.editor.begin(self._source.scene.preset)
        self._is_new_scene = False
        controller = Controller(arm.model, self.editor.effective, arm.servos)
        self.home = np.asarray(arm.model.forward_kinematics(q))
        self.target = self._accepted_target = self.home.copy()
        self._play_start = None
        strengths = controller.axes
        names = tuple(strengths)
        holds = {name: PUSH_SHARE * float(axis.hold or 0.0) for name, axis in strengths.items()}
        max_force = max((hold for name, hold in holds.items() if name in "xyz"), default=0.0)
        max_torque = max((hold for name, hold in holds.items() if name not in "xyz"), default=0.0)
        self._max_push = max_force, max_torque
        self._hand: MouseForce | None = None
        if self._robot.simulated:
            plant = self._robot.plant
            self._hand = self.publisher.hand = MouseForce(max_force)
            plant.set_hands([*(record.hand for record in plant.hands), self._hand])
        push = None if self._hand is None else self._max_push
        self.publisher.estimate_contact(controller)
        self.publisher.shown = self.editor.describe(controller, q)
        info = SceneInfo(
            mj_model=self._robot.plant.mj_model,
            arm=DISPLAY_NAMES.get(arm.model.name, arm.model.name),
            where=self._source.where,
            axes=names,
            joints=arm.model.joint_names,
            start=self._robot.qpos(q, {}),
            max_torque=np.asarray(arm.servos.max_torque),
            scene=self._source.name,
            scenes={name: scene.about for name, scene in self._source.scenes.items()},
            play=self._source.scene.play if self._source.scene is not None else "",
            presets=self.editor.presets,
            walls=scenes.wall_planes(self._robot.plant),
            home=self.home,
            max_push=push,
            force=max_force,
            reach=arm.model.reach,
            visuals=self._robot.visuals,
            table=self._source.table,
        )
        self._link.send(info)
        return controller

    # Methods that handle messages from the page.

    def _handle_messages(self, controller: Controller | None) -> None:
        """Handle the messages that the page has sent since the last tick."""
        for message in self._link.messages():
            self.handle(message, controller)

    def handle(self, message: messages.Message, controller: Controller | None) -> None:
        """Handle a message from the page; if it is invalid, show the error and change nothing.

        Args:
            message: The message.
            controller: The present controller; None while the torque is off.
        """
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
                self.target, self._play_start = self.home.copy(), None
                self.publisher.clear_error("target")
            case messages.Stop():
                self._next = "stop"
            case messages.Start():
                # Ignore a second click on the start button, which must not end the present run.
                if self.publisher.phase == "down":
                    self._next = "start"
            case messages.Scene(name=name):
                if name in self._source.scenes:
                    self._source.name, self._next, self._is_new_scene = name, "scene", True
            case messages.Play():
                self._play()
            case _:
                self._apply_to_hand(message)

    def _set_target(self, message: messages.Target) -> None:
        """Set a new target if it is a pose within reach of the arm; else show an error."""
        try:
            pose = messages.check_target(message, self._arm.model)
        except ConfigError as error:
            self.publisher.show_error(f"{error}; the old target stays", "target")
            return
        self.target, self._play_start = pose, None
        self.publisher.clear_error("target")

    def _apply_to_hand(self, message: messages.Message) -> None:
        """Apply the message `Push`, `Grab` or `LetGo` to the user's force on a simulated arm."""
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
            # ROS 2 parameters are named like fields of `pliant.Axis`; the page names this one η.
            text = re.sub(r"axes\.(\w+)\.adaptation", r"η of \1", str(error))
            self.publisher.show_error(text.replace("Axis.adaptation", "η"), "settings")
        else:
            self.publisher.clear_error("settings")
        self.publisher.shown = self.editor.describe(controller)
        self.publisher.request_report()

    def _play(self) -> None:
        if self._robot.simulated and scenes.take_object(self._robot.plant):
            return
        self._play_start = self._arm.clock.now()

    def _update_scripted_target(self, now: float) -> None:
        """Move the scripted target of the scene to its pose at the time `now` [s].

        If a simulated person pulls the object in the gripper, the gripper opens.
        """
        scene = self._source.scene
        if scene is None:
            return
        scenes.release_when_pulled(self._robot.plant, self.home)
        if self._play_start is not None:
            pose = scene.target(self.home, now - self._play_start)
            if pose is None:
                self._play_start = None
            else:
                self.target = pose

    def _wait_for_start(self) -> None:
        """Wait with torque off until the user wants to start a run or change the scene."""
        if self._next == "scene":
            return
        self._next = None
        clock = self._arm.clock
        while self._next not in {"start", "scene"}:
            self._handle_messages(None)
            self.publisher.publish_reading()
            clock.wait_until(clock.now() + POLL_PERIOD)
            if self._pacer is not None:
                self._pacer.wait()
