"""Effects of faults on a real bus: the table of docs/faults.md.

``python -m experiments.faults [part of a title]`` prints it. Everything runs over real bytes to
emulated servos with the simulated arm behind them, in emulated time.
"""

from __future__ import annotations

import sys
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import tyro

import pliant
from experiments import program
from experiments.emulated_arm import PATIENCE, stepped
from experiments.poses import displaced
from pliant.emulator.faults import KINDS
from pliant.loop import Loop
from pliant.sim.ground_truth import TOOL
from pliant.sim.hand import Drag, ForceProfile

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.poses import Array
    from pliant.arm import Arm
    from pliant.emulator import ArmEmulator
    from pliant.loop import Tick
    from pliant.sim import Plant
    from pliant.sim.ground_truth import GroundTruth

    Class = Literal["runs", "host loss", "no torque"]

#: Id of the elbow's servo, in the middle of the arm.
ELBOW = 4
#: Repetitions of a permanent fault.
ALWAYS = 10**9


class HostDiedError(Exception):
    """Stands for a killed host process: it ends control without any clean-up."""


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
class FaultCase:
    """A fault that occurs while the arm holds its pose.

    Attributes:
        title: Description.
        act: Called at every tick from the fault on. It returns the target, or None if it has
            already written a command.
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
    """Return an action that calls `do` in the first tick only; the target stays constant."""

    def act(scene: Scene) -> Array | None:
        if scene.first:
            do(scene)
        return scene.target

    return act


def _for(
    seconds: float, begin: Callable[[ArmEmulator], object], end: Callable[[ArmEmulator], object]
) -> Callable[[Scene], Array | None]:
    """Return an action that calls `begin` at once and `end` after `seconds` of emulated time."""

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

            # The fault may block the control loop, so the physics watches for its end.
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


FAULT_CASES: tuple[FaultCase, ...] = (
    FaultCase(title="no fault", act=lambda scene: scene.target),
    FaultCase(
        title="one reply with a wrong checksum",
        act=_once(lambda s: s.bus.faults.inject("corrupt", ELBOW)),
    ),
    FaultCase(
        title="20 % of all transactions fail for 1 s, in all ways",
        act=_for(
            1.0,
            lambda bus: bus.faults.by_chance(**dict.fromkeys(KINDS, 0.2 / len(KINDS))),
            lambda bus: bus.faults.by_chance(),
        ),
    ),
    FaultCase(
        title="replies one request late for 1 s",
        act=_for(
            1.0, lambda bus: bus.faults.by_chance(late=1.0), lambda bus: bus.faults.by_chance()
        ),
    ),
    FaultCase(
        title="the elbow's servo misses 8 requests in a row",
        act=_once(lambda s: s.bus.faults.inject("deaf", ELBOW, count=8)),
    ),
    FaultCase(
        title="it no longer answers, but has power",
        act=_once(lambda s: s.bus.faults.inject("lose", ELBOW, count=ALWAYS)),
    ),
    FaultCase(
        title="the line is shorted for 0.3 s",
        act=_for(0.3, lambda bus: bus.short(), lambda bus: bus.short(False)),
    ),
    FaultCase(
        title="the line is shorted for 1 s",
        act=_for(1.0, lambda bus: bus.short(), lambda bus: bus.short(False)),
    ),
    FaultCase(
        title="the line is shorted for good", act=_once(lambda s: s.bus.short()), state="host loss"
    ),
    FaultCase(
        title="the adapter is unplugged", act=_once(lambda s: s.bus.pull()), state="host loss"
    ),
    FaultCase(
        title="it is plugged in again, the program started again",
        act=_once(lambda s: s.bus.pull()),
        state="host loss",
        after=lambda bus: bus.put_back(),
    ),
    FaultCase(title="SIGKILL", act=_die, state="host loss"),
    FaultCase(title="SIGKILL, X series", act=_die, state="host loss", family="x"),
    FaultCase(title="SIGKILL, Bus Watchdog", act=_die, state="host loss", family="x", watchdog=0.2),
    FaultCase(title="the program stalls for 1 s", act=_stall),
    FaultCase(title="an exception, Ctrl-C, SIGTERM", act=_interrupt),
    FaultCase(title="a policy returns NaN for a target", act=_nan_target),
    FaultCase(title="a policy returns NaN for goals", act=_nan_command),
    *(
        FaultCase(title=f"the target jumps by 1 m for 1 s, {where}", act=_jump(axis, way))
        for where, axis, way in (
            ("forward (x)", "x", 1.0),
            ("back", "x", -1.0),
            ("up (z)", "z", 1.0),
            ("down", "z", -1.0),
            ("with the hand (y)", "y", 1.0),
            ("against it", "y", -1.0),
        )
    ),
    FaultCase(
        title="the firmware does not take the elbow's limit",
        act=_once(lambda s: s.bus.stick(ELBOW, "torque_limit", 1000)),
    ),
    FaultCase(
        title="another program writes a far goal to the elbow, once",
        act=_once(_far),
    ),
    FaultCase(
        title="overload of the elbow, EX-106+",
        act=_once(lambda s: s.bus.trip(ELBOW, "overload")),
    ),
    FaultCase(
        title="overload of the elbow, XM540",
        act=_once(lambda s: s.bus.trip(ELBOW, "overload")),
        state="no torque",
        family="x",
    ),
    FaultCase(
        title="overload of the elbow, STS3215",
        act=_once(lambda s: s.bus.trip(ELBOW, "overload")),
        family="sts",
    ),
    FaultCase(
        title="the elbow overheats",
        act=_once(lambda s: s.bus.trip(ELBOW, "heat")),
    ),
    FaultCase(
        title="the supply sags to 11.5 V",
        act=_once(lambda s: s.bus.supply(11.5)),
    ),
    FaultCase(
        title="the supply rises to 17 V, X series: all report it",
        act=_once(lambda s: s.bus.supply(17.0)),
        family="x",
    ),
    FaultCase(title="the elbow's torque goes off", act=_once(_off), state="no torque"),
    FaultCase(
        title="the elbow reboots", act=_once(lambda s: s.bus.reboot(ELBOW)), state="no torque"
    ),
    FaultCase(
        title="brown-out: all servos reboot",
        act=_once(lambda s: s.bus.brown_out()),
        state="no torque",
    ),
    FaultCase(
        title="the elbow's plug is pulled",
        act=_once(lambda s: s.bus.unplug(ELBOW)),
        state="no torque",
    ),
)


# --- Effects of faults on a real bus: the table of docs/faults.md ---

#: Time of the fault after torque on, further runtime of the program, and observation time of an arm
#: without a host [s].
WHEN, END, WATCHED = 1.2, 3.0, 4.0
#: The hand: delay [s], distance along y, the soft axis [m], duration [s].
TAKING, WAY, RISE = 0.2, 0.10, 2.0
#: Duration of a fall [s].
FALL = 1.5
#: Allowance for a moving arm on top of the force after a host loss [N].
MOVING = 3.0
#: Averaging time of forces, as in docs/lifecycle.md [s].
TICK = 0.01
#: Allowed excess over the cap, as in all judgements of caps.
BAND = 0.15
#: Loops of the arm's own, enabling and lowering [Hz].
RATE = 50.0


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a fault.

    Attributes:
        ending: `goes on`, `is lowered`, `keeps its last order` or `falls`.
        reason: The error that ended the loop, if any.
        speed: Highest speed of the tool from the fault until control ends, while an arm without a
            host is observed, and for at least 1.5 s where torque is lost [m/s].
        joint: Highest speed of a joint in the same time [rad/s].
        drop: Drop of the tool in the same time [m].
        lowered: Highest speed of the tool during the descent [m/s].
        force: Mean over a tick, 10 ms, of the force on the hand where it is farthest above
            `allowed`, or least below it [N]; 0 without a hand.
        allowed: Its bound at that time. While the host runs: the axis' cap plus 15 %, and the
            resistance of its joints at their speed, by dry friction, damping, and goals half a
            period old. Without a host: `host_loss_force` at its end + 3 N [N].
        torque: True if all torque was off in the end.
    """

    ending: str
    reason: str
    speed: float
    joint: float
    drop: float
    lowered: float
    force: float
    allowed: float
    torque: bool


