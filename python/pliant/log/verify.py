"""Verification of a log: a new controller with the logged inputs must compute the same commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import Command, ConfigError, Controller, Settings, __version__
from pliant.log import layout
from pliant.log.reader import Log, arguments

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pliant._typing import Array


#: Methods of `Controller`, besides `step` and `step_joints`, whose calls a log may contain.
REPLAYED_CALLS = ("reset", "update", "set_payload", "set_gravity", "set_delay", "capture_gravity")


@dataclass(frozen=True)
class Verification:
    """Result of `verify`: recomputed commands of M steps with n joints.

    Attributes:
        steps: Number of steps M.
        differing: Number of steps whose goals, torque limits or speed limits differ in any bit.
        goal, torque_limit: Recomputed goals and torque limits (M, n) [rad, N·m].
        largest: Largest difference of a goal [rad].
        missing: Number of controller calls missing from the log; commands after a missing call may
            differ.
    """

    steps: int
    differing: int
    goal: Array
    torque_limit: Array
    largest: float
    missing: int

    @property
    def same(self) -> bool:
        """True if no call is missing and every command is equal, bit for bit."""
        return self.differing == 0 and self.missing == 0


def verify(log: Log, settings: Settings | None = None) -> Verification:
    """Repeat all logged calls on a new controller, and compare the commands with the log.

    Args:
        log: The log.
        settings: Settings that replace the logged ones, to see which commands they would have
            given for the logged inputs. Logged changes of settings are then ignored.

    Raises:
        ConfigError: The log was made without a controller; or, if `settings` is None, by another
            version of pliant.
    """
    goals, limits, differing, largest = [], [], 0, 0.0
    for call, _, command in steps(log, settings):
        pairs = [(np.array(getattr(call, name)), getattr(command, name)) for name in layout.COMMAND]
        differing += any(a.tobytes() != np.asarray(b).tobytes() for a, b in pairs)
        largest = max(largest, float(np.abs(pairs[0][0] - pairs[0][1]).max()))
        goals.append(np.array(command.goal))
        limits.append(np.array(command.torque_limit))
    n = len(log.run["joints"])
    return Verification(
        steps=len(goals),
        differing=differing,
        goal=np.array(goals).reshape(-1, n),
        torque_limit=np.array(limits).reshape(-1, n),
        largest=largest,
        missing=log.missing,
    )


def steps(
    log: Log,
    settings: Settings | None = None,
    before: Callable[[Any, Controller], None] | None = None,
) -> Iterator[tuple[Any, Controller, Command]]:
    """Repeat the logged calls on a new controller; yield call, controller and command per step.

    Args:
        log: The log.
        settings: Settings that replace the logged ones; see `verify`.
        before: Function that is called before every step with the call and the controller.

    Raises:
        ConfigError: The log cannot be repeated; see `verify`.
    """
    if log.settings is None:
        raise ConfigError("the log was made without a controller: there is nothing to run again")
    version = log.run["pliant"]
    if settings is None and version != __version__:
        raise ConfigError(
            f"the log was made by pliant {version}, this is {__version__}: only the same "
            "version need give the same commands"
        )
    controller = Controller(log.model(), settings or log.settings, log.servos)
    for call in log.calls:
        if not call.what.startswith("step"):
            if not (settings is not None and call.what == "update"):
                if call.what not in REPLAYED_CALLS:
                    raise ConfigError(f"the log has a call {call.what!r} that pliant does not know")
                try:
                    getattr(controller, call.what)(**arguments(call))
                except TypeError as error:
                    raise ConfigError(f"the log's call of {call.what}: {error}") from error
            continue
        if before is not None:
            before(call, controller)
        yield call, controller, _step(controller, call)


def _step(controller: Controller, call: Any) -> Command:
    """Repeat a recorded call of `step` or `step_joints`, and return the new command."""
    inputs: dict[str, Any] = {
        name: np.array(value) if len(value) else None
        for name in ("dq", "twist", "gradient")
        for value in (getattr(call, name),)
    }
    inputs["dt"] = None if np.isnan(call.dt) else call.dt
    q = np.array(call.q)
    if call.what == "step_joints":
        return controller.step_joints(q, np.array(call.q_target), **inputs)
    target = np.array(call.target)
    is_pose = not np.isnan(target).any()
    return controller.step(q, target.reshape(4, 4) if is_pose else target[:3], **inputs)
