"""Interface `Drive` between `Arm` and the hardware or simulation that moves its joints.

A drive moves *all* joints of an arm: those of the controlled chain and others, such as a gripper.
It may order them as it likes, because `Arm` matches joints by name. A drive converts units and
handles the servo bus; it knows nothing of kinematics, gravity or control.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from pliant._core import JointReadings, State

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pliant._core import Servos
    from pliant._typing import Array

__all__ = ["Clock", "Drive", "JointReadings", "MonotonicClock", "ServoStatus", "State"]

#: Last part of a wait [s] that is a busy loop instead of a `sleep`, because `sleep` returns late.
SPIN = 8e-5


@dataclass(frozen=True, init=False)
class ServoStatus:
    """Status of one servo, read less often than positions: voltage, temperature, faults.

    Attributes:
        name: Joint name.
        voltage: Supply voltage at the servo [V].
        temperature: Temperature of the servo [°C].
        faults: Faults that the servo reports, one sentence each; empty if healthy.
        protections: Protections of the servo that have tripped since torque on, also those that a
            later command has reset, one text each: joint, id, cause.
    """

    name: str
    voltage: float | None = None
    temperature: float | None = None
    faults: tuple[str, ...] = ()
    protections: tuple[str, ...] = ()

    def __init__(
        self,
        name: str,
        voltage: float | None = None,
        temperature: float | None = None,
        faults: tuple[str, ...] = (),
        protections: tuple[str, ...] = (),
    ) -> None:
        # Faster than the constructor of a frozen dataclass: one call for all.
        self.__dict__.update(
            name=name,
            voltage=voltage,
            temperature=temperature,
            faults=faults,
            protections=protections,
        )


class Clock(Protocol):
    """Interface of the clock of a drive.

    If the optional attribute `real_time` is False, the clock is simulated: its time advances only
    in `wait_until`.
    """

    def now(self) -> float:
        """Return the present time of the clock [s], which never decreases."""

    def wait_until(self, deadline: float) -> None:
        """Wait until the clock shows `deadline` [s]; return immediately if it has passed."""


class Drive(Protocol):
    """Interface that `Arm` needs: all servos of an arm, in SI units.

    Optional attributes:

    - `clock`: default is the monotonic clock of the machine;
    - `latency`: time from the end of `write` until the servos use the new goals [s];
    - `overload` (N,): share of the usable torque above which a servo's overload protection acts;
    - `stall_current` (N,) [A]: current at stall, needed to keep the supply current below its limit;
    - `temperature_limit` (N,) [°C]: temperature at which a servo switches off;
    - `enabled` (N,): joints whose torque is on, also if another program switched it on, or unknown;
    - `torque_unknown` (N,): joints whose torque is unknown;
    - `unrestored` (N,): joints that keep torque limits and speeds of this program after `disable`;
    - `orders`: goals (N,) [rad] and torque limits (N,) [N·m] in the servos, NaN if unknown;
    - `refusing` (N,): joints that are known not to accept goals;
    - `accepts_lead`: True if `enable` has a third argument `lead`: goal minus position (N,) [rad]
      with which joints without torque start. Without it, joints sag by gravity torque over
      stiffness from `enable` to the first `write`;
    - `stiffness_known` (N,): joints whose stiffness is known within 10 %, if this differs by joint;
    - `outlives_program`: True if the servos keep their torque after the end of the program, and
      another process can then drive them. Such a drive also has three methods: `closed_copy()`
      returns a closed drive of the same servos for `pickle`; `reopen()` opens that copy and returns
      `orders`, and a second call asks the servos that did not answer; `drop_ports()` closes the
      ports in a forked process.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names (N,), in the order of all vectors of the drive."""

    @property
    def servos(self) -> Servos:
        """Servo parameters (N,), in the order of `names`; `open` updates those read from servos."""

    @property
    def counters(self) -> Mapping[str, int]:
        """Counters of bus events, such as retries and timeouts, by name."""

    def open(self) -> None:
        """Connect to the servos and check that their models are the configured ones.

        Raises:
            ServoError: A servo cannot be reached or used; the message gives cause and remedy.
        """

    def close(self) -> None:
        """Close the ports; torque stays as it is, and the servos keep their last goal and limit."""

    def read(self) -> JointReadings:
        """Read all joints; in the result, `ok` is False for joints that did not answer.

        Raises:
            ServoError: The connection is gone.
        """

    def write(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send goals (N,) [rad] and torque limits (N,) [N·m] to enabled joints.

        `velocity` (N,) [rad/s] is the largest speed toward the goal, for servos with a speed
        register; an entry inf, or None for all: no speed limit.
        """

    def poll_status(self) -> ServoStatus | None:
        """Read and return the status of one servo, in turn; None if no status was read."""

    def enable(self, goal: Array, limit: Array) -> None:
        """Switch the torque of all joints on, and check that every servo confirms it.

        Order of writes: torque limit, goal at the present position, torque on. A joint whose torque
        is already on keeps it on. `goal` (N,) [rad] holds the expected joint positions, and `limit`
        (N,) [N·m] the first torque limits.

        Raises:
            ServoError: A joint moved or did not confirm; torque that this call switched on has been
                switched off again.
        """

    def disable(self, names: Sequence[str]) -> None:
        """Switch the torque of the named joints off; if one fails, the others are still tried."""

    def watchdog(self, seconds: float) -> None:
        """Set the time without messages after which a servo stops [s]; 0 disables this watchdog.

        Servos without a watchdog are left unchanged.
        """


class MonotonicClock:
    """Monotonic clock of the system; a wait sleeps first and busy-waits for the last 0.08 ms."""

    real_time = True
    #: Return the present time of the system's monotonic clock [s].
    now = staticmethod(time.perf_counter)

    def wait_until(self, deadline: float) -> None:
        """Wait until the time is `deadline` [s]."""
        rest = deadline - time.perf_counter() - SPIN
        if rest > 0.0:
            time.sleep(rest)
        while time.perf_counter() < deadline:
            pass
