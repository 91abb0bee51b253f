"""Effects of faults of servos, bus and program on an arm: ``python -m experiments.faults``.

The program prints the table of docs/faults.md. The arm has emulated servos on a serial port, and
runs in emulated time. With an argument, only the faults whose title contains it are run.
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
from experiments import command_line, markdown
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
#: Number of repetitions of an injected fault that is permanent.
ALWAYS = 10**9


class HostLossError(Exception):
    """Simulates a killed host process: ends the control loop without lowering the arm."""


@dataclass(frozen=True)
class Scene:
    """Argument of a fault's action: objects that the action may change, and the present time.

    Attributes:
        bus: The emulator.
        arm: The arm.
        tick: The present tick.
        target: Target pose (4, 4) without a fault.
        since: Time since the start of the fault [s].
        first: True in the first tick of the fault.
    """

    bus: ArmEmulator
    arm: Arm
    tick: Tick
    target: Array
    since: float
    first: bool


@dataclass(frozen=True, kw_only=True)
class FaultCase:
    """Fault that occurs while the arm holds its pose.

    Attributes:
        title: Description in the table.
        act: Function that is called in every tick from the start of the fault. It returns the
            target pose (4, 4), or None if it has already written a command.
        family: Servo family of the emulated arm: `p1`, `x` or `sts`.
        state: `runs`: host and servos work; `host loss`: no host; `no torque`: a servo has lost
            power or torque.
        after: Function that is called after the control loop has ended; the arm is then enabled
            again and lowered. None: nothing is called.
        watchdog: Timeout of the servos' bus watchdog [s]; 0: no watchdog.
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


def _for_duration(
    seconds: float, begin: Callable[[ArmEmulator], object], end: Callable[[ArmEmulator], object]
) -> Callable[[Scene], Array | None]:
    """Return an action that calls `begin` immediately, and `end` after emulated `seconds`."""

    def act(scene: Scene) -> Array | None:
        if scene.first:
            begin(scene.bus)
            watchers, until = scene.bus.world.watchers, scene.bus.time + seconds

            def watch(_: int) -> None:
                if scene.bus.time >= until:
                    watchers.remove(watch)
                    end(scene.bus)

            # End the fault in a callback of the physics: the fault may block the control loop.
            watchers.append(watch)
        return scene.target

    return act


def _kill_host(scene: Scene) -> Array:
    raise HostLossError


def _press_ctrl_c(scene: Scene) -> Array:
    raise KeyboardInterrupt


def _stall_program(scene: Scene) -> Array:
    if scene.first:
        scene.arm.clock.wait_until(scene.arm.clock.now() + 1.0)
    return scene.target


def _nan_target(scene: Scene) -> Array:
    return np.full((4, 4), np.nan)


def _nan_command(scene: Scene) -> None:
    nothing = np.full(scene.tick.q.size, np.nan)
    scene.tick.write(SimpleNamespace(goal=nothing, torque_limit=nothing))


def _jump_target(axis: str, distance: float) -> Callable[[Scene], Array | None]:
    """Return an action that displaces the target by `distance` [m] along an axis for one second."""

    def act(scene: Scene) -> Array | None:
        return displaced(scene.target, axis, distance) if scene.since < 1.0 else scene.target

    return act


def _switch_torque_off(scene: Scene) -> None:
    scene.bus.servo(ELBOW).put("torque_enable", 0)


def _write_far_goal(scene: Scene) -> None:
    scene.bus.servo(ELBOW).put("goal_position", 100)


