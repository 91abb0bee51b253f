"""Controller wrapper that records all calls which change the controller."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import numpy as np

from pliant import functional
from pliant._core import Settings
from pliant.log import frames, layout, serialization

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._core import Command, Controller
    from pliant._typing import Array
    from pliant.log.frames import Sender


#: Header of a recorded step: number of the call; True for `step_joints`, False for `step`.
STEP = struct.Struct("<QB")


class StepInputs(TypedDict, total=False):
    """Optional arguments of `Controller.step`."""

    dt: float | None
    dq: ArrayLike | None
    twist: ArrayLike | None
    gradient: ArrayLike | None


class Journal:
    """Wrapper of a controller; records each successful call that changes the controller's state.

    Each method of this class calls the method of the controller with that name and records the
    call. All other attributes are forwarded without a record. Pass `journal.inner` to code that
    requires a `pliant.Controller`, such as `ContactEstimator`.

    Attributes:
        inner: The wrapped controller.
        calls: Number of recorded calls.
        delay: Last delay set in the controller [s].
    """

    def __init__(self, controller: Controller, sender: Sender) -> None:
        """Wrap a controller; `sender` sends the records to the writer of the log."""
        self.inner, self._sender = controller, sender
        self.calls, self.delay = 0, float(controller.settings.delay)
        self._target: Array | None = None
        self._has_joint_target = False
        n = controller.model.n
        vector = layout.step(n)
        self._row = np.empty(vector.size)
        self._slots = vector.split(self._row)

    def step(
        self,
        q: ArrayLike,
        target: Any,
        *,
        out: Command | None = None,
        **inputs: Unpack[StepInputs],
    ) -> Command:
        """Call and record `Controller.step`."""
        target = _target_array(target)
        command = self.inner.step(q, target, out=out, **inputs)
        self._record_step("target", q, target, inputs, command)
        return command

    def step_joints(
        self,
        q: ArrayLike,
        q_target: ArrayLike,
        *,
        out: Command | None = None,
        **inputs: Unpack[StepInputs],
    ) -> Command:
        """Call and record `Controller.step_joints`."""
        q_target = np.array(q_target, dtype=np.float64)
        command = self.inner.step_joints(q, q_target, out=out, **inputs)
        self._record_step("q_target", q, q_target, inputs, command)
        return command

    def reset(self, q: ArrayLike) -> None:
        """Call and record `Controller.reset`."""
        q = np.array(q, dtype=np.float64)
        self.inner.reset(q)
        self._record_call("reset", q=q)

    def update(self, settings: Settings) -> None:
        """Call and record `Controller.update`."""
        self.inner.update(settings)
        self._record_call("update", settings=settings)

    def set_payload(self, mass: float, com: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Call and record `Controller.set_payload`."""
        self.inner.set_payload(mass, com)
        self._record_call("set_payload", mass=mass, com=np.asarray(com, dtype=np.float64))

    def set_gravity(self, vector: ArrayLike) -> None:
        """Call and record `Controller.set_gravity`."""
        self.inner.set_gravity(vector)
        self._record_call("set_gravity", vector=np.asarray(vector, dtype=np.float64))

    def set_delay(self, delay: float) -> None:
        """Call and record `Controller.set_delay`."""
        self.inner.set_delay(delay)
        self.delay = delay
        self._record_call("set_delay", delay=delay)

    def capture_gravity(self, q: ArrayLike, goal: ArrayLike) -> Array:
        """Call and record `Controller.capture_gravity`."""
        q, goal = np.array(q, dtype=np.float64), np.array(goal, dtype=np.float64)
        stiffness = self.inner.capture_gravity(q, goal)
        self._record_call("capture_gravity", q=q, goal=goal)
        return stiffness

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    @property
    def target(self) -> Array | None:
        """Target pose of the last step (4, 4); None before the first step.

        If the target was a position, the rotation comes from the controller's reference.
        """
        target = self._target
        if target is None:
            return None
        if self._has_joint_target:
            return self.inner.model.forward_kinematics(target)
        if target.shape == (4, 4):
            return target
        pose = self.inner.diagnostics.reference
        pose[:3, 3] = target
        return pose

    def _record_step(
        self, slot: str, q: ArrayLike, target: Array, inputs: StepInputs, command: Command
    ) -> None:
        """Record a successful call of `step` (slot `target`) or `step_joints` (slot `q_target`).

        `slot` is the piece of the record into which the target is written.
        """
        slots = self._slots
        self._row.fill(np.nan)
        is_joint_target = slot == "q_target"
        self._target, self._has_joint_target = target, is_joint_target
        slots["q"][:] = q
        slots[slot][: target.size] = target.reshape(-1)
        for name, value in inputs.items():
            if value is not None:
                slots[name][:] = np.asarray(value)
        slots["goal"][:] = command.goal
        slots["torque_limit"][:] = command.torque_limit
        slots["speed_limit"][:] = command.speed_limit
        self._sender.send(frames.STEP, STEP.pack(self.calls, is_joint_target), self._row.tobytes())
        self.calls += 1

    def _record_call(self, what: str, **arguments: Any) -> None:
        """Record a successful call other than `step` and `step_joints`."""
        text = serialization.write({"sequence": self.calls, "what": what, "arguments": arguments})
        self._sender.send(frames.CALL, text.encode())
        self.calls += 1


def _target_array(target: Any) -> Array:
    """Return a target as array: a copy of an array or a list, or the matrix of a pose object."""
    if isinstance(target, np.ndarray | list | tuple):
        return np.array(target, dtype=np.float64)
    return np.asarray(functional.as_pose(target).matrix)
