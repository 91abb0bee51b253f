"""Comparison of force caps with the force on a hand: ``python -m experiments.campaign``.

In random poses of every arm, a hand pushes the tool along every axis in both directions, for
several caps of this axis. The other axes are once free and once guided by springs. On `arm7` the
campaign also tests single disturbances, in a tenth of the poses. A push is refused, that is, not
run, if the servos cannot exert the cap in the pose (`Arm.capacity`). A force outside the band below
is announced if `Controller.report` predicts, before the push, that a joint meets its position limit
and that the friction of the other joints exceeds the band. Of all other forces, the share `GOALS`
must be in the band.

The expected ("promised") force for a cap F at deviation e of axis j is
``min(F, (1 - η)|e| / C_jj)``, with target adaptation η and the compliance C_jj of the servos'
position loops along the axis. A force is in the band if it differs from the expected one by at most
``0.15 F + Σ_i |J⁺_ij| (τ_f,i + d_i |q̇_i|)`` over the joints i, with dry friction τ_f, damping d (in
motion only) and the pseudo-inverse J⁺ of the Jacobian; plus ``0.25 F`` if the true k_p differs from
the assumed one.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from experiments import command_line, controllers, goals, markdown
from experiments.arms import AXES, ROBOTS, available, load
from experiments.controllers import NO_RATE_LIMITS
from experiments.results import write_results
from experiments.runner import run_jobs
from experiments.simulation import NOMINAL, Conditions, closed_loop
from experiments.spring_hand import OF_CAPACITY, Grip
from pliant._report.style import BLUE, CARD, MUTED, SKY, WIDE, canvas, save
from pliant.sim import DRAG_15N, DRAG_80N, Plant
from pliant.sim._mujoco import mujoco
from pliant.sim.friction import MX64, MX106, STS3215, Friction

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from experiments.arms import Arm
    from experiments.poses import Array

    #: Name of an arm and name of a disturbance.
    Key = tuple[str, str]
    #: Results of all pushes, by the names of arm and disturbance.
    Results = Mapping[tuple[str, str], Sequence["Promise"]]
    #: Results of pushes, by the label of their line in the picture.
    Groups = Mapping[str, Sequence["Promise"]]

#: The hand moves by `DISTANCE_FACTOR` times the deviation at which the cap is reached, plus
#: `EXTRA_DISTANCE`: translations [m], rotations [rad].
DISTANCE_FACTOR, EXTRA_DISTANCE = 1.25, (0.005, 0.03)
#: Largest distance of the hand, so that the arm stays near its pose: translations [m],
#: rotations [rad].
MAX_DISTANCE = (0.10, 0.40)
#: Start and duration of the hand's motion, rest after the motion, and time at the end of the run
#: over which the force is averaged [s].
START, RISE, REST, EVALUATED = 0.1, 0.7, 0.7, 0.15
#: Speed of a hand whose force is evaluated during its motion: translations [m/s],
#: rotations [rad/s].
MOVING_SPEED = (0.05, 0.25)


@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """Deviation from nominal conditions.

    Attributes:
        name: Name in tables.
        eta: Target adaptation of the soft axis.
        moving: True if the force is evaluated while the hand moves; False: while it rests.
        short: Largest distance of the hand, as a share of the distance at which the report of the
            controller predicts that a joint meets its position limit.
        delay: Read and write delay [ticks], known to the controller.
        count: Encoder step [rad], with a flicker of one count, known to the controller.
        kp: True over assumed stiffness.
        identified: True if the controller knows the true stiffness.
        captured: True if `Controller.capture_gravity` was called in the pose.
        payload: Unknown mass at the tool [kg].
        gears: Friction that depends on speed and load; None: the friction of the servo table.
        gears_known: True if the controller knows the friction `gears`.
    """

    name: str
    eta: float = 0.0
    moving: bool = False
    short: float = np.inf
    delay: tuple[int, int] = (0, 0)
    count: float = 0.0
    kp: float = 1.0
    identified: bool = False
    captured: bool = False
    payload: float = 0.0
    gears: Friction | None = None
    gears_known: bool = False

    @property
    def wrong(self) -> bool:
        """True if the stiffness is wrong and the controller does not know it."""
        return self.kp != 1.0 and not self.identified


#: Share of the predicted distance to a joint stop by which the hand moves in cases named "short of
#: stops", see `Disturbance.short`.
SHORT = 0.9

UNDISTURBED = Disturbance(name="nominal")
DISTURBANCES = (
    Disturbance(name="moving at 0.05 m/s", moving=True),
    Disturbance(name="short of stops", short=SHORT),
    Disturbance(name="η 0.9", eta=0.9),
    Disturbance(name="η 0.9, short of stops", eta=0.9, short=SHORT),
    *(
        Disturbance(name=f"k_p × {kp:g}, {word}", kp=kp, identified=known, captured=captured)
        for kp in (0.75, 1.25)
        for word, known, captured in (
            ("identified", True, False),
            ("not identified", False, False),
            ("not identified, gravity captured", False, True),
        )
    ),
    Disturbance(name="payload 0.3 kg", payload=0.3),
    Disturbance(name="payload 0.3 kg, gravity captured", payload=0.3, captured=True),
    Disturbance(name="encoder 0.088°, flicker", count=np.deg2rad(0.088)),
    Disturbance(name="a tick each way", delay=(1, 1)),
)


@dataclass(frozen=True, kw_only=True)
class Promise:
    """Expected force for one cap in one pose, and the measured result.

    Attributes:
        pose: Index among the arm's poses.
        axis: Name of the axis.
        sign: Direction of the push, 1 or -1.
        cap: Cap F [N or N·m].
        guided: True if springs held the other axes.
        refused: True if the servos cannot exert the cap in this pose; the push was not run, and the
            attributes below have no value.
        announced: True if the report of the controller predicted a force outside the band: the push
            moves a joint to its stop, and the friction of the remaining joints exceeds the band.
        rubs: Reported friction force of the remaining joints at the stop; 0 if not `announced`
            [N or N·m].
        promise: Expected force min(F, (1 - η)|e| / C_jj) at the deviation e [N or N·m].
        measured: Measured force on the hand [N or N·m].
        friction: Force on the hand by friction and damping, Σ_i |J⁺_ij| (τ_f,i + d_i |q̇_i|) over
            the joints i, with the assumed dry friction τ_f; damping d counts only for a hand whose
            force is evaluated in motion [N or N·m].
        true_friction: The force `friction` with the true instead of the assumed dry friction
            [N or N·m].
        band: Largest allowed difference between measured and expected force [N or N·m].
        stop: Force on the hand by the joint stops, Σ_i J⁺_ij t_i, with the torque t of each stop;
            0 if no joint touches its stop [N or N·m].
        left: Friction force Σ_i |J⁺_ij| τ_f,i of the joints that are not locked [N or N·m].
        locked: True if the controller locked a joint at its position limit.
        room: Smallest distance of a joint to its position limit at the end [rad].
        drift: Largest distance of the tool from the target along the stiff translations, during the
            evaluated time at the end [m].
        speed: Rms speed of the joints during the evaluated time at the end [rad/s].

    The module's docstring defines F, η, e, C_jj and J⁺.
    """

    pose: int
    axis: str
    sign: float
    cap: float
    guided: bool
    refused: bool
    announced: bool = False
    rubs: float = 0.0
    promise: float = np.nan
    measured: float = np.nan
    friction: float = np.nan
    true_friction: float = np.nan
    band: float = np.nan
    stop: float = 0.0
    left: float = np.nan
    locked: bool = False
    room: float = np.nan
    drift: float = np.nan
    speed: float = np.nan

    @property
    def error(self) -> float:
        """Measured minus expected force, as a share of the cap."""
        return (self.measured - self.promise) / self.cap

    @property
    def kept(self) -> bool:
        """True if the measured force is in the band."""
        return abs(self.measured - self.promise) <= self.band

    @property
    def kept_as_said(self) -> bool:
        """True if the force is in the band that has the larger one of `rubs` and `friction`."""
        return abs(self.measured - self.promise) <= self.band + max(self.rubs - self.friction, 0.0)

    @property
    def stopped(self) -> bool:
        """True if the measured force is outside the band only because of a joint stop.

        The measured force minus `stop` is then in the band, with the friction `left` of the joints
        that still move.
        """
        if self.kept or not (self.locked or self.stop != 0.0):
            return False
        band = self.band - self.friction + max(self.left, self.friction)
        return abs(self.measured - self.stop - self.promise) <= band


class Bench:
    """Simulated arm, hand and controllers under one disturbance, for any number of pushes."""

    def __init__(self, arm: Arm, disturbance: Disturbance = UNDISTURBED) -> None:
        """Build the simulated arm and the hand."""
        self.arm, self.disturbance = arm, disturbance
        self.scale = arm.median_capacity[0] / OF_CAPACITY
        self.grip = Grip(self.scale)
        self.plant = Plant(
            arm.model,
            scene=[self.grip],
            delay=disturbance.delay,
            encoder_step=disturbance.count,
            encoder_flicker=1 if disturbance.count else 0,
            kp_scale=disturbance.kp,
            payload=(disturbance.payload, (0.0, 0.0, 0.0)) if disturbance.payload else None,
            friction=disturbance.gears or "coulomb",
        )
        known = disturbance.kp if disturbance.identified else 1.0
        count = disturbance.count
        self.servos = arm.servos.replace(kp=known * np.asarray(arm.servos.kp), encoder_step=count)
        if disturbance.gears is not None and disturbance.gears_known:
            self.servos = disturbance.gears.assumed(self.servos)
        self.compliance = 1.0 / np.asarray(self.servos.kp)
        gains = self.plant.gains
        self.damping = gains.damping + gains.kv
        self._controllers: dict[tuple[str, float], pliant.Controller] = {}
        self._captured: tuple[bytes, Array, Array] | None = None

    def promises(self, pose: int, q: Array) -> list[Promise]:
        """Push the arm in pose q (n,) [rad] and compare its forces with the promised ones.

        It is pushed along every axis, in both directions and with every force cap, with the other
        axes free and with the other axes guided by springs. `pose` is the index of the pose.
        """
        return [
            self.keep(pose, q, axis, sign, cap, guided=guided)
            for axis, row in zip(self.arm.axes, self.arm.rows, strict=True)
            for sign in (1.0, -1.0)
            for cap in self.arm.caps(row)
            for guided in (False, True)
        ]

    def keep(
        self, pose: int, q: Array, axis: str, sign: float, cap: float, *, guided: bool
    ) -> Promise:
        """Push the tool along one soft axis with the hand; return expected and measured force.

        Args:
            pose: Index of the pose.
            q: The pose (n,) [rad].
            axis: Name of the axis.
            sign: Direction of the push, 1 or -1.
            cap: Cap of the axis [N or N·m].
            guided: True if springs hold the other axes.
        """
        row, disturbance = AXES.index(axis), self.disturbance
        axis_options: dict[str, Any] = {
            "pose": pose,
            "axis": axis,
            "sign": sign,
            "cap": cap,
            "guided": guided,
        }
        if self.arm.capacity(q, row, sign, disturbance.payload) < cap:
            return Promise(**axis_options, refused=True)
        controller = self._controller(axis, cap)
        if disturbance.captured:
            controller.capture_gravity(*self._capture(q))
        plant, grip, model = self.plant, self.grip, self.arm.model
        plant.reset(q)
        controller.reset(q)
        grip.hold(self.arm.rows if guided else [row])
        report = controller.report(q).axes[axis]
        stop = report.stop[int(sign > 0.0)]
        stop_distance = np.inf if stop is None else stop.distance
        distance, speed = self._hand_motion(q, row, cap)
        if disturbance.short < np.inf:
            distance = min(distance, disturbance.short * stop_distance)
        # A joint meets its stop only if the tool moves far enough. The tool moves less than the
        # hand, by the stretch of the hand's spring at the largest force in the band.
        tolerance, rubs = (0.40 if disturbance.wrong else 0.15) * cap, report.friction
        tool_distance = distance - (cap + tolerance + rubs) / grip.stiffness[row]
        announced = (
            stop is not None and stop.distance < tool_distance and stop.friction > rubs + tolerance
        )
        target = model.forward_kinematics(q)
        last = START + distance / speed
        end = last if disturbance.moving else last + REST
        forces, displacements, speeds, drift = [], [], [], 0.0
        stiff = [r for r in range(3) if r != row]
        stiff = [r for r in stiff if r in self.arm.rows]

        def push(time: float, plant: Plant) -> None:
            grip.move(row, sign * speed if START <= time < last - 1e-9 else 0.0)

        goal = target[:3, 3] if self._has_no_rotation else target
        for time, _, _ in closed_loop(plant, controller, goal, end, on_tick=push):
            if time >= end - EVALUATED:
                error = pliant.functional.pose_error(plant.tool, target)
                forces.append(sign * grip.force(row))
                displacements.append(abs(error[row]))
                speeds.append(np.abs(plant.dq))
                drift = max(drift, float(np.linalg.norm(error[stiff])))
        jacobian = model.jacobian(plant.q)[self.arm.rows]
        column = np.linalg.pinv(jacobian)[:, self.arm.rows.index(row)]
        inverse = np.abs(column)
        c = float(jacobian[self.arm.rows.index(row)] ** 2 @ self.compliance)
        joint_speed = np.mean(speeds, axis=0)
        rubs = self.damping * joint_speed if disturbance.moving else 0.0 * joint_speed
        dry = self._dry_friction(plant.q)
        friction = float(inverse @ (dry + rubs))
        moves = ~np.asarray(controller.diagnostics.locked)
        weights = np.abs(np.linalg.pinv(jacobian[:, moves])[:, self.arm.rows.index(row)])
        space = np.minimum(plant.q - model.lower, np.asarray(model.upper) - plant.q)
        return Promise(
            **axis_options,
            refused=False,
            announced=announced,
            rubs=stop.friction if stop is not None and announced else 0.0,
            promise=min(cap, (1.0 - disturbance.eta) * float(np.mean(displacements)) / c),
            measured=float(np.mean(forces)),
            friction=friction,
            true_friction=float(inverse @ (plant.friction + rubs)),
            band=(0.40 if disturbance.wrong else 0.15) * cap + friction,
            stop=-sign * float(column @ self._stop_torques()),
            left=float(weights @ dry[moves]),
            locked=bool(np.any(controller.diagnostics.locked)),
            room=float(space.min()),
            drift=drift,
            speed=float(np.sqrt(np.mean(np.square(speeds)))),
        )

    def _dry_friction(self, q: Array) -> Array:
        """Return the assumed dry friction (n,) [N·m] of joints at rest that carry the arm."""
        s, weight = self.servos, np.abs(self.arm.model.gravity(q))
        at_rest: Array = np.asarray(s.friction) + s.stribeck
        return at_rest + (np.asarray(s.load_friction) + s.load_stribeck) * weight

    @property
    def _has_no_rotation(self) -> bool:
        """Return True if the task has no rotations."""
        return not any(row > 2 for row in self.arm.rows)

    def _hand_motion(self, q: Array, row: int, cap: float) -> tuple[float, float]:
        """Return distance [m or rad] and speed [m/s or rad/s] of the hand along an axis.

        Args:
            q: Pose (n,) [rad] of the push.
            row: Index of the axis.
            cap: Cap of the axis [N or N·m].
        """
        kind = row // 3
        c = float(self.arm.model.jacobian(q)[row] ** 2 @ self.compliance)
        distance = DISTANCE_FACTOR * cap * c / (1.0 - self.disturbance.eta) + EXTRA_DISTANCE[kind]
        length = min(distance, MAX_DISTANCE[kind]) + cap / self.grip.stiffness[row]
        return length, MOVING_SPEED[kind] if self.disturbance.moving else length / RISE

    def _settings(self, **options: Any) -> pliant.Settings:
        delay = sum(self.disturbance.delay) / self.plant.rate
        task = " ".join(self.arm.axes)
        return pliant.Settings(task=task, delay=delay, **NO_RATE_LIMITS).replace(**options)

    def _controller(self, axis: str, cap: float) -> pliant.Controller:
        key = (axis, cap)
        if key not in self._controllers:
            soft = pliant.Axis(soft=cap, firm=cap, adaptation=self.disturbance.eta)
            settings = self._settings(axes={axis: soft})
            self._controllers[key] = pliant.Controller(self.arm.model, settings, self.servos)
        return self._controllers[key]

    def _capture(self, q: Array) -> tuple[Array, Array]:
        """Hold q for 2 s with integral control; return final positions and goals (n,) [rad]."""
        if self._captured is None or self._captured[0] != q.tobytes():
            # Switch the friction feed-forward off: together with integration, it made 9 of 20 poses
            # oscillate with a true k_p of 0.75 times the assumed one.
            holding = self._settings(
                tracking=pliant.Tracking(integrate=4.0),
                compensation=pliant.Compensation(friction=0.0, damping=0.0),
            )
            controller = pliant.Controller(self.arm.model, holding, self.servos)
            self.plant.reset(q)
            controller.reset(q)
            self.grip.hold([])
            target = self.arm.model.forward_kinematics(q)
            goal = q
            if self._has_no_rotation:
                target = target[:3, 3]
            for _, _, command in closed_loop(self.plant, controller, target, 2.0):
                goal = command.goal
            self._captured = (q.tobytes(), np.array(self.plant.read().q), np.array(goal))
        return self._captured[1:]

    def _stop_torques(self) -> Array:
        """Return the torques (n,) [N·m] that mechanical stops exert on the joints at present."""
        model, data, arm = self.plant.mj_model, self.plant.mj_data, self.arm.model
        out = np.zeros(arm.n)
        stops = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
        q, names = self.plant.q, list(arm.joint_names)
        for joint, force in zip(data.efc_id[stops], data.efc_force[stops], strict=True):
            name = model.joint(joint).name
            if name in names:
                i = names.index(name)
                upper = arm.upper[i] - q[i] < q[i] - arm.lower[i]
                out[i] += -force if upper else force
        return out


# --- Jobs of the campaign, in one process or several ---

#: Number of poses of `arm7`, number of poses of every other arm, and divisor that gives the number
#: of poses for each disturbance.
POSES, OTHER_POSES, TENTH = 200, 50, 10
#: Identified friction of the gears, by arm.
REAL_GEARS = {"arm7": Friction.of([MX106] * 4 + [MX64] * 3), "so101": STS3215}


@dataclass(frozen=True)
class Job:
    """All pushes on one arm in one pose under one disturbance."""

    arm: str
    disturbance: Disturbance
    pose: int

    def run(self) -> list[Promise]:
        """Run all pushes and return their results."""
        bench = _bench(self.arm, self.disturbance.name)
        return bench.promises(self.pose, bench.arm.poses(self.pose + 1)[self.pose])


def gears(arm: str) -> tuple[Disturbance, Disturbance]:
    """Return two disturbances of an arm, whose gears have friction identified on real servos.

    The controller does not know this friction in the first disturbance, and knows it in the second.

    Raises:
        KeyError: `REAL_GEARS` does not have this arm.
    """
    unknown = replace(UNDISTURBED, name="gears as they are", gears=REAL_GEARS[arm])
    return unknown, replace(unknown, name="gears as they are, identified", gears_known=True)


@lru_cache(maxsize=2)
def _bench(arm: str, disturbance: str) -> Bench:
    """Return the `Bench` of an arm under a disturbance; consecutive jobs share it."""
    known = {option.name: option for option in (UNDISTURBED, *DISTURBANCES)}
    if disturbance not in known:
        known |= {option.name: option for option in gears(arm)}
    return Bench(load(arm), known[disturbance])


def campaign_jobs(
    arms: Sequence[str], poses: int, *, disturbed: bool = True, friction: bool = False
) -> list[Job]:
    """Return all jobs of a campaign.

    Args:
        arms: Names of the arms.
        poses: Number of poses of `arm7`; other arms have a quarter, each disturbance a tenth.
        disturbed: True includes the disturbances, on `arm7` only.
        friction: True includes the disturbances of `gears`, on arms of `REAL_GEARS`.
    """
    out: list[Job] = []
    for name in arms:
        main = name == "arm7"
        count = len(load(name).poses(poses if main else -(-poses * OTHER_POSES // POSES)))
        out += [Job(name, UNDISTURBED, pose) for pose in range(count)]
        tenth = max(1, count // TENTH)
        if main and disturbed:
            out += [Job(name, case, pose) for case in DISTURBANCES for pose in range(tenth)]
        if friction and name in REAL_GEARS:
            out += [Job(name, case, pose) for case in gears(name) for pose in range(tenth)]
    return out


def run_campaign(
    work: Sequence[Job], processes: int = 1, resume: Path | None = None
) -> Iterator[tuple[Key, list[Promise]]]:
    """Run jobs, in parallel if joblib is installed.

    Args:
        work: Jobs, in which those of the same arm and disturbance are consecutive.
        processes: Number of processes.
        resume: Folder of saved results, see `run_jobs`.

    Yields:
        Pairs: the names of arm and disturbance, and the list of results of their jobs.
    """
    results = run_jobs(work, processes, "campaign", resume)
    pairs = zip(work, results, strict=True)
    for key, group in groupby(pairs, key=lambda pair: (pair[0].arm, pair[0].disturbance.name)):
        yield key, [promise for _, promises in group for promise in promises]


# --- Statistics of the campaign: table, file and picture ---

#: A pose counts as clear of stops if every joint is at least this far from its stops [rad].
CLEAR = 0.15
#: Required shares of forces in the band: without a disturbance, and with one.
GOALS = (0.97, 0.95)


@dataclass(frozen=True, kw_only=True)
class Row:
    """Statistics of the pushes of one arm under one disturbance.

    Shares are of the pushes that were run, if not stated otherwise. `Promise` defines the terms.

    Attributes:
        arm, disturbance: Names of arm and disturbance.
        poses: Number of poses.
        cases: Number of pushes, including refused ones.
        refused: Share of all pushes in which the servos cannot exert the cap.
        kept: Share of pushes whose force is in the band.
        kept_free, kept_guided: Share in the band of the pushes with the other axes free, and of
            those with the other axes guided by springs.
        announced: Share of pushes for which the report predicted a force outside the band.
        kept_rest: Share in the band of the pushes that are not announced; must reach `GOALS`.
        kept_announced: Share in the band of the announced pushes.
        as_said: Share of the announced pushes with `Promise.kept_as_said`.
        stopped: Share of pushes outside the band only because of a joint stop.
        kept_clear: Share in the band of the pushes that are `clear`.
        clear: Share of pushes at whose end every joint is at least `CLEAR` from its stops.
        kept_truly: Share in a band that is computed with the true friction.
        median, p95: Median and 95th percentile of |measured - expected| force over the cap.
        median_free, p95_free: `median` and `p95` of the pushes with the other axes free.
        drift: 95th percentile of `Promise.drift` over the pushes along x, y, z with the middle cap
            and the other axes free [mm].
        drift_kept: Share of the pushes counted in `drift` whose drift is below 5 mm.
        friction: Median of the friction force over the cap.
    """

    arm: str
    disturbance: str
    poses: int
    cases: int
    refused: float
    kept: float
    kept_free: float
    kept_guided: float
    announced: float
    kept_rest: float
    kept_announced: float
    as_said: float
    stopped: float
    kept_clear: float
    clear: float
    kept_truly: float
    median: float
    p95: float
    median_free: float
    p95_free: float
    drift: float
    drift_kept: float
    friction: float

    @property
    def met(self) -> bool:
        """True if `kept_rest` reaches the share that `GOALS` requires."""
        return self.kept_rest >= GOALS[self.disturbance != "nominal"]


def summary(arm: str, disturbance: str, promises: Sequence[Promise]) -> Row:
    """Return the statistics of the results `promises` of one arm under one disturbance."""
    run = [promise for promise in promises if not promise.refused]
    caps = {axis: sorted({p.cap for p in promises if p.axis == axis}) for axis in "xyz"}
    drifts = [
        1e3 * p.drift
        for p in run
        if not p.guided and caps.get(p.axis) and p.cap == caps[p.axis][len(caps[p.axis]) // 2]
    ]
    free = [p for p in run if not p.guided]
    clear_pushes = [p for p in run if p.room >= CLEAR]
    return Row(
        arm=arm,
        disturbance=disturbance,
        poses=len({p.pose for p in promises}),
        cases=len(promises),
        refused=1.0 - len(run) / max(len(promises), 1),
        kept=_share([p.kept for p in run]),
        kept_free=_share([p.kept for p in free]),
        kept_guided=_share([p.kept for p in run if p.guided]),
        announced=_share([p.announced for p in run]),
        kept_rest=_share([p.kept for p in run if not p.announced]),
        kept_announced=_share([p.kept for p in run if p.announced]),
        as_said=_share([p.kept_as_said for p in run if p.announced]),
        stopped=_share([p.stopped for p in run]),
        kept_clear=_share([p.kept for p in clear_pushes]),
        clear=len(clear_pushes) / max(len(run), 1),
        kept_truly=_share(
            [abs(p.measured - p.promise) <= p.band - p.friction + p.true_friction for p in run]
        ),
        median=_quantile([abs(p.error) for p in run], 0.5),
        p95=_quantile([abs(p.error) for p in run], 0.95),
        median_free=_quantile([abs(p.error) for p in free], 0.5),
        p95_free=_quantile([abs(p.error) for p in free], 0.95),
        drift=_quantile(drifts, 0.95),
        drift_kept=_share([d < 5.0 for d in drifts]),
        friction=_quantile([p.friction / p.cap for p in run], 0.5),
    )


def _share(values: Sequence[bool]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _quantile(values: Sequence[float], q: float) -> float:
    return float(np.quantile(values, q)) if values else float("nan")


COLUMNS = (
    *("arm", "disturbance", "poses", "cases", "refused %", "stop announced %"),
    *("in band % of the rest", "strictly, of all", "free", "guided", "of the announced"),
    *("as said", "by a limit", "clear of stops", "true friction", "error: median %", "95th %"),
    *("free: median", "95th", "drift 95th [mm]", "< 5 mm %", "met"),
)


def text(rows: Sequence[Row]) -> str:
    """Return the statistics as a Markdown table."""
    lines = []
    for r in rows:
        shares = (
            r.refused,
            r.announced,
            r.kept_rest,
            r.kept,
            r.kept_free,
            r.kept_guided,
            r.kept_announced,
            r.as_said,
            r.stopped,
            r.kept_clear,
            r.kept_truly,
        )
        errors = (r.median, r.p95, r.median_free, r.p95_free)
        cells = [r.arm, r.disturbance, str(r.poses), str(r.cases)]
        cells += [f"{100.0 * value:.1f}" for value in (*shares, *errors)]
        cells += [f"{r.drift:.1f}", f"{100.0 * r.drift_kept:.0f}", "yes" if r.met else "NO"]
        lines.append(cells)
    return markdown.table(COLUMNS, lines)


def save_results(
    folder: Path, rows: Sequence[Row], results: Results, options: Mapping[str, Any]
) -> None:
    """Write `results.json` into a folder: options, statistics, and every push outside the band.

    `options` are those of the campaign.
    """
    outside = [
        {"arm": arm, "disturbance": disturbance, **asdict(promise)}
        for (arm, disturbance), promises in results.items()
        for promise in promises
        if not (promise.refused or promise.kept)
    ]
    write_results(folder, {**options, "rows": [asdict(row) for row in rows], "missed": outside})


def draw(folder: Path, rows: Sequence[Row], results: Results) -> None:
    """Draw `campaign.png`: distributions of the force errors, by arm and by disturbance.

    The second panel has the disturbances of the first arm in `rows`.
    """
    first = rows[0].arm if rows else ""
    panels = {
        "Nominal, by arm": {arm: p for (arm, name), p in results.items() if name == "nominal"},
        f"{first}, one disturbance at a time": {
            name: p for (arm, name), p in results.items() if arm == first
        },
    }
    draw_errors(panels, folder, "campaign")


# --- Picture of the force errors ---


def draw_errors(panels: Mapping[str, Groups], folder: Path, stem: str) -> None:
    """Draw distributions of force errors in panels side by side, with one line per group.

    Refused pushes are ignored.

    Args:
        panels: Groups of pushes, by the title of the panel.
        folder: Target folder.
        stem: File name of the picture, without extension.
    """
    lines = max(4, *(len(groups) for groups in panels.values()))
    with canvas(1, len(panels), size=(WIDE, 1.2 + 0.42 * lines)) as (figure, axes):
        for ax, (title, groups) in zip(axes[0], panels.items(), strict=True):
            _draw_quantiles(ax, groups)
            ax.set_title(title)
        save(figure, folder, stem)


def _draw_quantiles(ax: Any, groups: Groups) -> None:
    """Draw one line per group: middle 95 % and 50 % of the errors, median, share in the band."""
    for position, promises in enumerate(reversed(list(groups.values()))):
        run = [p for p in promises if not p.refused]
        if not run:
            continue
        marks = 100.0 * np.quantile([p.error for p in run], (0.025, 0.25, 0.5, 0.75, 0.975))
        low, a, middle, b, high = np.clip(marks, -100.0, 100.0)
        ax.plot((low, high), (position, position), color=SKY, linewidth=2.0)
        ax.plot((a, b), (position, position), color=BLUE, linewidth=6.0)
        ax.plot(middle, position, "|", color=CARD, markersize=8, markeredgewidth=1.5)
        share = 100.0 * float(np.mean([p.kept for p in run]))
        ax.annotate(
            f"{share:.1f} % in band",
            (1.0, position),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="center",
            fontsize=7.5,
            color=MUTED,
        )
    ax.set_yticks(range(len(groups)), list(reversed(list(groups))))
    ax.set_xlim(-105.0, 185.0)
    ax.set_xticks((-100, -50, 0, 50, 100), ("≤ −100", "−50", "0", "50", "≥ 100"))
    ax.set_ylim(-0.6, len(groups) - 0.2)
    ax.axvline(0.0, color=MUTED, linewidth=0.7)
    ax.set_xlabel("felt − promised [% of the cap]: middle 95 %, half, median")


# --- The program ---


def gears_text() -> str:
    """Measure drag and door experiments of `arm7` with different friction of the gears.

    The friction is that of the servo table, or the friction identified on real gears; the
    controller does not know, knows or underestimates the latter.

    Returns:
        Markdown table with forces in N, drift in mm, and the door's opening in deg.
    """
    measures = {
        "15 N hand": goals.measure_drag(controllers.cap(), DRAG_15N),
        "strong hand": goals.measure_drag(controllers.cap(), DRAG_80N),
        "door, rigid grip": goals.door("door"),
    }
    gears = REAL_GEARS["arm7"]
    conditions = {
        "friction of the table": NOMINAL,
        "gears as they are": Conditions(gears=gears),
        "identified": Conditions(gears=gears, gears_known=True),
        "assumed × 0.7": Conditions(gears=gears, gears_known=True, assumed_ratio=0.7),
        "identified, a tick each way": Conditions(gears=gears, gears_known=True, delay=(1, 1)),
    }
    return goals.comparison(measures, conditions)


def main(
    *,
    poses: int = POSES,
    arm: command_line.Arms = (),
    jobs: int = 2,
    out: Path = Path("pliant-campaign"),
    friction: bool = False,
    disturbed: bool = True,
    resume: Path | None = None,
) -> None:
    """Compare every cap with the force on a hand.

    Args:
        poses: Number of poses of arm7; other arms have a quarter, each disturbance a tenth.
        arm: Names of the arms; default: all.
        jobs: Number of processes.
        out: Folder for results.json and the picture.
        friction: True includes Stribeck and load-dependent friction.
        disturbed: True includes the disturbances on arm7.
        resume: Folder in which results are kept; a second run continues there.
    """
    names, absent = available()
    for name in absent:
        print(f"campaign: SKIPPED {name}: its URDF is not in {ROBOTS}: set PLIANT_ROBOTS")
    arms = list(arm) or names
    work = campaign_jobs(arms, poses, disturbed=disturbed, friction=friction)
    results: dict[tuple[str, str], list[Promise]] = {}
    rows: list[Row] = []
    for key, promises in run_campaign(work, jobs, resume):
        results[key] = promises
        rows.append(summary(*key, promises))
        lines = text(rows).splitlines()
        print("\n".join(lines[-1:] if len(rows) > 1 else lines), flush=True)
    if friction and "arm7" in arms:
        print(gears_text())
    save_results(out, rows, results, {"poses": poses, "arms": arms, "skipped": absent})
    draw(out, rows, results)
    print(f"campaign: {out / 'results.json'}, {out / 'campaign.png'}")


if __name__ == "__main__":
    command_line.start(main)
