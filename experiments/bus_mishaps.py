"""Faults of buses, servos, hosts and programs on an arm over real bytes."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Literal

import numpy as np

from experiments.setups import displaced
from pliant.emulator.faults import KINDS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pliant.arm import Arm
    from pliant.emulator import ArmEmulator
    from pliant.loop import Tick

    Array = NDArray[np.float64]
    Class = Literal["runs", "host loss", "no torque"]

#: Id of the elbow's servo, in the middle of the arm.
ELBOW = 4
#: Repetitions of a permanent fault.
ALWAYS = 10**9


class HostDiedError(Exception):
    """The process is killed: none of its code runs any more."""


@dataclass(frozen=True)
class Scene:
    """Objects that a fault may act on.

    Attributes:
        bus: The emulator.
        arm: The arm.
        tick: The present tick.
        target: Pose (4, 4) to hold.
        since: Time since the fault began [s].
        first: True in its first tick.
    """

    bus: ArmEmulator
    arm: Arm
    tick: Tick
    target: Array
    since: float
    first: bool


@dataclass(frozen=True, kw_only=True)
class Mishap:
    """A fault that occurs while the arm holds its pose.

    Attributes:
        title: Description.
        act: Called at every tick from then on; returns the target, or None where it has written.
        family: Affected servos.
        state: `runs`: servos have power and torque, and a host; `host loss`: no host; `no torque`:
            a servo has lost power or torque.
        after: Called when control has ended, before time advances.
        watchdog: Of the arm [s].
    """

    title: str
    act: Callable[[Scene], Array | None]
    family: str = "p1"
    state: Class = "runs"
    after: Callable[[ArmEmulator], None] | None = None
    watchdog: float = 0.0


def _once(do: Callable[[Scene], object]) -> Callable[[Scene], Array | None]:
    """Act in the first tick, and hold the pose in all."""

    def act(scene: Scene) -> Array | None:
        if scene.first:
            do(scene)
        return scene.target

    return act


def _for(
    seconds: float, begin: Callable[[ArmEmulator], object], end: Callable[[ArmEmulator], object]
) -> Callable[[Scene], Array | None]:
    """Start something, and end it after so much emulated time."""

    def act(scene: Scene) -> Array | None:
        if scene.first:
            begin(scene.bus)
            physics, until = scene.bus.world.physics, scene.bus.time + seconds
            step = physics.step

            def stepping(count: int) -> None:
                step(count)
                if scene.bus.time >= until:
                    end(scene.bus)
                    physics.step = step  # type: ignore[method-assign]

            physics.step = stepping  # type: ignore[method-assign]
        return scene.target

    return act


def _die(scene: Scene) -> Array:
    raise HostDiedError


def _interrupt(scene: Scene) -> Array:
    raise KeyboardInterrupt


def _stall(scene: Scene) -> Array:
    if scene.first:
        scene.arm.clock.wait_until(scene.arm.clock.now() + 1.0)
    return scene.target


def _nan_target(scene: Scene) -> Array:
    return np.full((4, 4), np.nan)


def _nan_command(scene: Scene) -> None:
    nothing = np.full(scene.tick.q.size, np.nan)
    scene.tick.write(SimpleNamespace(goal=nothing, torque_limit=nothing))


def _jump(axis: str, way: float) -> Callable[[Scene], Array | None]:
    """Move the target `way` [m] along an axis for a second."""

    def act(scene: Scene) -> Array | None:
        return displaced(scene.target, axis, way) if scene.since < 1.0 else scene.target

    return act


def _off(scene: Scene) -> None:
    scene.bus.servo(ELBOW).put("torque_enable", 0)


def _far(scene: Scene) -> None:
    scene.bus.servo(ELBOW).put("goal_position", 100)


MISHAPS: tuple[Mishap, ...] = (
    Mishap(title="no fault", act=lambda scene: scene.target),
    Mishap(
        title="one reply with a wrong checksum",
        act=_once(lambda s: s.bus.faults.inject("corrupt", ELBOW)),
    ),
    Mishap(
        title="20 % of all transactions fail for 1 s, in all ways",
        act=_for(
            1.0,
            lambda bus: bus.faults.by_chance(**dict.fromkeys(KINDS, 0.2 / len(KINDS))),
            lambda bus: bus.faults.by_chance(),
        ),
    ),
    Mishap(
        title="replies one request late for 1 s",
        act=_for(
            1.0, lambda bus: bus.faults.by_chance(late=1.0), lambda bus: bus.faults.by_chance()
        ),
    ),
    Mishap(
        title="the elbow's servo misses 8 requests in a row",
        act=_once(lambda s: s.bus.faults.inject("deaf", ELBOW, count=8)),
    ),
    Mishap(
        title="it no longer answers, but has power",
        act=_once(lambda s: s.bus.faults.inject("lose", ELBOW, count=ALWAYS)),
    ),
    Mishap(
        title="the line is shorted for 0.3 s",
        act=_for(0.3, lambda bus: bus.short(), lambda bus: bus.short(False)),
    ),
    Mishap(
        title="the line is shorted for 1 s",
        act=_for(1.0, lambda bus: bus.short(), lambda bus: bus.short(False)),
    ),
    Mishap(
        title="the line is shorted for good", act=_once(lambda s: s.bus.short()), state="host loss"
    ),
    Mishap(title="the adapter is unplugged", act=_once(lambda s: s.bus.pull()), state="host loss"),
    Mishap(
        title="it is plugged in again, the program started again",
        act=_once(lambda s: s.bus.pull()),
        state="host loss",
        after=lambda bus: bus.put_back(),
    ),
    Mishap(title="SIGKILL", act=_die, state="host loss"),
    Mishap(title="SIGKILL, X series", act=_die, state="host loss", family="x"),
    Mishap(title="SIGKILL, Bus Watchdog", act=_die, state="host loss", family="x", watchdog=0.2),
    Mishap(title="the program stalls for 1 s", act=_stall),
    Mishap(title="an exception, Ctrl-C, SIGTERM", act=_interrupt),
    Mishap(title="a policy returns NaN for a target", act=_nan_target),
    Mishap(title="a policy returns NaN for goals", act=_nan_command),
    *(
        Mishap(title=f"the target jumps by 1 m for 1 s, {where}", act=_jump(axis, way))
        for where, axis, way in (
            ("forward (x)", "x", 1.0),
            ("back", "x", -1.0),
            ("up (z)", "z", 1.0),
            ("down", "z", -1.0),
            ("with the hand (y)", "y", 1.0),
            ("against it", "y", -1.0),
        )
    ),
    Mishap(
        title="the firmware does not take the elbow's limit",
        act=_once(lambda s: s.bus.stick(ELBOW, "torque_limit", 1000)),
    ),
    Mishap(
        title="another program writes a far goal to the elbow, once",
        act=_once(_far),
    ),
    Mishap(
        title="overload of the elbow, EX-106+",
        act=_once(lambda s: s.bus.trip(ELBOW, "overload")),
    ),
    Mishap(
        title="overload of the elbow, XM540",
        act=_once(lambda s: s.bus.trip(ELBOW, "overload")),
        state="no torque",
        family="x",
    ),
    Mishap(
        title="overload of the elbow, STS3215",
        act=_once(lambda s: s.bus.trip(ELBOW, "overload")),
        family="sts",
    ),
    Mishap(
        title="the elbow overheats",
        act=_once(lambda s: s.bus.trip(ELBOW, "heat")),
    ),
    Mishap(
        title="the supply sags to 11.5 V",
        act=_once(lambda s: s.bus.supply(11.5)),
    ),
    Mishap(
        title="the supply rises to 17 V, X series: all report it",
        act=_once(lambda s: s.bus.supply(17.0)),
        family="x",
    ),
    Mishap(title="the elbow's torque goes off", act=_once(_off), state="no torque"),
    Mishap(title="the elbow reboots", act=_once(lambda s: s.bus.reboot(ELBOW)), state="no torque"),
    Mishap(
        title="brown-out: all servos reboot",
        act=_once(lambda s: s.bus.brown_out()),
        state="no torque",
    ),
    Mishap(
        title="the elbow's plug is pulled",
        act=_once(lambda s: s.bus.unplug(ELBOW)),
        state="no torque",
    ),
)
