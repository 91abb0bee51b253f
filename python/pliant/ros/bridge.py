"""`Bridge`: lets targets and settings from the network control an arm, and publishes its state."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, ContactEstimator, PliantError
from pliant._validation import real
from pliant.ros.messages import ArmState, NewSettings, RobotInfo
from pliant.view.messages import Target

if TYPE_CHECKING:
    from pliant._core import Command
    from pliant._typing import Array
    from pliant.arm import Arm
    from pliant.loop import Loop, Tick
    from pliant.view.ipc import ProcessLink


class Bridge:
    """Connects a control loop with the process of a ROS 2 node or of a Foxglove server.

    The loop never waits for the network. The arm holds its pose until the first target; when
    targets stop, it goes to the last one and holds it.

    Args:
        arm: The enabled arm.
        loop: Loop over the arm, with a `pliant.Controller`.
        link: Connection to the process of the network: `pliant.ros.ros_link(...)` or
            `pliant.ros.foxglove_link(...)`.
        rate: Rate at which the state is published [Hz], rounded to a whole number of ticks.

    Attributes:
        target: Target pose of the tool (4, 4); None before the first tick.

    Raises:
        ConfigError: The rate is not above 0 Hz.

    Example:
        >>> with pliant.ros.ros_link() as link, pliant.connect("so101") as arm:
        ...     controller = pliant.Controller(arm.model, settings, arm.servos)
        ...     loop = pliant.Loop(arm, controller)
        ...     bridge = pliant.ros.Bridge(arm, loop, link)
        ...     for tick in loop:
        ...         bridge.step(tick)
    """

    def __init__(self, arm: Arm, loop: Loop, link: ProcessLink, rate: float = 50.0) -> None:
        """Send the description of the arm to the process of the network."""
        if not real(rate, "rate") > 0.0:
            raise ConfigError(f"rate must be above 0 Hz, got {rate!r}")
        self._loop, self._link = loop, link
        self._ticks_per_state = max(round(1.0 / (rate * loop.period)), 1)
        controller = loop.controller
        # The estimator needs the controller itself, not the wrapper of a recorder.
        self._contact = ContactEstimator(getattr(controller, "inner", controller))
        self._restarts = loop.restarts
        self._model, self._extra = arm.model, tuple(arm.grippers)
        self.target: Array | None = None
        link.send(
            RobotInfo(
                model=arm.model,
                settings=controller.settings,
                servos=arm.servos,
                extra=self._extra,
            )
        )

    def step(self, tick: Tick) -> Command:
        """Apply messages of the network, step the controller, write the command, publish the state.

        Returns:
            The command of the tick.

        Raises:
            PageGone: The process of the network has ended.
            ServoError: As `Tick.write`.
        """
        if self.target is None:
            self.target = self._model.forward_kinematics(tick.q)
        for message in self._link.messages():
            match message:
                case Target(pose=pose):
                    self.target = pose
                case NewSettings(settings=settings):
                    try:
                        self._loop.controller.update(settings)
                    except PliantError as error:
                        print(f"settings refused by the controller: {error}", file=sys.stderr)
        if self._restarts != self._loop.restarts:
            self._restarts = self._loop.restarts
            self._contact.reset()
        self._contact.update(tick.q, dt=tick.dt)
        command: Command = tick.step(self.target)
        if tick.index % self._ticks_per_state == 0 and self._link.due():
            self._link.send(self._state(tick))
        return command

    def _state(self, tick: Tick) -> ArmState:
        state, nan = tick.state, np.full(tick.q.size, np.nan)
        return ArmState(
            time=time.time_ns(),
            q=tick.q,
            dq=nan if state.dq is None else np.asarray(state.dq),
            load=nan if state.load is None else np.asarray(state.load),
            extra=np.array([state.extra.get(name, np.nan) for name in self._extra]),
            wrench=np.asarray(self._contact.estimate.force_base),
        )
