"""Torque on and `lower` with wrong assumptions about servos, load, friction, encoder and delay.

``python -m experiments.descent [--arm so101] [--poses 50] [--jobs 2] [--bytes]`` prints a table of
the worst values per arm, over random poses with random errors of the assumptions, in free air and
over a table, and for the ready pose. With `--bytes` the arm has emulated servos on a serial port,
in emulated time. With `--hand`, torque is switched on while a hand holds the arm; the hand releases
the arm abruptly when the first goals arrive, and the arm is not lowered. With `--park`, the arm
moves to its rest pose before it is lowered.
"""

from __future__ import annotations

import math
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from experiments import command_line, markdown
from experiments.arms import BESIDE, ROBOTS, load, ranges
from experiments.runner import run_jobs
from experiments.sheet import POSES
from pliant import config
from pliant.arm.arm import Arm
from pliant.config import factory
from pliant.config.factory import REPLY_TIMEOUT_MIN, make_emulator
from pliant.emulator import ManualClock, Timing
from pliant.servo import ServoBus
from pliant.sim import Plant, SimDrive, table
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from experiments.poses import Array
    from pliant import Model
    from pliant._typing import Mask
    from pliant.config import Config
    from pliant.emulator.servo import Servo


#: Names of the arms in the printed table.
ARMS = ("arm7", "so101", "koch", "vx300s")
#: Ranges of true over assumed stiffness of a joint, and of true over assumed friction.
STIFFNESS, FRICTION = (0.5, 2.5), (0.5, 2.0)
#: Largest unknown load at the tool [kg], and encoder steps [deg].
LOAD, STEPS = 0.5, (0.09, 0.3)
#: Distance of the table below the lower of tool and wrist [m].
TABLE = 0.10
#: Largest share of the usable torque that a random pose may need for arm and load.
MAX_LOAD_SHARE = 0.85
#: Ready pose of each arm (n,) [rad].
READY = {"arm7": tuple(VERTICAL), **POSES}
#: Time between torque on and descent, and observation time after torque off [s].
BEFORE, AFTER = 0.3, 1.0


@dataclass(frozen=True, kw_only=True)
class TrueParameters:
    """True parameters of an arm whose controller assumes its servo table and no load.

    Attributes:
        stiffness: True over assumed stiffness (n,).
        friction: True over assumed friction.
        load: Load at the tool [kg].
        step: Encoder step [rad].
        delay: Delays from sampling to read, and from write to the servo [ticks]; not used with
            emulated servos.
    """

    stiffness: tuple[float, ...]
    friction: float
    load: float
    step: float
    delay: tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class DescentResult:
    """Result of torque on, one descent, and torque on again.

    Attributes:
        apart: Largest ratio between true and assumed stiffness of a joint.
        strain: Largest torque for weight and load during the descent, as a share of the servo's
            true torque; above 1 the servos cannot hold the arm.
        moved: Largest displacement of the tool while torque comes on before the descent [m].
        jerk: Largest speed of the tool while torque comes on before the descent [m/s].
        woken: Largest displacement of the tool while torque comes on after the descent [m].
        stir: Largest speed of the tool while torque comes on after the descent [m/s].
        rise: Largest rise of the tool above its start during the descent [m].
        speed: Largest speed of the tool during the descent [m/s].
        after: Largest speed of the tool within a second after torque off [m/s].
        force: Largest force on one point of the table before torque off, averaged over a control
            period [N].
        resting: Force on the table a second after torque off [N].
        seconds: Duration of the descent [s].
        height: Drop of the tool during the descent [m].
    """

    apart: float
    strain: float
    moved: float
    jerk: float
    woken: float
    stir: float
    rise: float
    speed: float
    after: float
    force: float
    resting: float
    seconds: float
    height: float

    @property
    def pressed(self) -> float:
        """Force on the table beyond the weight that rests there afterwards [N]."""
        return max(self.force - self.resting, 0.0)