@dataclass(frozen=True, kw_only=True)
class Allowed:
    """Bound of the force on a hand along y.

    Attributes:
        still: From joints at rest [N].
        drag: Additional force per speed of each joint (n,) [N·s/rad].
    """

    still: float = 0.0
    drag: Array | float = 0.0

    def at(self, dq: Array) -> float:
        """Return the bound for joints that turn with dq (n,) [rad/s]."""
        return self.still + float(np.sum(self.drag * np.abs(dq)))


class Watcher:
    """Observes the true state at every physics step of an emulator, from the fault on."""

    def __init__(self, bus: ArmEmulator, least: float = 0.0) -> None:
        """Insert itself between the world and its physics; observe for at least `least` seconds."""
        self.bus, self.begun, self.ended = bus, np.inf, np.inf
        self._least = least
        self.speeds: dict[bool, float] = {False: 0.0, True: 0.0}
        self.joint = self.force = 0.0
        self.allowed = Allowed()
        self._tick: deque[tuple[int, Array, float]] = deque()
        self.worst = (0.0, np.inf)
        self.start = self.lowest = 0.0
        self._step: Callable[[int], None] = bus.world.physics.step
        bus.world.physics.step = self.step  # type: ignore[method-assign]

    def begin(self) -> None:
        """Start to observe, at the time of the fault."""
        self.begun = self.bus.plant.time
        self.start = self.lowest = float(self.bus.plant.tool[2, 3])

    def end(self) -> None:
        """Note that control has ended."""
        self.ended = max(self.bus.plant.time, self.begun + self._least)

    def _felt(self, count: int) -> tuple[float, float]:
        """Return the largest force of a hand and its bound, both means over the last tick [N]."""
        plant = self.bus.plant
        forces = np.array([felt.force for felt in plant.hands]).reshape(-1, 3)
        if self._tick and self._tick[0][1].shape != forces.shape:
            self._tick.clear()
        self._tick.append((count, forces, self.allowed.at(plant.dq)))
        while sum(c for c, _, _ in self._tick) - self._tick[0][0] >= TICK / plant.dt - 1e-6:
            self._tick.popleft()
        counts = np.array([c for c, _, _ in self._tick])
        if counts.sum() < TICK / plant.dt - 1e-6:
            return 0.0, np.inf
        share = counts / counts.sum()
        mean = np.tensordot(share, np.array([f for _, f, _ in self._tick]), axes=1)
        sizes = [0.0, *np.linalg.norm(mean, axis=1)]
        return float(max(sizes)), float(share @ [a for _, _, a in self._tick])

    def step(self, count: int) -> None:
        """Advance the physics by `count` steps; record the tool's speed and the hand's force."""
        self._step(count)
        plant = self.bus.plant
        if plant.time <= self.begun:
            return
        speed = float(np.linalg.norm(plant.ground_truth.frame("tool").twist()[:3]))
        late = plant.time > self.ended
        self.speeds[late] = max(self.speeds[late], speed)
        force, allowed = self._felt(count)
        self.force = max(self.force, force)
        if force > 0.0 and force - allowed > self.worst[0] - self.worst[1]:
            self.worst = (force, allowed)
        if not late:
            self.joint = max(self.joint, float(np.abs(plant.dq).max()))
            self.lowest = min(self.lowest, float(plant.tool[2, 3]))


