"""Interface between an arm's life cycle and the hardware or simulation that moves its joints.

A drive moves *all* joints of an arm, on the chain and off it (a gripper), in its own order; `Arm`
matches them by name. A drive handles units and its bus. It does not handle kinematics, gravity or
control policy.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pliant._core import Servos
    from pliant._typing import Array, Mask


#: Last part of a wait that is spent in a busy loop [s], because sleep wakes up this late.
SPIN = 1e-4


@dataclass(frozen=True)
class JointReadings:
    """One reading of all N joints of a drive, in its order.

    Attributes:
        position: Positions (N,) [rad]; undefined where `ok` is False.
        ok: Which positions were read in this cycle (N,).
        time: Sample times on the drive's clock [s]: (N,), or one number for all.
        velocity: Velocities as the servos report them (N,) [rad/s]; None: not reported.
        load: Torques that the servos estimate from PWM duty or current (N,) [N·m]; None: not
            reported.
        current: Motor currents (N,) [A]; None: not reported.

    In `velocity`, `load` and `current`, NaN marks a servo that does not report the value.
    """

    position: Array
    ok: Mask
    time: Array | float
    velocity: Array | None = None
    load: Array | None = None
    current: Array | None = None


@dataclass(frozen=True)
class ServoStatus:
    """Status of one servo, read less often than positions: voltage, temperature, faults, limit.

    Attributes:
        name: Joint name.
        voltage: Supply voltage at the servo [V].
        temperature: Temperature of the servo [°C].
        faults: Faults that the servo reports, one sentence each; empty if healthy.
        limit: Torque limit read from the servo [N·m]; None before it was read.
    """

    name: str
    voltage: float | None = None
    temperature: float | None = None
    faults: tuple[str, ...] = ()
    limit: float | None = None


class Clock(Protocol):
    """Clock of a drive.

    If `real_time` is True, time passes on its own; otherwise it advances only in `wait_until`.
    """

    def now(self) -> float:
        """Return the time [s]; never decreases."""

    def wait_until(self, deadline: float) -> None:
        """Return at `deadline` [s], or at once if it has passed."""


class Drive(Protocol):
    """Interface that `Arm` needs: all servos of an arm, in SI units.

    Optional attributes:

    - `clock`: default is the monotonic clock of the machine;
    - `latency`: time from the end of a write to its effect [s];
    - `overload` (N,): share of the usable torque above which a servo's overload protection acts;
    - `stall_current` (N,) [A]: needed for the supply budget;
    - `enabled` (N,): joints whose torque is on already;
    - `orders`: goals (N,) [rad] and limits (N,) [N·m] stored in the servos, NaN if unknown;
    - `refusing` (N,): joints that are known not to accept goals;
    - `stiffness_known` (N,): joints whose stiffness is known within 10 %, if this differs by joint.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names, in the order of every vector."""

    @property
    def servos(self) -> Servos:
        """Servo parameters, one entry per name; `open` updates those that the servos report."""

    @property
    def counters(self) -> Mapping[str, int]:
        """Counters of bus events, such as retries and timeouts, by name."""

    def open(self) -> None:
        """Connect to the servos and check which models they are.

        Raises:
            ServoError: The cause and the remedy.
        """

    def close(self) -> None:
        """Close the port; the servos hold their last goal and limit."""

    def read(self) -> JointReadings:
        """Return the positions of this cycle; `ok` is False for joints that did not answer.

        Raises:
            ServoError: The connection is gone.
        """

    def write(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send goals (N,) [rad] and torque limits (N,) [N·m] to enabled joints.

        `velocity` (N,) [rad/s] limits the speed toward the goal, for servos with a speed register;
        inf, or None: no speed limit.
        """

    def poll_status(self) -> ServoStatus | None:
        """Return the status of the next servo in turn; None if none was read in this call."""

    def enable(self, goal: Array, limit: Array) -> None:
        """Switch torque on: limit, then goal = present position, then torque, then verify.

        A joint whose torque is on already keeps it on.

        Raises:
            ServoError: A joint moved or did not confirm; torque is then as it was before.
        """

    def disable(self, names: Sequence[str]) -> None:
        """Switch torque off; every joint is tried even if one fails."""

    def watchdog(self, seconds: float) -> None:
        """Set the time without messages after which servos stop [s]; 0 disables the watchdog.

        Servos without a watchdog ignore this.
        """


class MonotonicClock:
    """Monotonic clock of the machine. A wait sleeps, then busy-waits for the last 0.1 ms."""

    real_time = True

    def now(self) -> float:
        """Return the time [s]."""
        return time.perf_counter()

    def wait_until(self, deadline: float) -> None:
        """Return at `deadline` [s]."""
        rest = deadline - time.perf_counter() - SPIN
        if rest > 0.0:
            time.sleep(rest)
        while time.perf_counter() < deadline:
            pass


@dataclass(frozen=True)
class State:
    """State of an arm in one cycle, joints in chain order.

    `dq`, `load` and `current` are None if the servos do not report them.

    Attributes:
        q: Joint positions (n,) [rad]; a joint without a new position keeps its last accepted one.
        dq: Joint velocities as the servos report them (n,) [rad/s].
        time: Sample time of the oldest of the positions, on the arm's clock [s].
        fresh: Whether every joint's position is new in this cycle.
        extra: Positions of the joints off the chain (a gripper) by name [rad].
        age: Age of each position (n,) [s].
        load: Torque as each servo estimates it (n,) [N·m].
        current: Current of each servo (n,) [A].
        voltage: Supply voltage at each servo (n,) [V]; NaN before the first reading.
        temperature: Temperature of each servo (n,) [°C]; NaN before the first reading.
        faults: Present faults, one sentence each; empty if healthy.
    """

    q: Array
    dq: Array | None = None
    time: float = 0.0
    fresh: bool = True
    extra: Mapping[str, float] = field(default_factory=dict)
    age: Array = field(default_factory=lambda: np.zeros(0))
    load: Array | None = None
    current: Array | None = None
    voltage: Array | None = None
    temperature: Array | None = None
    faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Set the ages to 0 if they are not given."""
        if self.age.shape != self.q.shape:
            object.__setattr__(self, "age", np.zeros_like(self.q))