@dataclass(frozen=True, kw_only=True)
class Case:
    """An arm in a pose with true parameters.

    Attributes:
        arm: Name of the arm.
        number: Number of pose and parameters; negative for the ready pose.
        over_table: True if there is a table under the arm.
        on_bytes: True if the servos are emulated on a serial port.
        usb_latency: Latency timer of its adapter, which delays each reply [s].
        cycle: Time that a command takes on the simulated bus, see `SlowDrive` [s].
        q: Start pose (n,) [rad].
        truth: True parameters of the arm.
    """

    arm: str
    number: int
    over_table: bool
    on_bytes: bool = False
    usb_latency: float = 0.0
    cycle: float = 0.0
    q: tuple[float, ...] = field(repr=False)
    truth: TrueParameters

    def enable(self, arm: Arm, recorder: PeakRecorder) -> tuple[float, float]:
        """Switch torque on; return largest displacement [m] and speed [m/s] of the tool."""
        recorder.begin()
        arm.enable()
        arm.clock.wait_until(arm.clock.now() + BEFORE)
        return recorder.seen.moved, recorder.seen.speed


@dataclass(frozen=True, kw_only=True)
class Job(Case):
    """One run: torque on, descent, and torque on again."""

    def run(self) -> DescentResult:
        """Enable the arm, lower it, enable it again, and return the recorded result."""
        kind = SlowDrive if self.cycle else SimDrive
        with _over_bytes(self) if self.on_bytes else simulated_arm(self, kind) as (arm, recorder):
            if isinstance(arm.drive, SlowDrive):
                arm.drive.cycle = self.cycle
            plant, clock = recorder.plant, arm.clock
            moved, jerk = self.enable(arm, recorder)
            recorder.begin()
            begin = clock.now()
            arm.lower()
            seconds, down, strain = clock.now() - begin, recorder.seen, recorder.strain
            height = recorder.start[2] - float(plant.tool[2, 3])
            recorder.begin()
            clock.wait_until(clock.now() + AFTER)
            after = recorder.seen.speed
            resting = sum(float(np.linalg.norm(felt.force)) for felt in plant.hands)
            woken, stir = self.enable(arm, recorder)
            ratio = np.log(recorder.stiffness() / np.asarray(arm._io.servos.kp))
        return DescentResult(
            apart=float(np.exp(np.abs(ratio).max())),
            strain=strain,
            moved=moved,
            jerk=jerk,
            woken=woken,
            stir=stir,
            rise=down.rise,
            speed=down.speed,
            after=after,
            force=float(down.force),
            resting=resting,
            seconds=seconds,
            height=float(height),
        )


@dataclass(frozen=True, kw_only=True)
class HandResult:
    """Result of switching torque on in an arm that a hand holds and abruptly releases.

    Attributes:
        apart: Largest ratio between true and assumed stiffness of a joint.
        strain: Torque for weight and load, as a share of the servo's true torque.
        moved: Largest displacement of the tool [m].
        jerk: Largest speed of the tool [m/s].
        left: Displacement of the tool at the end [m].
        seconds: Duration of `Arm.enable` [s].
    """

    apart: float
    strain: float
    moved: float
    jerk: float
    left: float
    seconds: float


@dataclass(frozen=True, kw_only=True)
class HandJob(Case):
    """One run: torque is switched on in an arm that a hand holds and abruptly releases."""

    def run(self) -> HandResult:
        """Enable the arm and return the recorded result."""
        opened = _over_bytes(self) if self.on_bytes else simulated_arm(self, HandDrive)
        with opened as (arm, recorder):
            begin = arm.clock.now()
            moved, jerk = self.enable(arm, recorder)
            seconds = arm.clock.now() - begin - BEFORE
            ratio = np.log(recorder.stiffness() / np.asarray(arm._io.servos.kp))
            left = float(np.linalg.norm(recorder.plant.tool[:3, 3] - recorder.start))
            arm.disable_torque()
        return HandResult(
            apart=float(np.exp(np.abs(ratio).max())),
            strain=recorder.strain,
            moved=moved,
            jerk=jerk,
            left=left,
            seconds=seconds,
        )


