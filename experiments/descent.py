"""Descents with wrong assumptions about servos, load, friction, encoder and delay.

``python -m experiments.descent [--arm so101] [--poses 50] [--jobs 2] [--bytes]`` prints, per arm,
the worst of torque on and of `lower` over random poses, each with its own mix of errors, in free
air and over a table, the worst poses, and the ready pose. With `--bytes` the servos are
emulated ones on a serial port, in emulated time.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from experiments import program
from experiments.arms import BESIDE, ROBOTS, load
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
    from pliant.config import Config
    from pliant.emulator.servo import Servo


#: Arms of the table.
ARMS = ("arm7", "so101", "koch", "vx300s")
#: True over assumed stiffness of a joint, and true over assumed friction.
STIFFNESS, FRICTION = (0.5, 2.5), (0.5, 2.0)
#: Unknown loads at the tool [kg], encoder steps [deg] and delays of a cycle [ticks].
LOAD, STEPS, DELAYS = 0.5, (0.09, 0.3), (0, 1, 2, 3)
#: Table below the lower of tool and wrist [m].
TABLE = 0.10
#: Share of the usable torque that holding the arm and its load may take.
HOLDS = 0.85
#: Ready pose of each arm (n,) [rad]; the last row of the table uses it.
READY = {"arm7": tuple(VERTICAL), **POSES}
#: Time before the descent, and after torque off [s].
BEFORE, AFTER = 0.3, 1.0


@dataclass(frozen=True, kw_only=True)
class Truth:
    """True parameters of an arm that assumes its servo table and no load.

    Attributes:
        stiffness, friction: True over assumed (n,).
        load: At the tool [kg].
        step: Of the encoders [rad].
        delay: Ticks from sampling to read, and from write to the servo; on bytes the wire has its
            own.
    """

    stiffness: tuple[float, ...]
    friction: float
    load: float
    step: float
    delay: tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of torque on and one descent.

    Attributes:
        apart: Largest ratio between true and assumed stiffness of a joint.
        strain: Largest share of its servo's true torque that a joint needed for weight and load
            during the descent; above 1 the servos cannot hold the arm.
        moved: Largest displacement of the tool while the arm was taken over from a program that
            held it; on bytes from a hand [m].
        jerk: Highest speed of the tool while the arm was taken over [m/s].
        woken, stir: The same, where torque came on at the end of the descent [m], [m/s].
        rise: Rise of the tool above its start during the descent [m].
        speed: Highest speed of the tool during the descent [m/s].
        after: Highest speed within the second after torque was off [m/s].
        force: Largest mean over a tick of the force on one point of the table [N].
        resting: Force on the table a second after torque was off [N].
        seconds: Duration of the descent.
        height: Drop of the tool [m].
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


@dataclass(frozen=True, kw_only=True)
class Job:
    """One arm, one pose, one set of true parameters.

    Attributes:
        arm: Its name.
        number: Of pose and parameters; -1 and less for the ready pose.
        over_table: True if there is a table under it.
        on_bytes: True if its servos are emulated ones on a serial port.
        q: Pose (n,) [rad].
        truth: True parameters of the arm.
    """

    arm: str
    number: int
    over_table: bool
    on_bytes: bool = False
    q: tuple[float, ...] = field(repr=False)
    truth: Truth

    def run(self) -> Outcome:
        """Enable the arm, wait, lower it, and record."""
        with (_over_bytes if self.on_bytes else _simulated)(self) as (arm, watch):
            plant, clock = watch.plant, arm.clock
            moved, jerk = self._enable(arm, watch)
            watch.begin()
            begin = clock.now()
            arm.lower()
            seconds, down, strain = clock.now() - begin, watch.seen, watch.strain
            height = watch.start[2] - float(plant.tool[2, 3])
            watch.begin()
            clock.wait_until(clock.now() + AFTER)
            after = watch.seen.speed
            resting = sum(float(np.linalg.norm(felt.force)) for felt in plant.hands)
            woken, stir = self._enable(arm, watch)
            ratio = np.log(watch.stiffness() / np.asarray(arm.servos.kp))
        return Outcome(
            apart=float(np.exp(np.abs(ratio).max())),
            strain=strain,
            moved=moved,
            jerk=jerk,
            woken=woken,
            stir=stir,
            rise=down.rise,
            speed=down.speed,
            after=after,
            force=down.force,
            resting=resting,
            seconds=seconds,
            height=height,
        )

    @staticmethod
    def _enable(arm: Arm, watch: Watch) -> tuple[float, float]:
        """Switch torque on; return distance [m] and speed [m/s] of the tool."""
        watch.begin()
        arm.enable()
        arm.clock.wait_until(arm.clock.now() + BEFORE)
        return watch.seen.moved, watch.seen.speed


@dataclass
class Seen:
    """Largest values since `Watch.begin`: see `Outcome`."""

    moved: float = 0.0
    rise: float = -np.inf
    speed: float = 0.0
    force: float = 0.0


class Watch:
    """Records the true state of an arm each time its physics has advanced.

    Attributes:
        plant: The true state.
        seen, strain: Largest values since `begin`.
        start: Position of the tool at `begin` (3,) [m].
    """

    def __init__(self, job: Job, plant: Plant) -> None:
        """Put the table under the arm, if there is one."""
        self.plant, self._load = plant, job.truth.load
        if job.over_table:
            plant.set_hands(table(min(plant.tool[2, 3], plant.wrist[2]) - TABLE))
        self.begin()

    def begin(self) -> None:
        """Restart the record."""
        self.seen, self.strain = Seen(), 0.0
        self.start = self.plant.tool[:3, 3].copy()
        self._steps, self._force = 0, np.zeros((len(self.plant.hands), 3))

    def look(self, steps: int) -> None:
        """Record the state; `steps` physics steps have passed since the last record."""
        plant, seen = self.plant, self.seen
        tool = plant.tool[:3, 3]
        seen.moved = max(seen.moved, float(np.linalg.norm(tool - self.start)))
        seen.rise = max(seen.rise, float(tool[2] - self.start[2]))
        twist = plant.ground_truth.frame("tool").twist()
        seen.speed = max(seen.speed, float(np.linalg.norm(twist[:3])))
        self._steps += steps
        self._force += steps * np.array([felt.force for felt in plant.hands]).reshape(-1, 3)
        if self._steps < plant.steps:
            return
        mean = np.linalg.norm(self._force / self._steps, axis=1)
        seen.force = max(seen.force, *mean) if mean.size else 0.0
        self._steps, self._force = 0, np.zeros_like(self._force)
        needed = np.abs(_needed(plant.model, plant.q, self._load))
        self.strain = max(self.strain, float((needed / plant.gains.torque).max()))

    def stiffness(self) -> Array:
        """True stiffness of the joints (n,) [N·m/rad]."""
        model = self.plant.mj_model
        gains = [model.actuator(name).gainprm[0] for name in self.plant.model.joint_names]
        return np.array(gains)


@contextmanager
def _simulated(job: Job) -> Iterator[tuple[Arm, Watch]]:
    """Return the arm of a job on the simulator, held by a program that knew its parameters."""
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
    watch = Watch(job, plant)
    drive = SimDrive(plant, servos=model.servos.replace(stiffness_known=False))
    arm = Arm(
        model, drive, grippers=factory.gripper_configs(configuration(job.arm)), handle_signals=False
    )
    lead = _needed(model, np.asarray(job.q), truth.load) / plant.gains.kp
    goal = np.concatenate((job.q + lead, drive.read().position[model.n :]))
    drive.write(goal, np.asarray(drive.servos.max_torque))
    drive.clock.wait_until(plant.time + BEFORE)
    drive.clock.on_tick = lambda: watch.look(plant.steps)
    yield arm, watch


@contextmanager
def _over_bytes(job: Job) -> Iterator[tuple[Arm, Watch]]:
    """Return the arm of a job on emulated servos, held by a hand until they have torque."""
    own, truth = configuration(job.arm), job.truth
    model = own.model()
    bus = make_emulator(
        own,
        q=job.q,
        clock="steps",
        timing=Timing(wire=True),
        plant={"friction_scale": truth.friction, "payload": _payload(truth)},
    )
    watch, step = Watch(job, bus.plant), bus.world.physics.step
    names = [joint for joint, servo in own.servo.items() for _ in range(1 + bool(servo.secondary))]
    scales = dict(zip(model.joint_names, truth.stiffness, strict=True))
    for servo, joint in zip(bus.world.servos, names, strict=False):
        _differ(servo, scales.get(joint, 1.0), truth.step)

    def watched(count: int) -> None:
        step(count)
        watch.look(count)

    bus.world.physics.step = watched  # type: ignore[method-assign]
    with bus:
        drive = ServoBus(
            factory.servo_specs(own, bus.ports),
            reply_timeout_min=REPLY_TIMEOUT_MIN,
            clock=ManualClock(bus),
        )
        arm = Arm(model, drive, grippers=factory.gripper_configs(own), handle_signals=False)
        try:
            yield arm, watch
        finally:
            arm.disable_torque()
            arm.close()


def _differ(servo: Servo, stiffness: float, step: float) -> None:
    """Give an emulated servo a stiffness unlike its registers, and coarser counts [rad]."""
    drive, refresh = servo.drive, servo.refresh
    counts = max(round(step / servo.model.count), 1)

    def stiffer() -> Any:
        asked = drive()
        return replace(asked, stiffness=stiffness * asked.stiffness)

    def coarser() -> None:
        refresh()
        servo.put("present_position", counts * round(servo.get("present_position") / counts))

    servo.drive, servo.refresh = stiffer, coarser  # type: ignore[method-assign]


def _payload(truth: Truth) -> tuple[float, tuple[float, ...]] | None:
    return (truth.load, (0.0, 0.0, 0.0)) if truth.load else None


def _needed(model: Model, q: Array, mass: float) -> Array:
    """Return the torques (n,) [N·m] for weight and a load [kg] at the tool at q (n,) [rad]."""
    needed: Array = model.gravity(q) - mass * model.gravity_vector @ model.jacobian(q)[:3]
    return needed


@cache
def robot(name: str) -> Model:
    """Return a built-in arm, or a real robot's description found beside the project."""
    return load(name).model


