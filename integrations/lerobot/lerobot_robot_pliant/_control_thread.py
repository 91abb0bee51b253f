"""Control loop in a thread: LeRobot's own loops run at 30 to 60 Hz, with pauses of seconds."""

from __future__ import annotations

import atexit
import contextlib
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from lerobot.utils.errors import DeviceNotConnectedError

import pliant

if TYPE_CHECKING:
    from collections.abc import Mapping

#: Rate of the loop [Hz].
RATE = 100.0
#: Time within which the first tick must come [s].
START_TIMEOUT = 5.0
#: Time within which the thread must end [s], unless it is lowering the arm after an error.
STOP_TIMEOUT = 5.0
#: Longest stall of the thread [s], for example while a library holds Python's global lock to load a
#: policy or to save an episode. The servos hold their goals meanwhile.
MAX_STALL = 3.0


class Behavior(Protocol):
    """Interface of the code that commands an arm in each tick."""

    def step(self, tick: pliant.Tick, controller: Any) -> Mapping[str, float]:
        """Send a command in this tick; return further values for the snapshot."""


def send(
    tick: pliant.Tick, command: pliant.Command, extra: Mapping[str, tuple[float, float]]
) -> None:
    """Write a command; skip the tick if a stall has made the command too old."""
    if not tick.write(command, extra):
        tick.skip()


@dataclass(frozen=True)
class Snapshot:
    """Values of the last tick.

    Attributes:
        positions: Joint positions by name, joints off the chain included [rad].
        extra: Further values by name, which `Behavior.step` returned.
    """

    positions: Mapping[str, float]
    extra: Mapping[str, float] = field(default_factory=dict)


class ControlThread:
    """Runs a `pliant.Loop` with a behavior until `stop`.

    If the loop ends with an error, the thread immediately acts as `on_exit` says, and `snapshot`
    raises.

    Args:
        arm: The arm, enabled.
        controller: Controller of the loop.
        behavior: Object whose `step` is called in each tick. It must not refer to the robot, which
            could then never be garbage-collected.
        name: Name of the robot or teleoperator in error messages.
        on_exit: `lower` or `leave_enabled`.
        recorder: Recorder of the loop; None: no log.
    """

    def __init__(
        self,
        arm: pliant.Arm,
        controller: Any,
        behavior: Behavior,
        *,
        name: str,
        on_exit: str,
        recorder: Any | None = None,
    ) -> None:
        """Create the loop; `start` starts it."""
        self._arm, self._behavior, self._name, self._on_exit = arm, behavior, name, on_exit
        self._loop = pliant.Loop(
            arm, controller, rate=RATE, max_step_time=MAX_STALL, recorder=recorder
        )
        self._stopping, self._ready = threading.Event(), threading.Event()
        self._snapshot: Snapshot | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="pliant-control", daemon=True)

    def start(self) -> None:
        """Start the thread and return after its first tick.

        Raises:
            DeviceNotConnectedError: The loop ended, or no tick came.
        """
        # Called before the arm is lowered at the end of the program: otherwise the loop would fail.
        atexit.register(self.stop)
        self._thread.start()
        self._ready.wait(START_TIMEOUT)
        self.snapshot()

    def stop(self) -> None:
        """End the loop; the arm keeps its last goals and limits until it is lowered.

        After an error in the loop, the thread lowers the arm itself, and `stop` waits until then.
        """
        atexit.unregister(self.stop)
        self._stopping.set()
        # The garbage collector may delete the robot, and so call `stop`, in this thread itself.
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(STOP_TIMEOUT)
            if self._error is not None:
                self._thread.join()

    def snapshot(self) -> Snapshot:
        """Return the values of the last tick.

        Raises:
            DeviceNotConnectedError: The loop has ended; the message says why.
        """
        if self._error is not None:
            raise DeviceNotConnectedError(
                f"the control loop of {self._name} ended: {self._error}; call "
                "disconnect(), then connect() starts again"
            ) from self._error
        if self._snapshot is None:
            raise DeviceNotConnectedError(f"no tick of {self._name} within {START_TIMEOUT:g} s")
        return self._snapshot

    def _run(self) -> None:
        """Run the loop until it is stopped or fails."""
        names = self._arm.model.joint_names
        try:
            for tick in self._loop:
                if self._stopping.is_set():
                    break
                extra = self._behavior.step(tick, self._loop.controller)
                positions = dict(zip(names, tick.q.tolist(), strict=True))
                self._snapshot = Snapshot(positions | dict(tick.state.extra), extra)
                self._ready.set()
        except BaseException as error:
            self._error = error
            self._ready.set()
            self._leave_arm()

    def _leave_arm(self) -> None:
        """Lower the arm or leave it enabled; the arm's own messages report an error."""
        with contextlib.suppress(pliant.ServoError):
            if self._on_exit == "lower":
                self._arm.lower()
            else:
                self._arm.leave_enabled()