@dataclass(frozen=True, kw_only=True)
class ParkResult:
    """Result of a descent through the rest pose.

    Attributes:
        apart, strain: As in `DescentResult`.
        beyond: Largest height of the tool above the highest point of the straight path in joint
            space from the start to the rest pose [m].
        speed: Largest speed of the tool [m/s].
        missed: Smallest distance of the farthest joint from its rest position [rad].
        seconds: Duration of `Arm.park` [s].
    """

    apart: float
    strain: float
    beyond: float
    speed: float
    missed: float
    seconds: float


@dataclass(frozen=True, kw_only=True)
class ParkJob(Case):
    """One run: torque on, motion to the rest pose, and descent."""

    def run(self) -> ParkResult:
        """Enable the arm, park it, and return the recorded result."""
        rest = np.asarray(configuration(self.arm).life.rest_q)
        with _over_bytes(self) if self.on_bytes else simulated_arm(self) as (arm, recorder):
            self.enable(arm, recorder)
            recorder.begin()
            recorder.rest_q = rest
            start, begin = recorder.plant.q, arm.clock.now()
            path = [start + share * (rest - start) for share in np.linspace(0.0, 1.0, 50)]
            height = max(arm.model.forward_kinematics(q)[2, 3] for q in path)
            arm.park(rest)
            seconds, seen = arm.clock.now() - begin, recorder.seen
            ratio = np.log(recorder.stiffness() / np.asarray(arm._io.servos.kp))
        return ParkResult(
            apart=float(np.exp(np.abs(ratio).max())),
            strain=recorder.strain,
            beyond=float(seen.rise + recorder.start[2] - height),
            speed=seen.speed,
            missed=seen.distance,
            seconds=seconds,
        )


class HandDrive(SimDrive):
    """Simulated drive that reports torque off until `enable`.

    Until then its servos play the part of a hand: they hold the arm in its position, and release it
    when the first goals arrive.
    """

    _is_released = False

    @property
    def enabled(self) -> Mask:
        """Mask (N,) of the joints with torque on."""
        return self._on & self._is_released

    @property
    def orders(self) -> tuple[Array, Array]:
        """NaN: goals (N,) [rad] and torque limits (N,) [N·m] in the servos are unknown."""
        unknown = np.full(len(self.names), np.nan)
        return unknown, unknown

    def enable(self, goal: Array, limit: Array) -> None:
        """Switch torque of all joints on, with goals (N,) [rad] and torque limits (N,) [N·m]."""
        self._is_released = True
        super().enable(goal, limit)