def configuration(name: str) -> Config:
    """Return the ready file of an arm, without its table."""
    urdf = ROBOTS / BESIDE[name][0] if name in BESIDE else None
    return config.load(name, backend="emulator", urdf=urdf, table=False)


def is_here(name: str) -> bool:
    """Return True if an arm's description is available."""
    return name not in BESIDE or (ROBOTS / BESIDE[name][0]).is_file()


def truths(model: Model, count: int, *, seed: int = 0) -> list[tuple[Array, Truth]]:
    """Return random poses (n,) [rad] that the true servos can hold, each with its true parameters.

    The first ones have all servos too stiff, too soft, and both in turn.
    """
    assert model.servos is not None
    n, usable = model.n, np.asarray(model.servos.max_torque)
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    high = np.where(np.isfinite(model.upper), model.upper, np.pi)
    rng = np.random.default_rng(seed)
    corners = [
        np.full(n, STIFFNESS[1]),
        np.full(n, STIFFNESS[0]),
        np.where(np.arange(n) % 2, *STIFFNESS),
        np.where(np.arange(n) % 2, *STIFFNESS[::-1]),
        np.ones(n),
    ]
    found: list[tuple[Array, Truth]] = []
    while len(found) < count:
        k = len(found)
        drawn = np.exp(rng.uniform(np.log(STIFFNESS[0]), np.log(STIFFNESS[1]), n))
        stiffness = drawn if k >= len(corners) else corners[k]
        truth = Truth(
            stiffness=tuple(stiffness.tolist()),
            friction=float(np.exp(rng.uniform(np.log(FRICTION[0]), np.log(FRICTION[1])))),
            load=float(rng.uniform(0.0, LOAD)) if k % 5 else LOAD * (k % 2),
            step=float(np.deg2rad(STEPS[k % 2])),
            delay=((k % 4) // 2, (k % 4 + 1) // 2),
        )
        for _ in range(200):
            q = rng.uniform(low, high)
            if np.all(np.abs(_needed(model, q, truth.load)) < HOLDS * usable):
                found.append((q, truth))
                break
    return found


def descents(name: str, count: int, *, seed: int = 0, on_bytes: bool = False) -> list[Job]:
    """Return the runs of one arm: every pose in free air, then over a table; then the ready pose.

    The ready pose has the first parameters, without a load.
    """
    drawn = truths(configuration(name).model() if on_bytes else robot(name), count, seed=seed)
    runs = [
        Job(arm=name, number=k, over_table=over, on_bytes=on_bytes, q=tuple(q), truth=truth)
        for over in (False, True)
        for k, (q, truth) in enumerate(drawn)
    ]
    ready = [
        replace(runs[k], number=-1 - k, q=READY[name], truth=replace(drawn[k][1], load=0.0))
        for k in range(min(count, 5))
    ]
    return runs + ready


def rows(name: str, work: Sequence[Job], seen: Sequence[Outcome]) -> list[str]:
    """Return lines of the table: worst (median), and in brackets the number of the worst pose."""
    lines = []
    pairs = list(zip(work, seen, strict=True))
    # Runs in which the true servos were too weak to hold the arm are left out.
    strong = [(job, one) for job, one in pairs if one.strain < 1.0]
    cases = {
        "free": [(job, one) for job, one in strong if job.number >= 0 and not job.over_table],
        "table": [(job, one) for job, one in strong if job.over_table],
        "ready pose": [(job, one) for job, one in strong if job.number < 0],
        "too weak": [(job, one) for job, one in pairs if one.strain >= 1.0],
    }
    columns = [
        ("moved", 1e3, 0),
        ("jerk", 1.0, 2),
        ("woken", 1e3, 0),
        ("stir", 1.0, 2),
        ("rise", 1e3, 0),
        ("speed", 1.0, 2),
        ("after", 1.0, 2),
        ("force", 1.0, 1),
        ("resting", 1.0, 1),
        ("seconds", 1.0, 0),
    ]
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
            lines.append(program.row((f"{name}, {case}", len(runs), *cells)))
    return lines


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
    "force on the table [N]",
    "of which rests [N]",
    "takes [s]",
)


def main(
    *,
    arm: program.Arms = (),
    poses: int = 50,
    seed: int = 0,
    jobs: int = 1,
    each: bool = False,
    over_bytes: Annotated[bool, tyro.conf.arg(name="bytes")] = False,
) -> None:
    """Lower arms that differ from their assumptions.

    Args:
        arm: Arms by name; default all of the table.
        poses: Random poses of each.
        seed: Random seed of poses and true parameters.
        jobs: Number of processes.
        each: Also print every run.
        over_bytes: Emulated servos on a serial port, in emulated time.
    """
    print(program.head(COLUMNS), flush=True)
    for name in arm or ARMS:
        if not is_here(name):
            print(f"{name}: no description beside the project, skipped")
            continue
        work = descents(name, poses, seed=seed, on_bytes=over_bytes)
        seen: list[Outcome] = []
        for job, one in zip(work, run_jobs(work, jobs, f"descent of {name}"), strict=True):
            seen.append(one)
            if each:
                print(f"    {job.number}{'t' if job.over_table else ' '} {one}", flush=True)
        print("\n".join(rows(name, work, seen)), flush=True)


if __name__ == "__main__":
    program.start(main)