def run_fault(
    case: FaultCase, *, held: bool = False, when: float = WHEN, patience: float = PATIENCE
) -> Outcome:
    """Let `arm7` hold its grasp pose, y soft, at 100 Hz over real bytes, and apply a fault.

    Args:
        case: The fault.
        held: True: a hand pulls the tool 0.10 m along y from then on; the arm is then not lowered.
        when: Time of the fault after torque on [s].
        patience: Minimum reply timeout, by the wall clock [s]; where no reply is lost, a long one
            makes the result independent of the computer's load.
    """
    options: dict[str, Any] = {"rate": RATE, "watchdog": case.watchdog}
    with stepped(case.family, arm=options, patience=patience) as (bus, arm):
        watcher = Watcher(bus, FALL if case.state == "no torque" else 0.0)
        reason, torque = _run(case, bus, arm, watcher, held=held, when=when)
    speed, lowered = watcher.speeds[False], watcher.speeds[True]
    ending = "goes on" if not reason else "keeps its last order" if torque else "is lowered"
    if case.state == "no torque" and reason:
        ending = "falls, the rest " + ending.removeprefix("keeps its last order, ")
    return Outcome(
        ending=ending,
        reason=reason,
        speed=speed,
        joint=watcher.joint,
        drop=max(watcher.start - watcher.lowest, 0.0),
        lowered=lowered,
        force=watcher.worst[0],
        allowed=watcher.worst[1] if watcher.worst[0] > 0.0 else watcher.allowed.still,
        torque=torque,
    )


def _run(
    case: FaultCase, bus: ArmEmulator, arm: Arm, watcher: Watcher, *, held: bool, when: float
) -> tuple[str, bool]:
    """Run the control loop; return the reason of its end, and True if torque is still on."""
    arm.enable()
    settings = pliant.Settings.soft("y")
    controller = pliant.Controller(arm.model, settings, arm.servos)
    target = arm.model.forward_kinematics(arm.read().q)
    reason = ""
    try:
        for tick in Loop(arm, controller, rate=settings.rate, duration=when + END):
            wanted: Array | None = target
            if bus.plant.time >= when:
                first = watcher.begun == np.inf
                if first or case.state != "host loss":
                    watcher.allowed = _allowed(controller, case, bus.plant)
                if first:
                    watcher.begin()
                    if held:
                        bus.plant.set_hands([Grasp(when + TAKING)])
                since = bus.plant.time - watcher.begun
                wanted = case.act(Scene(bus, arm, tick, target, since, first))
            if wanted is not None:
                tick.write(controller.step(tick.q, wanted, dt=tick.dt))
    except HostDiedError:
        reason = "killed"
    except (pliant.PliantError, KeyboardInterrupt) as error:
        reason = str(error) or type(error).__name__
    if reason == "killed" or case.state == "host loss":
        bus.advance(WATCHED)
    if case.after is not None:
        case.after(bus)
        arm.drive.close()
        arm._supervisor.owner, arm._opened = None, False
        arm.enable()
        watcher.end()
        arm.lower()
    elif reason != "killed" and not held:
        watcher.end()
        try:
            arm.lower()
        except pliant.PliantError as error:
            reason = f"{reason}; {error}"
    torque = any(servo.get("torque_enable") for servo in bus.servos)
    # The force of the arm on a hand as its torque goes off is caused by this experiment.
    watcher.begun = np.inf
    with suppress(pliant.PliantError):
        arm.disable_torque()
    return reason, torque