class SlowDrive(SimDrive):
    """Simulated drive on a slow bus.

    Attributes:
        cycle: Time that a command takes [s].
    """

    cycle = 0.0

    def write(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send goals (N,) [rad] and torque limits (N,) [N·m], then wait for `cycle`."""
        super().write(goal, limit, velocity)
        self.clock.wait_until(self.clock.now() + self.cycle)


@dataclass
class Peaks:
    """Extreme values since `PeakRecorder.begin`, as in `DescentResult`.

    Attributes:
        distance: Smallest distance of the farthest joint from its rest position [rad].
    """

    moved: float = 0.0
    rise: float = -np.inf
    speed: float = 0.0
    force: float = 0.0
    distance: float = np.inf


class PeakRecorder:
    """Records peaks of the true state of an arm; called after physics steps.

    Attributes:
        plant: Simulation with the true state.
        seen: Extreme values since `begin`.
        rest_q: Rest pose (n,) [rad] from which `seen.distance` is measured, or `None`.
        strain: Largest torque share since `begin`, as in `DescentResult`.
        start: Position of the tool at `begin` (3,) [m].
    """

    def __init__(self, job: Case, plant: Plant) -> None:
        """Store the simulation, and place the table under the arm if the job has one."""
        self.plant, self._load = plant, job.truth.load
        self.rest_q: Array | None = None
        if job.over_table:
            plant.set_hands(table(min(plant.tool[2, 3], plant.wrist[2]) - TABLE))
        self.begin()

    def begin(self) -> None:
        """Restart the record."""
        self.seen, self.strain = Peaks(), 0.0
        self.start = self.plant.tool[:3, 3].copy()
        self._steps, self._force = 0, np.zeros((len(self.plant.hands), 3))

    def record(self, steps: int) -> None:
        """Record the state, `steps` physics steps after the last call."""
        plant, seen = self.plant, self.seen
        tool = plant.ground_truth.frame("tool")
        moved, velocity = tool.position - self.start, tool.velocities()[0]
        # `np.linalg.norm` would take longer than the rest of this method.
        seen.moved = max(seen.moved, math.sqrt(moved.dot(moved)))
        seen.rise = max(seen.rise, float(moved[2]))
        seen.speed = max(seen.speed, math.sqrt(velocity.dot(velocity)))
        if self.rest_q is not None:
            seen.distance = min(seen.distance, float(np.abs(plant.q - self.rest_q).max()))
        self._steps += steps
        for row, felt in enumerate(plant.hands):
            self._force[row] += steps * felt.force
        if self._steps < plant.steps:
            return
        mean = np.linalg.norm(self._force / self._steps, axis=1) if plant.hands else ()
        seen.force = max(seen.force, *mean) if plant.hands else 0.0
        self._steps = 0
        self._force.fill(0.0)
        needed = np.abs(_holding_torque(plant.model, plant.q, self._load))
        self.strain = max(self.strain, float((needed / plant.gains.torque).max()))

    def stiffness(self) -> Array:
        """Return the true stiffness of the joints (n,) [N·m/rad]."""
        model = self.plant.mj_model
        gains = [model.actuator(name).gainprm[0] for name in self.plant.model.joint_names]
        return np.array(gains)


@contextmanager
def simulated_arm(job: Case, kind: type[SimDrive] = SimDrive) -> Iterator[tuple[Arm, PeakRecorder]]:
    """Return the arm of a job on the simulator with a drive of this kind, and its recorder.

    The servos already hold the arm, as after an earlier program: with the leads that the true
    parameters need.
    """
    model, truth = robot(job.arm), job.truth
    assert model.servos is not None
    plant = Plant(
        model,
        delay=truth.delay,
        encoder_step=truth.step,
        kp_scale=truth.stiffness,
        friction_scale=truth.friction,
        payload=_payload(truth),
    )
    plant.reset(job.q)
    recorder = PeakRecorder(job, plant)
    drive = kind(plant, servos=model.servos.replace(stiffness_known=False))
    arm = Arm(
        model, drive, grippers=factory.gripper_configs(configuration(job.arm)), handle_signals=False
    )
    lead = _holding_torque(model, np.asarray(job.q), truth.load) / plant.gains.kp
    goal = np.concatenate((job.q + lead, drive.read().position[model.n :]))
    drive.write(goal, np.asarray(drive.servos.max_torque))
    drive.clock.wait_until(plant.time + BEFORE)
    drive.clock.on_tick = lambda: recorder.record(plant.steps)
    yield arm, recorder


@contextmanager
def _over_bytes(job: Case) -> Iterator[tuple[Arm, PeakRecorder]]:
    """Return the arm of a job on emulated servos, and its recorder.

    The emulator keeps the arm in its pose until all servos have torque.
    """
    own, truth = configuration(job.arm), job.truth
    model = own.model()
    bus = make_emulator(
        own,
        q=job.q,
        clock="steps",
        timing=Timing(wire=True, usb_latency=job.usb_latency),
        plant={"friction_scale": truth.friction, "payload": _payload(truth)},
    )
    recorder = PeakRecorder(job, bus.plant)
    bus.world.watchers.append(recorder.record)
    names = [joint for joint, servo in own.servo.items() for _ in range(1 + bool(servo.secondary))]
    scales = dict(zip(model.joint_names, truth.stiffness, strict=True))
    for servo, joint in zip(bus.world.servos, names, strict=False):
        _set_true_behaviour(servo, scales.get(joint, 1.0), truth.step)

    with bus:
        drive = ServoBus(
            factory.servo_specs(own, bus.ports),
            reply_timeout_min=REPLY_TIMEOUT_MIN,
            clock=ManualClock(bus),
        )
        arm = Arm(model, drive, grippers=factory.gripper_configs(own), handle_signals=False)
        try:
            yield arm, recorder
        finally:
            arm.disable_torque()
            arm.close()


def _set_true_behaviour(servo: Servo, stiffness: float, step: float) -> None:
    """Scale the stiffness of an emulated servo, and round its position to `step` [rad]."""
    drive, refresh = servo.drive, servo.refresh
    counts = max(round(step / servo.model.count), 1)

    def stiffer() -> Any:
        asked = drive()
        return replace(asked, stiffness=stiffness * asked.stiffness)

    def coarser() -> None:
        refresh()
        servo.put("present_position", counts * round(servo.get("present_position") / counts))

    servo.drive, servo.refresh = stiffer, coarser  # type: ignore[method-assign]


def _payload(truth: TrueParameters) -> tuple[float, tuple[float, ...]] | None:
    return (truth.load, (0.0, 0.0, 0.0)) if truth.load else None


def _holding_torque(model: Model, q: Array, mass: float) -> Array:
    """Return the torques (n,) [N·m] for weight and a load [kg] at the tool at q (n,) [rad]."""
    needed: Array = model.gravity(q) - mass * model.gravity_vector @ model.jacobian(q)[:3]
    return needed


@cache
def robot(name: str) -> Model:
    """Return the model of a built-in arm, or of a real robot whose URDF is available."""
    return load(name).model


def configuration(name: str) -> Config:
    """Return the built-in configuration of an arm, without the table under the arm."""
    urdf = ROBOTS / BESIDE[name][0] if name in BESIDE else None
    return config.load(name, backend="emulator", urdf=urdf, table=False)


def is_here(name: str) -> bool:
    """Return True if an arm's description is available."""
    return name not in BESIDE or (ROBOTS / BESIDE[name][0]).is_file()


def random_parameters(
    model: Model, count: int, *, seed: int = 0
) -> list[tuple[Array, TrueParameters]]:
    """Return random poses (n,) [rad] that the servos can hold, each with true parameters.

    The first parameters have extreme stiffness: all servos too stiff, all too soft, alternating.
    """
    assert model.servos is not None
    n, usable = model.n, np.asarray(model.servos.max_torque)
    low, high = ranges(model)
    rng = np.random.default_rng(seed)
    corners = [
        np.full(n, STIFFNESS[1]),
        np.full(n, STIFFNESS[0]),
        np.where(np.arange(n) % 2, *STIFFNESS),
        np.where(np.arange(n) % 2, *STIFFNESS[::-1]),
        np.ones(n),
    ]
    found: list[tuple[Array, TrueParameters]] = []
    while len(found) < count:
        k = len(found)
        drawn = np.exp(rng.uniform(np.log(STIFFNESS[0]), np.log(STIFFNESS[1]), n))
        stiffness = drawn if k >= len(corners) else corners[k]
        truth = TrueParameters(
            stiffness=tuple(stiffness.tolist()),
            friction=float(np.exp(rng.uniform(np.log(FRICTION[0]), np.log(FRICTION[1])))),
            load=float(rng.uniform(0.0, LOAD)) if k % 5 else LOAD * (k % 2),
            step=float(np.deg2rad(STEPS[k % 2])),
            delay=((k % 4) // 2, (k % 4 + 1) // 2),
        )
        for _ in range(200):
            q = rng.uniform(low, high)
            if np.all(np.abs(_holding_torque(model, q, truth.load)) < MAX_LOAD_SHARE * usable):
                found.append((q, truth))
                break
    return found


def descents(
    name: str, count: int, *, seed: int = 0, on_bytes: bool = False, cycle: float = 0.0
) -> list[Job]:
    """Return the runs of one arm: every pose in free air and over a table, and the ready pose.

    The ready pose is combined with the first true parameters, without a load. For `cycle` [s], see
    `Case`.
    """
    drawn = random_parameters(
        configuration(name).model() if on_bytes else robot(name), count, seed=seed
    )
    runs = [
        Job(
            arm=name,
            number=k,
            over_table=over,
            on_bytes=on_bytes,
            cycle=cycle,
            q=tuple(q),
            truth=truth,
        )
        for over in (False, True)
        for k, (q, truth) in enumerate(drawn)
    ]
    ready = [
        replace(runs[k], number=-1 - k, q=READY[name], truth=replace(drawn[k][1], load=0.0))
        for k in range(min(count, 5))
    ]
    return runs + ready


def in_hand(
    name: str, count: int, *, seed: int = 0, on_bytes: bool = False, usb_latency: float = 0.0
) -> list[HandJob]:
    """Return runs in which torque comes on while a person's hand holds the arm.

    Poses and parameters are the same as in `descents`; for `usb_latency` [s], see `Case`.
    """
    return [
        HandJob(
            arm=job.arm,
            number=job.number,
            over_table=False,
            on_bytes=on_bytes,
            usb_latency=usb_latency,
            q=job.q,
            truth=job.truth,
        )
        for job in descents(name, count, seed=seed, on_bytes=on_bytes)
        if not job.over_table
    ]


def to_rest(name: str, count: int, *, seed: int = 0, on_bytes: bool = False) -> list[ParkJob]:
    """Return runs in which the arm moves to its rest pose before it is lowered, in free air.

    Poses and parameters are the same as in `descents`.
    """
    return [
        ParkJob(
            arm=name,
            number=job.number,
            over_table=False,
            on_bytes=on_bytes,
            q=job.q,
            truth=job.truth,
        )
        for job in descents(name, count, seed=seed, on_bytes=on_bytes)
        if not job.over_table
    ]


def rows(name: str, work: Sequence[Job], seen: Sequence[DescentResult]) -> list[str]:
    """Return lines of the table, with worst value, median, and number of the worst pose."""
    pairs = list(zip(work, seen, strict=True))
    # Runs in which the servos cannot hold the arm have a row of their own.
    strong = [(job, one) for job, one in pairs if one.strain < 1.0]
    cases = {
        "free": [(job, one) for job, one in strong if job.number >= 0 and not job.over_table],
        "table": [(job, one) for job, one in strong if job.over_table],
        "ready pose": [(job, one) for job, one in strong if job.number < 0],
        "too weak": [(job, one) for job, one in pairs if one.strain >= 1.0],
    }
    columns = (
        ("moved", 1e3, 0),
        ("jerk", 1.0, 2),
        ("woken", 1e3, 0),
        ("stir", 1.0, 2),
        ("rise", 1e3, 0),
        ("speed", 1.0, 2),
        ("after", 1.0, 2),
        ("force", 1.0, 1),
        ("resting", 1.0, 1),
        ("pressed", 1.0, 1),
        ("seconds", 1.0, 0),
    )
    return _lines(name, cases, columns)


def hand_rows(name: str, work: Sequence[HandJob], seen: Sequence[HandResult]) -> list[str]:
    """Return lines of the table for arms that a hand releases, in the form of `rows`."""
    pairs = list(zip(work, seen, strict=True))
    cases = {
        "no load": [(job, one) for job, one in pairs if not job.truth.load],
        "load": [(job, one) for job, one in pairs if job.truth.load],
    }
    columns = (("moved", 1e3, 0), ("jerk", 1.0, 2), ("left", 1e3, 0), ("seconds", 1.0, 1))
    return _lines(name, cases, columns)


def park_rows(name: str, work: Sequence[ParkJob], seen: Sequence[ParkResult]) -> list[str]:
    """Return lines of the table for motions to the rest pose, in the form of `rows`."""
    columns = (("beyond", 1e3, 0), ("speed", 1.0, 2), ("missed", 1.0, 2), ("seconds", 1.0, 0))
    pairs = list(zip(work, seen, strict=True))
    cases = {
        "free": [(job, one) for job, one in pairs if one.strain < 1.0],
        "too weak": [(job, one) for job, one in pairs if one.strain >= 1.0],
    }
    return _lines(name, cases, columns)


def _lines(
    name: str,
    cases: dict[str, list[tuple[Any, Any]]],
    columns: tuple[tuple[str, float, int], ...],
) -> list[str]:
    lines = []
    for case, runs in cases.items():
        cells = []
        for what, unit, digits in columns:
            values = np.array([unit * getattr(one, what) for _, one in runs])
            if not values.size:
                break
            worst = int(values.argmax())
            cells.append(
                f"{values[worst]:.{digits}f} ({np.median(values):.{digits}f}) "
                f"#{runs[worst][0].number}"
            )
        if cells:
            lines.append(markdown.row((f"{name}, {case}", len(runs), *cells)))
    return lines


HAND_COLUMNS = ("arm", "runs", "moves [mm]", "speed [m/s]", "in the end [mm]", "takes [s]")
PARK_COLUMNS = (
    "arm",
    "runs",
    "above the straight path [mm]",
    "speed [m/s]",
    "away from the rest pose [rad]",
    "takes [s]",
)
COLUMNS = (
    "arm",
    "runs",
    "taken over: moved [mm]",
    "speed [m/s]",
    "from rest: moved [mm]",
    "speed [m/s]",
    "lowered: rises [mm]",
    "speed [m/s]",
    "after torque off [m/s]",
    "force on the table before torque off [N]",
    "rests after torque off [N]",
    "force beyond that [N]",
    "takes [s]",
)


def main(
    *,
    arm: command_line.Arms = (),
    poses: int = 50,
    seed: int = 0,
    jobs: int = 1,
    each: bool = False,
    hand: bool = False,
    park: bool = False,
    over_bytes: Annotated[bool, tyro.conf.arg(name="bytes")] = False,
    usb_latency: float = 0.0,
    cycle: float = 0.0,
) -> None:
    """Lower arms whose true parameters differ from the assumed ones.

    Args:
        arm: Names of the arms; default: all.
        poses: Number of random poses per arm.
        seed: Random seed of poses and true parameters.
        jobs: Number of processes.
        each: True prints every run too.
        hand: True switches torque on while a hand holds the arm, and does not lower the arm.
        park: True moves the arm to its rest pose before it is lowered, in free air.
        over_bytes: True uses emulated servos on a serial port, in emulated time.
        usb_latency: Latency timer of the adapter of this port [s], only with `hand`.
        cycle: Time that a command takes on the simulated bus [s].
    """
    columns = HAND_COLUMNS if hand else PARK_COLUMNS if park else COLUMNS
    print(markdown.head(columns), flush=True)
    for name in arm or ARMS:
        if not is_here(name):
            print(f"{name}: its URDF is not available, skipped")
            continue
        if hand:
            held = in_hand(name, poses, seed=seed, on_bytes=over_bytes, usb_latency=usb_latency)
            results = list(run_jobs(held, jobs, f"torque on in {name}"))
            if each:
                for start, result in zip(held, results, strict=True):
                    print(f"    {start.number} {result}", flush=True)
            print("\n".join(hand_rows(name, held, results)), flush=True)
            continue
        if park:
            parked = to_rest(name, poses, seed=seed, on_bytes=over_bytes)
            reached = list(run_jobs(parked, jobs, f"rest pose of {name}"))
            if each:
                for going, end in zip(parked, reached, strict=True):
                    print(f"    {going.number} {end}", flush=True)
            print("\n".join(park_rows(name, parked, reached)), flush=True)
            continue
        work = descents(name, poses, seed=seed, on_bytes=over_bytes, cycle=cycle)
        seen: list[DescentResult] = []
        for job, one in zip(work, run_jobs(work, jobs, f"descent of {name}"), strict=True):
            seen.append(one)
            if each:
                print(f"    {job.number}{'t' if job.over_table else ' '} {one}", flush=True)
        print("\n".join(rows(name, work, seen)), flush=True)


if __name__ == "__main__":
    command_line.start(main)
