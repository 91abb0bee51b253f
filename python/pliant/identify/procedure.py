"""Interface of a procedure and an arm: positions in, goals and torque limits out, tick by tick.

A procedure is a generator that starts with the first positions, yields commands, and receives the
next positions. `Procedure` wraps it as `step(q) -> Command`, which any loop can call;
`run_procedure` runs it to its end on a connected or simulated arm.
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


#: A generator that yields commands, receives positions (n,), and returns its result.
Steps = Generator[Command, "Array", T]


class Arm(Protocol):
    """Interface of an arm that a procedure needs, simulated or real."""

    def read(self) -> Any:
        """Return a state with positions `q` (n,)."""

    def write(self, goal: Any, limit: Any) -> None:
        """Send goals [rad] and torque limits [N·m]."""


class Tick(Protocol):
    """One tick of a loop that does its own waiting."""

    @property
    def q(self) -> Array:
        """Positions (n,) [rad]."""

    def write(self, command: Command) -> Any:
        """Send an order."""


class Procedure(Generic[T]):
    """A guided procedure that any loop can run.

    Args:
        start: Makes the generator for the first positions (n,) [rad].
        n: Number of joints.

    Attributes:
        done: True once it has ended; the last order then keeps holding the arm.

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
        """Return the order for the positions q (n,) [rad]; the last order once done.

        Args:
            q: Measured joint positions (n,) [rad].
            dt: Not used: a procedure has a fixed period. The argument lets `pliant.Tick.step` drive
                a procedure like a controller.

        Raises:
            ShapeError, ServoError: q is invalid, or the procedure failed. A failed procedure has
                restored everything that it had changed.
        """
        try:
            q = vector(q, self._n, "q", "rad")
        except ShapeError:
            if self._steps is not None and np.shape(q) != (self._n,):
                self.close()  # positions of another arm: no way to continue
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
            raise ServoError("the procedure ended before it gave an order")
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
    """A function that runs a procedure on an arm, with `procedure` to make only the procedure."""

    def __init__(self, function: Callable[P, T_co], make: Callable[Q, Procedure[T_co]]) -> None:
        """Store the function and its maker; called by `guided`."""
        self._function, self._make = function, make
        update_wrapper(self, function)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T_co:
        """Run it on the arm; arguments, result and errors as documented for the function."""
        return self._function(*args, **kwargs)

    def procedure(self, *args: Q.args, **kwargs: Q.kwargs) -> Procedure[T_co]:
        """Make the procedure for a loop of your own; takes the function's arguments but no arm."""
        return self._make(*args, **kwargs)


def guided(make: Callable[Q, Procedure[T]]) -> Callable[[Callable[P, T]], Guided[P, Q, T]]:
    """Return a decorator that adds the attribute `procedure`, made by `make`."""
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
        loop: Ticks of a loop that does its own waiting. None: an arm with `advance()`, such as the
            simulated one, is advanced; any other runs in a `pliant.Loop`.
        rate: Rate of that loop [Hz]; None for the arm's.

    Raises:
        TypeError: `arm` has no `read` or `write`. ServoError: The loop ended first. Also errors of
            the procedure and the loop.
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
    """Yield ticks of an arm, by `advance()` if it has one, else by a `Loop`."""
    if hasattr(arm, "advance"):
        while True:
            yield _PlantTick(np.asarray(arm.read().q), arm)
            arm.advance()
    else:
        from pliant.loop import Loop

        yield from Loop(arm, rate=rate)