FAULT_CASES: tuple[FaultCase, ...] = (
    FaultCase(title="no fault", act=lambda scene: scene.target),
    FaultCase(
        title="one reply with a wrong checksum",
        act=_once(lambda s: s.bus.faults.inject("corrupt", ELBOW)),
    ),
    FaultCase(
        title="20 % of all transactions fail for 1 s, in all ways",
        act=_for_duration(
            1.0,
            lambda bus: bus.faults.by_chance(**dict.fromkeys(KINDS, 0.2 / len(KINDS))),
            lambda bus: bus.faults.by_chance(),
        ),
    ),
    FaultCase(
        title="replies one request late for 1 s",
        act=_for_duration(
            1.0, lambda bus: bus.faults.by_chance(late=1.0), lambda bus: bus.faults.by_chance()
        ),
    ),
    FaultCase(
        title="the elbow's servo misses 8 requests in a row",
        act=_once(lambda s: s.bus.faults.inject("deaf", ELBOW, count=8)),
    ),
    FaultCase(
        title="the elbow's servo no longer answers, but has power",
        act=_once(lambda s: s.bus.faults.inject("lose", ELBOW, count=ALWAYS)),
    ),
    FaultCase(
        title="the line is shorted for 0.3 s",
        act=_for_duration(0.3, lambda bus: bus.short(), lambda bus: bus.short(False)),
    ),
    FaultCase(
        title="the line is shorted for 1 s",
        act=_for_duration(1.0, lambda bus: bus.short(), lambda bus: bus.short(False)),
    ),
    FaultCase(
        title="the line is shorted for good", act=_once(lambda s: s.bus.short()), state="host loss"
    ),
    FaultCase(
        title="the adapter is unplugged", act=_once(lambda s: s.bus.pull()), state="host loss"
    ),
    FaultCase(
        title="the adapter is plugged in again, the program started again",
        act=_once(lambda s: s.bus.pull()),
        state="host loss",
        after=lambda bus: bus.put_back(),
    ),
    FaultCase(title="SIGKILL", act=_kill_host, state="host loss"),
    FaultCase(title="SIGKILL, X series", act=_kill_host, state="host loss", family="x"),
    FaultCase(
        title="SIGKILL, Bus Watchdog", act=_kill_host, state="host loss", family="x", watchdog=0.2
    ),
    FaultCase(title="the program stalls for 1 s", act=_stall_program),
    FaultCase(title="an exception, Ctrl-C, SIGTERM", act=_press_ctrl_c),
    FaultCase(title="a policy returns NaN for a target", act=_nan_target),
    FaultCase(title="a policy returns NaN for goals", act=_nan_command),
    *(
        FaultCase(title=f"the target jumps by 1 m for 1 s, {where}", act=_jump_target(axis, way))
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
        act=_once(_write_far_goal),
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
    FaultCase(
        title="the elbow's torque goes off", act=_once(_switch_torque_off), state="no torque"
    ),
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


# --- Measurement of the effects ---

#: Time from the start of the emulation to the fault [s], duration of the control loop minus `WHEN`
#: [s], and time for which the arm is observed after a host loss [s].
WHEN, END, OBSERVATION = 1.2, 3.0, 4.0
#: Hand that pulls the tool along the soft axis y: delay after the fault [s], distance [m] and
#: duration [s] of the pull.
HAND_DELAY, HAND_DISTANCE, RISE = 0.2, 0.10, 2.0
#: Observation time of an arm that has lost torque [s].
FALL = 1.5
#: Allowance for damping and inertia of the moving arm, added to the static bound on the force after
#: a host loss [N].
MOTION_ALLOWANCE = 3.0
#: Averaging time of forces, as in docs/descents.md [s].
TICK = 0.01
#: Allowed excess of a force over the cap, as a share of the cap.
BAND = 0.15
#: Rate of the loops in which `Arm.enable` and `Arm.lower` control the arm [Hz].
RATE = 50.0


@dataclass(frozen=True, kw_only=True)
class FaultResult:
    """Result of a fault.

    Attributes:
        ending: Final state in the table: `goes on`, `is lowered`, `keeps its last order` or
            `falls, ...`.
        reason: Error that ended the loop; empty if none did.
        speed: Largest speed of the tool from the fault to the end of the loop, including the
            observation after a host loss or a loss of torque [m/s].
        joint: Largest speed of a joint, in the time of `speed` [rad/s].
        drop: Drop of the tool below its height at the fault, in the time of `speed` [m].
        lowered: Largest speed of the tool during the descent by `Arm.lower` [m/s].
        force: Force on the hand, averaged over 10 ms, when it exceeds its bound most [N]; 0 without
            a hand.
        allowed: Bound on the force at the time of `force` [N], see `Allowed`.
        torque: True if a servo still has torque at the end.
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
    """Bound on the force on a hand that pulls the tool along y.

    Attributes:
        still: Bound while all joints are at rest [N].
        drag: Increase of the bound by the speed of each joint (n,) [N·s/rad].
    """

    still: float = 0.0
    drag: Array | float = 0.0

    def at(self, dq: Array) -> float:
        """Return the bound at joint velocities dq (n,) [rad/s]."""
        return self.still + float(np.sum(self.drag * np.abs(dq)))


class PeakRecorder:
    """Records the largest speeds and forces over the physics steps of an emulator from `begin` on.

    Attributes:
        start, lowest: Height of the tool at `begin`, and its smallest height until `end` [m].
        speeds: Largest speed of the tool until `end` (key False) and after it (key True) [m/s].
        joint: Largest speed of a joint until `end` [rad/s].
        force: Largest force of a hand, averaged over `TICK` [N].
        allowed: Present bound on the force of a hand.
        worst: Force and bound at the largest excess of the force over its bound [N].
    """

    def __init__(self, bus: ArmEmulator, least: float = 0.0) -> None:
        """Record after each physics step of the emulator.

        The time from `begin` to `end` counts as at least `least` [s].
        """
        self.bus, self.begun, self.ended = bus, np.inf, np.inf
        self._least = least
        self.speeds: dict[bool, float] = {False: 0.0, True: 0.0}
        self.joint = self.force = 0.0
        self.allowed = Allowed()
        self._tick: deque[tuple[int, Array, float]] = deque()
        self.worst = (0.0, np.inf)
        self.start = self.lowest = 0.0
        bus.world.watchers.append(self._record)

    def begin(self) -> None:
        """Start the record at the present time, for example the time of a fault."""
        self.begun = self.bus.plant.time
        self.start = self.lowest = float(self.bus.plant.tool[2, 3])

    def end(self) -> None:
        """Record the present time as the end of the control loop, before the descent."""
        self.ended = max(self.bus.plant.time, self.begun + self._least)

    def _force_and_bound(self, count: int) -> tuple[float, float]:
        """Return the largest force of a hand and the bound on it [N], averaged over `TICK`.

        `count` is the number of physics steps since the last call.
        """
        plant = self.bus.plant
        forces = np.array([hand.force for hand in plant.hands]).reshape(-1, 3)
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

    def _record(self, count: int) -> None:
        """Update the recorded peaks after `count` physics steps."""
        plant = self.bus.plant
        if plant.time <= self.begun:
            return
        speed = float(np.linalg.norm(plant.ground_truth.frame("tool").twist()[:3]))
        is_after = plant.time > self.ended
        self.speeds[is_after] = max(self.speeds[is_after], speed)
        force, bound = self._force_and_bound(count)
        self.force = max(self.force, force)
        if force > 0.0 and force - bound > self.worst[0] - self.worst[1]:
            self.worst = (force, bound)
        if not is_after:
            self.joint = max(self.joint, float(np.abs(plant.dq).max()))
            self.lowest = min(self.lowest, float(plant.tool[2, 3]))


def run_fault(
    case: FaultCase, *, held: bool = False, when: float = WHEN, patience: float = PATIENCE
) -> FaultResult:
    """Apply a fault to `arm7`, which holds its pose with soft y at 100 Hz; return the result.

    Args:
        case: The fault.
        held: True: after the fault, a hand pulls the tool 0.10 m along y, and the arm is not
            lowered.
        when: Time from the start of the emulation to the fault [s].
        patience: Minimum time that the driver waits for a reply, by the wall clock [s]; a long one
            makes the result independent of the computer's load.
    """
    options: dict[str, Any] = {"rate": RATE, "watchdog": case.watchdog}
    with stepped(case.family, arm=options, patience=patience) as (bus, arm):
        recorder = PeakRecorder(bus, FALL if case.state == "no torque" else 0.0)
        reason, torque = _run_loop(case, bus, arm, recorder, held=held, when=when)
    speed, descent_speed = recorder.speeds[False], recorder.speeds[True]
    ending = "goes on" if not reason else "keeps its last order" if torque else "is lowered"
    if case.state == "no torque" and reason:
        ending = "falls, the rest " + ending.removeprefix("keeps its last order, ")
    return FaultResult(
        ending=ending,
        reason=reason,
        speed=speed,
        joint=recorder.joint,
        drop=max(recorder.start - recorder.lowest, 0.0),
        lowered=descent_speed,
        force=recorder.worst[0],
        allowed=recorder.worst[1] if recorder.worst[0] > 0.0 else recorder.allowed.still,
        torque=torque,
    )


def _run_loop(
    case: FaultCase, bus: ArmEmulator, arm: Arm, recorder: PeakRecorder, *, held: bool, when: float
) -> tuple[str, bool]:
    """Run the control loop with the fault, then lower the arm.

    The arm is not lowered after a killed host or with a hand (`held`), except if the program is
    started again.

    Returns:
        Text of the error that ended the loop, empty if none did; and True if a servo has torque at
        the end.
    """
    arm.enable()
    settings = pliant.Settings.soft("y")
    controller = pliant.Controller(arm.model, settings, arm.servos)
    target = arm.model.forward_kinematics(arm.read().q)
    reason = ""
    try:
        for tick in Loop(arm, controller, rate=settings.rate, duration=when + END):
            goal: Array | None = target
            if bus.plant.time >= when:
                first = recorder.begun == np.inf
                if first or case.state != "host loss":
                    recorder.allowed = _allowed(controller, case, bus.plant)
                if first:
                    recorder.begin()
                    if held:
                        bus.plant.set_hands([Grasp(when + HAND_DELAY)])
                time_since = bus.plant.time - recorder.begun
                goal = case.act(Scene(bus, arm, tick, target, time_since, first))
            if goal is not None:
                tick.write(controller.step(tick.q, goal, dt=tick.dt))
    except HostLossError:
        reason = "killed"
    except (pliant.PliantError, KeyboardInterrupt) as error:
        reason = str(error) or type(error).__name__
    if reason == "killed" or case.state == "host loss":
        bus.advance(OBSERVATION)
    if case.after is not None:
        case.after(bus)
        arm.drive.close()
        arm._supervisor.owner, arm._opened = None, False
        arm.enable()
        recorder.end()
        arm.lower()
    elif reason != "killed" and not held:
        recorder.end()
        try:
            arm.lower()
        except pliant.PliantError as error:
            reason = f"{reason}; {error}"
    torque = any(servo.get("torque_enable") for servo in bus.servos)
    # Stop the record before torque is switched off: the fall of the arm that follows is not an
    # effect of the fault.
    recorder.begun = np.inf
    with suppress(pliant.PliantError):
        arm.disable_torque()
    return reason, torque


class Grasp:
    """Hand that grasps the tool at a given time, and pulls it along y from its position then.

    A `Drag` alone pulls the tool from its position at the reset of the plant.
    """

    at = TOOL

    def __init__(self, since: float) -> None:
        """Set the time of the grasp [s]."""
        self._since = since
        self._hand: Drag | None = None

    def force(self, ground_truth: GroundTruth, t: float) -> tuple[Array, Array, Array]:
        """Return force, torque and point of application, as `pliant.sim.Hand` defines them."""
        if self._hand is None and t >= self._since:
            self._hand = Drag(
                axis="y",
                distance=HAND_DISTANCE,
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
    """Return the bound on the force on a hand along y in the present state.

    While the host runs, the bound is 1.15 times the cap at the present deviation, plus
    `Σ_i |J⁺_iy| (τ_f,i + (d_i + k_p,i T/2) |dq_i|)` over the joints i, with the pseudo-inverse J⁺
    of the Jacobian, true dry friction τ_f and damping d, servo stiffness k_p and joint velocity dq.
    The term with k_p T/2 exists because a goal is half a control period T old on average. After a
    host loss, the bound is `AxisReport.host_loss_force` plus `MOTION_ALLOWANCE`.
    """
    report = controller.report()
    y = list(report.axes).index("y")
    if case.state == "host loss":
        return Allowed(still=max(report.axes["y"].host_loss_force) + MOTION_ALLOWANCE)
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
    """Return the true dry friction (n,) [N·m] and the true damping (n,) [N·m·s/rad] of the joints.

    The damping is the sum of the joint's viscous damping and the servo's velocity gain.
    """
    joints = plant.model.joint_names
    dofs = [plant.mj_model.joint(name).dofadr[0] for name in joints]
    servos = np.array([-plant.mj_model.actuator(name).biasprm[2] for name in joints])
    return plant.mj_model.dof_frictionloss[dofs], plant.mj_model.dof_damping[dofs] + servos


def table(only: str = "") -> str:
    """Run the faults whose title contains `only`; return a Markdown table of their effects."""
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
            print(markdown.row(rows[-1]), file=sys.stderr, flush=True)
    return markdown.table(columns, rows)


def row(case: FaultCase, alone: FaultResult, held: FaultResult) -> tuple[str, ...]:
    """Return the cells of a row: speeds and drop without a hand, force and bound with a hand."""
    drop, lowered = f"{1e3 * alone.drop:.1f}", f"{alone.lowered:.2f}"
    feels, allowed = f"{held.force:.1f}", f"{held.allowed:.1f}"
    speeds = f"{alone.speed:.2f}", f"{alone.joint:.2f}"
    return (case.title, alone.ending, *speeds, drop, lowered, feels, allowed)


def main(title: tyro.conf.Positional[str] = "") -> None:
    """Print the table of fault effects.

    Args:
        title: Text that selects the faults whose title contains it.
    """
    print(table(title))


if __name__ == "__main__":
    command_line.start(main)
