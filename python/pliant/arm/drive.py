"""The seam between an arm's life cycle and whatever moves its joints.

A drive moves *all* joints of an arm, those of the chain and those beside it (a gripper), in an
order of its own; `Arm` sorts them by name. It knows units and its bus, and nothing of kinematics,
gravity or policy.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from pliant import Servos

    Array = NDArray[np.float64]

#: Last stretch of a wait that is spun instead of slept [s]: sleeping wakes up this much late.
SPIN = 1e-4


@dataclass(frozen=True)
class Sample:
    """One reading of all N joints of a drive, in its order.

    Attributes:
        position: (N,) [rad]; anything where `ok` is False.
        ok: Which positions were read in this cycle (N,).
        time: When each was sampled, on the drive's clock: (N,), or one number for all [s].
        velocity: As the servos report them (N,) [rad/s].
        load: Torque that they exert by their own reckoning, PWM duty or current, no sensor
            (N,) [N·m].
        current: Of the motors (N,) [A]. What no servo says is None, what one does not say NaN.
    """

    position: Array
    ok: NDArray[np.bool_]
    time: Array | float
    velocity: Array | None = None
    load: Array | None = None
    current: Array | None = None


@dataclass(frozen=True)
class Health:
    """What the slow rota learned about one servo.

    Attributes:
        name: The joint.
        voltage: At the servo [V].
        temperature: Of the servo [°C].
        faults: What the servo reports, in sentences; empty when healthy.
        limit: Torque limit as it stands in the servo [N·m], None before it was read.
    """

    name: str
    voltage: float | None = None
    temperature: float | None = None
    faults: tuple[str, ...] = ()
    limit: float | None = None


class Sampled(Protocol):
    """Anything with the fields of a `Sample`."""

    @property
    def position(self) -> Array:
        """Positions (N,) [rad]."""

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Which were read (N,)."""

    @property
    def time(self) -> Array | float:
        """When [s]."""

    @property
    def velocity(self) -> Array | None:
        """Velocities (N,) [rad/s]."""

    @property
    def load(self) -> Array | None:
        """Torques (N,) [N·m]."""

    @property
    def current(self) -> Array | None:
        """Currents (N,) [A]."""


class Reported(Protocol):
    """Anything with the fields of a `Health`."""

    @property
    def name(self) -> str:
        """The joint."""

    @property
    def voltage(self) -> float | None:
        """At the servo [V]."""

    @property
    def temperature(self) -> float | None:
        """Of the servo [°C]."""

    @property
    def faults(self) -> tuple[str, ...]:
        """In sentences."""


class Clock(Protocol):
    """The time a drive lives in.

    One with `real_time` True passes whether or not somebody waits.
    """

    def now(self) -> float:
        """Time [s]; never goes back."""

    def wait_until(self, deadline: float) -> None:
        """Return at `deadline` [s], or at once where it has passed."""


class Drive(Protocol):
    """What `Arm` needs: all servos of an arm, in SI units.

    Further attributes are used where a drive has them: `clock` (default: the machine's), `latency`,
    the time from the end of a write to its effect [s]; `overload` (N,), the share of the usable
    torque above which a servo protects itself; `stall_current` (N,) [A], for the supply's budget;
    `enabled` (N,), which joints have torque already; `orders`, goals (N,) [rad] and limits (N,)
    [N·m] that stand in the servos, NaN where they are not known; `refusing` (N,), which joints are
    known not to take goals; `stiffness_known` (N,), which stiffnesses are known within 10 %, where
    that is not the same for all.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names, in the order of every vector."""

    @property
    def servos(self) -> Servos:
        """What drives them, one entry per name; once open, as the servos themselves say."""

    @property
    def counters(self) -> Mapping[str, int]:
        """What has happened so far, by name: retries, timeouts, ..."""

    def open(self) -> None:
        """Connect and identify.

        Raises:
            ServoError: What is wrong, and what to do.
        """

    def close(self) -> None:
        """Let go of the port; the servos keep their last goal and limit."""

    def read(self) -> Sampled:
        """Positions of this cycle, joint by joint; what did not arrive is not `ok`.

        Raises:
            ServoError: The connection is gone.
        """

    def write(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send goals (N,) [rad] and torque limits (N,) [N·m] to enabled joints.

        `velocity` (N,) [rad/s] is the fastest that a servo may go to its goal, for its speed
        register where it has one; inf, or None: as fast as it can.
        """

    def slow(self) -> Reported | None:
        """One step of the rota of voltages, temperatures and faults; None without news."""

    def enable(self, goal: Array, limit: Array) -> None:
        """Torque on: limit first, then the goal (the present position), then torque, then a look.

        A joint whose torque is on already keeps it on.

        Raises:
            ServoError: A joint moved or did not obey; torque is then as it was before.
        """

    def disable(self, names: Sequence[str]) -> None:
        """Torque off; every joint is tried even where one fails."""

    def watchdog(self, seconds: float) -> None:
        """Let the servos stop by themselves after a silence, where they can; 0 switches it off."""


class MonotonicClock:
    """The machine's clock. Waiting sleeps, other threads run, and spins the last 0.1 ms."""

    real_time = True

    def now(self) -> float:
        """Time [s]."""
        return time.perf_counter()

    def wait_until(self, deadline: float) -> None:
        """Sleep until `deadline` [s]."""
        rest = deadline - time.perf_counter() - SPIN
        if rest > 0.0:
            time.sleep(rest)
        while time.perf_counter() < deadline:
            pass