class Grasp:
    """A hand that takes hold of the tool at its present position, and pulls it along y.

    A hand placed beside a moving tool would pull it back to its earlier position.
    """

    at = TOOL

    def __init__(self, since: float) -> None:
        """Make a hand that takes hold of the tool at `since` [s]."""
        self._since = since
        self._hand: Drag | None = None

    def force(self, ground_truth: GroundTruth, t: float) -> tuple[Array, Array, Array]:
        """Return the hand's force, torque and point of application; see `pliant.sim.Hand`."""
        if self._hand is None and t >= self._since:
            self._hand = Drag(
                axis="y",
                distance=WAY,
                stiffness=3000.0,
                damping=30.0,
                limit=300.0,
                at=TOOL,
                course=ForceProfile(start=t, rise=RISE, end=np.inf),
                offset=float(ground_truth.frame(TOOL).shift()[1]),
            )
        if self._hand is None:
            return np.zeros(3), np.zeros(3), ground_truth.frame(TOOL).position
        return self._hand.force(ground_truth, t)


def _allowed(controller: pliant.Controller, case: FaultCase, plant: Plant) -> Allowed:
    """Return the bound of the force on a hand along y from now on.

    The cap is that of the present deviation. Dry friction of turning joints adds `Σ_i |J⁺_iy|
    τ_f,i`, as in the report but with the true gears: the emulator's have twice the friction of the
    servos' tables. `Σ_i |J⁺_iy| (d_i + k_p,i T/2) |dq_i|` is their drag: damping, and goals that
    are half a period T old on average. Feed-forward compensates much of the first two.
    """
    report = controller.report()
    y = list(report.axes).index("y")
    if case.state == "host loss":
        return Allowed(still=max(report.axes["y"].host_loss_force) + MOVING)
    lever = np.abs(
        np.linalg.pinv(controller.model.jacobian(controller.diagnostics.q_predicted))[:, y]
    )
    friction, damping = _gears(plant)
    assert controller.servos is not None
    old = 0.5 / controller.settings.rate * np.asarray(controller.servos.kp)
    return Allowed(
        still=float((1.0 + BAND) * controller.diagnostics.axis_strength[y] + lever @ friction),
        drag=lever * (damping + old),
    )


def _gears(plant: Plant) -> tuple[Array, Array]:
    """Return true dry friction [N·m] and damping [N·m·s/rad] of joints and servos (n,)."""
    joints = plant.model.joint_names
    dofs = [plant.mj_model.joint(name).dofadr[0] for name in joints]
    servos = np.array([-plant.mj_model.actuator(name).biasprm[2] for name in joints])
    return plant.mj_model.dof_frictionloss[dofs], plant.mj_model.dof_damping[dofs] + servos


def table(only: str = "") -> str:
    """Return the table, as Markdown, of faults whose title contains `only`."""
    columns = (
        "what happens",
        "the arm",
        "tool [m/s]",
        "joint [rad/s]",
        "drop [mm]",
        "lowered at [m/s]",
        "hand feels [N]",
        "allowed [N]",
    )
    rows = []
    for case in FAULT_CASES:
        if only in case.title:
            rows.append(row(case, run_fault(case), run_fault(case, held=True)))
            print(program.row(rows[-1]), file=sys.stderr, flush=True)
    return program.markdown(columns, rows)


def row(case: FaultCase, alone: Outcome, held: Outcome) -> tuple[str, ...]:
    """Return one row."""
    drop, lowered = f"{1e3 * alone.drop:.1f}", f"{alone.lowered:.2f}"
    feels, allowed = f"{held.force:.1f}", f"{held.allowed:.1f}"
    speeds = f"{alone.speed:.2f}", f"{alone.joint:.2f}"
    return (case.title, alone.ending, *speeds, drop, lowered, feels, allowed)


def main(title: tyro.conf.Positional[str] = "") -> None:
    """Print the table.

    Args:
        title: Faults whose title contains this.
    """
    print(table(title))


if __name__ == "__main__":
    program.start(main)
