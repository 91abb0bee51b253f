"""Repetition of a logged run: the same inputs must give the same commands, bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import Command, ConfigError, Controller, Settings, __version__
from pliant.log.reader import Log, arguments

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pliant._typing import Array


#: Calls of a controller other than steps.
CALLS = ("reset", "update", "set_payload", "set_gravity", "set_delay", "capture_gravity")
COMMAND = ("goal", "torque_limit", "speed_limit")


@dataclass(frozen=True)
class Verification:
    """Commands of a run and of its repetition, M steps of n joints.

    Attributes:
        steps: Steps that were repeated.
        differing: Steps whose goal, limit or velocity differ in any bit.
        goal, torque_limit: Of the repetition (M, n) [rad, N·m].
        largest: Largest difference of a goal [rad].
        missing: Calls missing from the log; commands after the first of them can differ.
    """

    steps: int
    differing: int
    goal: Array
    torque_limit: Array
    largest: float
    missing: int

    @property
    def same(self) -> bool:
        """True if every step gave the same command, bit for bit."""
        return self.differing == 0 and self.missing == 0


def verify(log: Log, settings: Settings | None = None) -> Verification:
    """Repeat all logged calls on a new controller.

    Args:
        log: The log.
        settings: Replace the initial settings, to see the commands for the same inputs. The log's
            own changes of settings are then left out.

    Raises:
        ConfigError: The log was made without a controller, or by another version of pliant.
    """
    goals, limits, differing, largest = [], [], 0, 0.0
    for call, _, command in steps(log, settings):
        pairs = [(np.array(getattr(call, name)), getattr(command, name)) for name in COMMAND]
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
    """Repeat the calls one by one: yield each step's call, the controller, and its command.

    `before` is called with call and controller before every step, e.g. for a `ContactEstimator`.

    Raises:
        ConfigError: As `verify`.
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
                if call.what not in CALLS:
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
    """Run one step with the recorded arguments."""
    given: dict[str, Any] = {
        name: np.array(value) if len(value) else None
        for name in ("dq", "twist", "gradient")
        for value in (getattr(call, name),)
    }
    given["dt"] = None if np.isnan(call.dt) else call.dt
    q = np.array(call.q)
    if call.what == "step_joints":
        return controller.step_joints(q, np.array(call.q_target), **given)
    target = np.array(call.target)
    whole = not np.isnan(target).any()
    return controller.step(q, target.reshape(4, 4) if whole else target[:3], **given)
