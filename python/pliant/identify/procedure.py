"""Procedures that move an arm, as generators of commands, and functions that run them.

A generator starts with the first positions, yields a command per tick, and receives the next
positions. `Procedure` wraps it as `step(q) -> Command`, which any loop can call; `run_procedure`
runs a procedure to its end on a connected or simulated arm.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import update_wrapper
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, Protocol, TypeVar

import numpy as np

from pliant._core import Command, ConfigError, ServoError, ShapeError
from pliant._validation import format_value, vector

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike

    from pliant._typing import Array


P = ParamSpec("P")
Q = ParamSpec("Q")
T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


#: Generator of a procedure: yields commands, receives joint positions (n,) [rad], returns a result.
Steps = Generator[Command, "Array", T]


class Arm(Protocol):
    """Protocol of an arm, simulated or real, on which procedures can run."""

    def read(self) -> Any:
        """Return an object with the measured joint positions as attribute `q` (n,) [rad]."""

    def write(self, goal: Any, limit: Any) -> None:
        """Send goals (n,) [rad] and torque limits (n,) [N·m]."""


class Tick(Protocol):
    """Protocol of one cycle of a control loop; the loop itself waits for the next period."""

    @property
    def q(self) -> Array:
        """Joint positions measured in this cycle (n,) [rad]."""

    def write(self, command: Command) -> Any:
        """Send goals and torque limits of a command to the arm."""


class Procedure(Generic[T]):
    """A procedure on an arm, such as an identification, that any loop can run: one `step` per tick.

    Args:
        start: Function that returns the generator of commands for the first positions (n,) [rad].
        n: Number of joints.

    Attributes:
        done: True once the procedure has ended; its last command keeps holding the arm.

    Example:
        >>> procedure = pliant.identify.capture_gravity.procedure(controller)
        >>> for tick in pliant.Loop(arm, controller):
        ...     tick.write(procedure.step(tick.q))
        ...     if procedure.done:
        ...         break
        >>> procedure.result
    """

    def __init__(self, start: Callable[[Array], Steps[T]], n: int) -> None:
        self._start, self._n = start, n
        self._steps: Steps[T] | None = None
        self._command: Command | None = None
        self._result: list[T] = []
        self.done = False

    def step(self, q: ArrayLike, *, dt: float | None = None) -> Command:
        """Return the command of this tick; once the procedure has ended, its last command.

        Args:
            q: Measured joint positions (n,) [rad].
            dt: Ignored, because a procedure has a fixed period. The argument lets
                `pliant.Tick.step` run a procedure like a controller.

        Raises:
            ShapeError: q is not n finite numbers.
            ServoError: The procedure failed, and has restored everything that it had changed.
        """
        try:
            q = vector(q, self._n, "q", "rad")
        except ShapeError:
            if self._steps is not None and np.shape(q) != (self._n,):
                self.close()  # end the procedure: another number of joints means another arm
            raise
        try:
            if self._steps is None:
                self._steps = self._start(q)
                self._command = next(self._steps)
            elif not self.done:
                self._command = self._steps.send(q)
        except StopIteration as end:
            self.done = True
            self._result = [end.value]
        if self._command is None:
            raise ServoError("the procedure ended before it gave a command")
        return self._command

    def close(self) -> None:
        """End the procedure early and restore everything that it had changed."""
        if self._steps is not None:
            self._steps.close()
        self.done = True

    @property
    def result(self) -> T:
        """Result of the procedure.

        Raises:
            ConfigError: The procedure has not ended yet.
        """
        if not self._result:
            raise ConfigError("this procedure has no result yet: call step(q) until it is done")
        return self._result[0]


class Guided(Generic[P, Q, T_co]):
    """Function that runs a procedure on an arm in a control loop.

    The method `procedure` returns the procedure instead, to be run in any other loop.
    """

    def __init__(self, function: Callable[P, T_co], make: Callable[Q, Procedure[T_co]]) -> None:
        """Wrap `function`, which runs a procedure, and `make`, which returns that procedure."""
        self._function, self._make = function, make
        update_wrapper(self, function)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T_co:
        """Run the procedure on an arm with the wrapped function, and return its result."""
        return self._function(*args, **kwargs)

    def procedure(self, *args: Q.args, **kwargs: Q.kwargs) -> Procedure[T_co]:
        """Return the procedure for your own loop; takes the same arguments except for the arm."""
        return self._make(*args, **kwargs)


def guided(make: Callable[Q, Procedure[T]]) -> Callable[[Callable[P, T]], Guided[P, Q, T]]:
    """Return a decorator that turns a function into a `Guided`.

    `make` returns the procedure that the decorated function runs.
    """
    return lambda function: Guided(function, make)


def run_procedure(
    arm: Arm,
    procedure: Procedure[T],
    loop: Iterable[Tick] | None = None,
    *,
    rate: float | None = None,
) -> T:
    """Run a procedure to its end and return its result.

    Args:
        arm: An object with `read` and `write`.
        procedure: The procedure.
        loop: Your own control loop, which yields its ticks. None: an arm with `advance()`, such as
            `pliant.sim.Plant`, is advanced once per tick; any other arm runs in a `pliant.Loop`.
        rate: Rate of the `pliant.Loop` [Hz]; None: the rate of the arm.

    Raises:
        TypeError: `arm` has no `read` or `write`.
        ServoError: The loop ended before the procedure, or the procedure failed.
    """
    if not (callable(getattr(arm, "read", None)) and callable(getattr(arm, "write", None))):
        raise TypeError(
            "arm must have read() and write(goal, limit), as what pliant.connect(…) and "
            f"pliant.sim.Plant(…) return, got {format_value(arm)}"
        )
    try:
        for tick in _ticks(arm, rate) if loop is None else loop:
            command = procedure.step(tick.q)
            tick.write(command)
            if procedure.done:
                return procedure.result
    finally:
        procedure.close()
    raise ServoError("the loop ended before the procedure did")


@dataclass(frozen=True)
class _PlantTick:
    q: Array
    arm: Arm

    def write(self, command: Command) -> None:
        self.arm.write(command.goal, command.torque_limit)


def _ticks(arm: Any, rate: float | None) -> Iterator[Tick]:
    """Yield the ticks of a `pliant.Loop`; for an arm with `advance()`, of a simulated loop."""
    if hasattr(arm, "advance"):
        while True:
            yield _PlantTick(np.asarray(arm.read().q), arm)
            arm.advance()
    else:
        from pliant.loop import Loop

        yield from Loop(arm, rate=rate)
