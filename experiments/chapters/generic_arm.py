"""Chapters of the report for any arm: built-in, or from a URDF with estimated servo parameters.

The experiments start in a random pose that is chosen for the arm, see `_find_pose`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from matplotlib.ticker import MultipleLocator

import pliant
from experiments import arms, controllers, metrics, poses, simulation
from experiments.campaign import Bench
from experiments.chapters.activation import heat, posture, show
from experiments.chapters.common import LAW_COLOURS, names, shade
from experiments.demonstration import Subject
from experiments.poses import AXES
from experiments.report import (
    Chapter,
    Figure,
    Numbers,
    at_least,
    at_most,
    band,
    mm,
    near,
)
from experiments.runner import Job
from pliant import ConfigError, robots
from pliant._report.page import Table
from pliant._report.style import (
    AXIS_COLOURS,
    BLUE,
    INK,
    MUTED,
    SKY,
    WIDE,
    canvas,
    label_end,
    save,
    thin,
)
from pliant.sim import Plant
from pliant.sim._parameters import ARMATURE_SHARE, DAMPING_SHARE, FRICTION_SHARE, FULL_EFFORT_ERROR
from pliant.sim.hand import Drag

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from experiments.campaign import Promise
    from experiments.chapters.common import Options
    from experiments.poses import Array
    from experiments.simulation import Trace
    from pliant.sim import Hand


#: Number of random poses among which the start pose of the experiments is chosen, and central share
#: of each joint's range in which these poses lie.
SEARCHED, INNER = 512, 0.6
#: A joint without effort limit in the URDF is assumed to have this multiple of the largest gravity
#: torque on it in random poses, but at least `LEAST_EFFORT` [N·m].
STRONG_ENOUGH, LEAST_EFFORT = 4.0, 0.5
#: Distance by which experiments move the tool along the soft axis: share of the arm's reach, and
#: smallest and largest distance [m].
WAY_SHARE, WAY_RANGE = 0.2, (0.03, 0.15)
#: Number of points along the soft axis at which a start pose is checked.
STEPS = 12
#: Largest share of a servo's usable torque that gravity may need in the start pose.
GRAVITY_SHARE = 0.6


@dataclass(frozen=True)
class Source:
    """Source of an arm: the name of a built-in arm, or else a URDF with base and tip frame."""

    name: str = ""
    urdf: str = ""
    base: str | None = None
    tip: str | None = None


@dataclass(frozen=True)
class Arm(arms.Arm):
    """Arm with the pose and the soft axis of its experiments.

    Attributes:
        soft: Name of the soft axis.
        pose: Start pose of the experiments (n,) [rad].
        way: Distance by which the tool can move from `pose` along the soft axis, both ways [m].
        notes: Assumptions, as texts for the report.
    """

    soft: str
    pose: Array
    way: float
    notes: tuple[str, ...]

    @property
    def where(self) -> str:
        """Start pose and its choice as text for the report."""
        angles = ", ".join(f"{angle:.2f}" for angle in self.pose)
        return (
            f"pose ({angles}) rad, the best conditioned of {SEARCHED} random ones in which gravity "
            "needs little torque and the soft axis can move"
        )

    def law(self, *, soft: str | None = None, eta: float = 0.0, **options: Any) -> pliant.Settings:
        """Return settings of law cap with the task axes and default caps of this arm.

        Args:
            soft: Names of the soft axes; "" for none; None: `Arm.soft`.
            eta: Target adaptation of the soft axes.
            **options: Further settings.
        """
        task = pliant.Task(axes=" ".join(self.axes))
        return controllers.cap(
            soft=self.soft if soft is None else soft, eta=eta, task=task, **options
        )


@cache
def load(source: Source) -> Arm:
    """Return an arm with servo parameters, estimated if it has none, and a start pose.

    Args:
        source: Source of the arm.

    Raises:
        PliantError: The URDF is rejected, or no pose lets the soft axis move.
    """
    plain_arm = arms.Arm(source.name, robots.load(source.name)) if source.name else None
    notes: tuple[str, ...] = ()
    if plain_arm is None:
        model, notes = _from_urdf(source)
        plain_arm = arms.Arm(model.name, model)
    if plain_arm.model.n < 2:
        raise ConfigError(
            f"the chain has {plain_arm.model.n} joint; the experiments need at least 2"
        )
    soft = "y" if "y" in plain_arm.axes else "x"
    distance = float(np.clip(WAY_SHARE * plain_arm.model.reach, *WAY_RANGE))
    pose, distance = _find_pose(plain_arm, soft, distance)
    return Arm(plain_arm.name, plain_arm.model, soft, pose, distance, notes)


def _from_urdf(source: Source) -> tuple[pliant.Model, tuple[str, ...]]:
    """Return the model of a URDF with servos estimated from effort limits, and notes on them."""
    model = pliant.Model.from_urdf(source.urdf, base=source.base, tip=source.tip)
    effort = np.array(model.effort_limit, dtype=np.float64)
    unknown = ~(effort > 0.0)
    notes = [
        "No servo data: stiffness, friction, damping and rotor inertia are guessed from the effort "
        f"limits of the URDF (k_p = effort / {FULL_EFFORT_ERROR} rad, friction "
        f"{FRICTION_SHARE:.0%}, damping {DAMPING_SHARE:.0%} s/rad of the effort). The numbers show "
        "what the law does with such servos, not what this arm does."
    ]
    if unknown.any():
        holding = np.abs([model.gravity(q) for q in sample(model)]).max(axis=0)
        effort[unknown] = np.maximum(STRONG_ENOUGH * holding[unknown], LEAST_EFFORT)
        names = ", ".join(
            name for name, is_unknown in zip(model.joint_names, unknown, strict=True) if is_unknown
        )
        notes.append(
            f"No effort limit either for {names}: {STRONG_ENOUGH:g} times the largest torque that "
            "holds the arm was taken."
        )
    kp = effort / FULL_EFFORT_ERROR
    servos = pliant.Servos(
        kp=kp,
        max_torque=effort,
        friction=FRICTION_SHARE * effort,
        damping=DAMPING_SHARE * effort,
        armature=ARMATURE_SHARE * kp,
        stiffness_known=True,
    )
    return model.with_servos(servos), tuple(notes)


def sample(model: pliant.Model, inner: float = 1.0) -> Array:
    """Return random poses (512, n) [rad] from the central share `inner` of the joint ranges."""
    lower, upper = arms.ranges(model)
    middle, half = (lower + upper) / 2, inner * (upper - lower) / 2
    return np.random.default_rng(0).uniform(middle - half, middle + half, (SEARCHED, model.n))


def _find_pose(arm: arms.Arm, soft: str, distance: float) -> tuple[Array, float]:
    """Return the start pose (n,) [rad] of the experiments, and the motion that it allows [m].

    The pose has the largest `Arm.sigma` of the random poses in which gravity needs at most
    `GRAVITY_SHARE` of the torque, and from which the tool can move along the axis `soft` by
    `distance` [m] in both directions. If there is no such pose, 60 % and then 35 % of it suffice.
    """
    max_torque = np.asarray(arm.servos.max_torque)
    light = [
        q
        for q in sample(arm.model, INNER)
        if np.all(np.abs(arm.model.gravity(q)) <= GRAVITY_SHARE * max_torque)
    ]
    candidates = sorted(light, key=lambda q: -arm.sigma(q))
    for share in (1.0, 0.6, 0.35):
        for q in candidates[:100]:
            if all(_can_move(arm, q, soft, side * share * distance) for side in (1.0, -1.0)):
                return q, share * distance
    raise ConfigError(
        f"among {SEARCHED} poses none lets {soft} move by {0.35 * distance:.3f} m within the joint "
        "limits and torques"
    )


def _can_move(arm: arms.Arm, q: Array, soft: str, distance: float) -> bool:
    """Return True if the tool can move from q (n,) [rad] along the axis `soft` by `distance` [m].

    On the way, every joint stays within its position limits and `Arm.sigma` above 40 % of its
    value at q.
    """
    lower, upper = arms.ranges(arm.model)
    min_sigma = 0.4 * arm.sigma(q)
    motion = np.zeros(len(arm.rows))
    motion[arm.axes.index(soft)] = distance / STEPS
    margin = 0.02 * (upper - lower)
    joints = q.copy()
    for _ in range(STEPS):
        joints = joints + np.linalg.pinv(np.asarray(arm.model.jacobian(joints))[arm.rows]) @ motion
        is_inside = np.all((joints >= lower + margin) & (joints <= upper - margin))
        if not is_inside or arm.sigma(joints) < min_sigma:
            return False
    return True


# --- Runs with any arm: functions that a job can call in another process ---

RATE = 100.0
#: Stiffness [N/m] and damping [N·s/m] of the simulated hand for an axis whose force cap is `USUAL`
#: [N]; both scale with the cap.
SPRING, DAMPER, USUAL = 2000.0, 30.0, 15.0


@dataclass(frozen=True, kw_only=True)
class Strengths:
    """Default force caps of law cap for the soft axis of an arm.

    Attributes:
        soft: Cap of the axis at zero deviation [N].
        firm: Cap of the axis at a large deviation [N].
        hold: Cap of the same axis if it is stiff [N].
    """

    soft: float
    firm: float
    hold: float


def _loop(
    arm: Arm,
    settings: pliant.Settings,
    target: Array | simulation.Target,
    duration: float,
    *scene: Hand,
    q: Array,
) -> Trace:
    plant = Plant(
        arm.model, arm.servos, rate=RATE, encoder_step=arm.servos.encoder_step, scene=scene
    )
    controller = pliant.Controller(arm.model, settings.replace(rate=RATE), arm.servos)
    return simulation.run(plant, controller, target, duration, q=q)


def activation(source: Source) -> Array:
    """Return the activation matrix at the start pose: (n, k + 1) for n joints and k task axes."""
    arm = load(source)
    controller = pliant.Controller(
        arm.model, arm.law(soft="", tracking=pliant.Tracking(damping=0.0)), arm.servos
    )
    controller.reset(arm.pose)
    controller.step(arm.pose, arm.model.forward_kinematics(arm.pose))
    return np.asarray(controller.diagnostics.activation)


def strengths(source: Source) -> Strengths:
    """Return the default force caps of an arm, from the diagnostics of its controller."""
    arm = load(source)
    start = np.asarray(arm.model.forward_kinematics(arm.pose))
    row = arm.axes.index(arm.soft)

    def strength(soft: str, deviation: float) -> float:
        controller = pliant.Controller(arm.model, arm.law(soft=soft), arm.servos)
        controller.reset(arm.pose)
        controller.step(arm.pose, poses.displaced(start, arm.soft, deviation))
        return float(controller.diagnostics.axis_strength[row])

    # At this deviation the cap is `firm`; the controller rejects targets far out of reach.
    length = min(1.0, float(arm.model.reach))
    return Strengths(
        soft=strength(arm.soft, 0.0), firm=strength(arm.soft, length), hold=strength("", 0.0)
    )


def hand(arm: Arm, distance: float, strongest: float) -> Drag:
    """Return a hand that drags the tool along the soft axis by a signed `distance` [m].

    Its stiffness, damping and largest force scale with `strongest`, the largest cap of the axis
    [N].
    """
    scale = max(strongest / USUAL, 0.05)
    return Drag(
        axis=arm.soft,
        distance=distance,
        stiffness=SPRING * scale,
        damping=DAMPER * scale,
        limit=8.0 * strongest,
        at="tool",
    )


def drag(source: Source, kind: str, eta: float, sign: int) -> Trace:
    """Drag the tool along `Arm.soft` from 2 to 5 s, release it, and return the record of 9 s.

    Args:
        source: Source of the arm.
        kind: `soft`: the dragged axis is soft; `stiff`: all axes are stiff.
        eta: Target adaptation of the soft axis.
        sign: Direction of the drag, 1 or -1.
    """
    arm = load(source)
    firm = strengths(source).firm
    settings = arm.law(soft="" if kind == "stiff" else arm.soft, eta=eta)
    target = np.asarray(arm.model.forward_kinematics(arm.pose))
    return _loop(arm, settings, target, 9.0, hand(arm, sign * arm.way, firm), q=arm.pose)


def swing(source: Source) -> Trace:
    """Move the target sinusoidally along the soft axis for two periods; return the record.

    The target adaptation η is 0.
    """
    arm = load(source)
    start = np.asarray(arm.model.forward_kinematics(arm.pose))
    target = poses.sinusoid(start, arm.soft, arm.way)
    return _loop(arm, arm.law(), target, 17.0, q=arm.pose)


def promises(source: Source, pose: int) -> list[Promise]:
    """Return the results of pushes in one random pose, as `experiments.campaign` defines them.

    The pushes are along every task axis in both directions, with the cap that is 30 % of the
    arm's median static capacity (rotations 14 %), and the other axes free.
    """
    arm = load(source)
    bench = Bench(arm)
    return [
        bench.keep(pose, q, AXES[row], sign, arm.caps(row)[1], guided=False)
        for q in arm.poses(pose + 1)[pose:]
        for row in arm.rows
        for sign in (1.0, -1.0)
    ]


# --- Chapters: activation matrix, tracking, accuracy of caps ---

#: Number of poses in which caps are measured: in a full run, and with option `quick`.
POSES = (12, 2)


@dataclass(frozen=True)
class ActivationChapter:
    """Chapter 1: activation matrix at the start pose."""

    source: Source
    NUMBER: ClassVar[int] = 1
    TITLE: ClassVar[str] = "Share of each joint in each axis"

    def jobs(self, options: Options) -> list[Job]:
        """Return one job, which computes the activation matrix."""
        return [Job("matrix", activation, (self.source,))]

    def measure(self, outcomes: Mapping[str, Array]) -> Numbers:
        """Return the activation matrix with the names of its rows and columns, and the pose."""
        arm = load(self.source)
        return {
            "joints": list(arm.model.joint_names),
            "columns": [*arm.axes, "null"],
            "pose": arm.pose.tolist(),
            "activation": outcomes["matrix"].tolist(),
        }

    def chapter(self, numbers: Numbers) -> Chapter:
        """Return the chapter, which names the joint with the largest share in each axis."""
        arm = load(self.source)
        share = np.array(numbers["activation"])[:, : len(arm.axes)]
        sums = np.abs(share.sum(axis=0) - 1.0).max()
        leads = "; ".join(
            f"{axis}: {arm.model.joint_names[int(share[:, k].argmax())]} {share[:, k].max():.2f}"
            for k, axis in enumerate(arm.axes)
        )
        figure = Figure(
            file="1-activation",
            title="Activation matrix",
            done=f"Task axes {' '.join(arm.axes)} for {arm.model.n} joints; {arm.where}. Each "
            "column tells how a torque budget for one axis is shared among the joints.",
            caption="Columns sum to one; the column of the null space stands apart and is empty "
            "without redundancy.",
            statements=(
                band(
                    claim="The shares of each axis sum to one.",
                    outcome=f"They do within {sums:.0e}. Largest share: {leads}.",
                    checks=(at_most("error of a sum", float(sums), 1e-9),),
                ),
            ),
        )
        return Chapter(
            number=self.NUMBER,
            title=self.TITLE,
            lead="How the joints share the work of each direction in space.",
            figures=(figure,),
            numbers=numbers,
        )

    def draw(self, outcomes: Mapping[str, Array], options: Options) -> None:
        """Draw the activation matrix beside a picture of the arm in its start pose."""
        draw_activation(load(self.source), outcomes["matrix"], options.figures)


@dataclass(frozen=True)
class TrackingChapter:
    """Chapter 3: tracking of a target that oscillates along the soft axis."""

    source: Source
    NUMBER: ClassVar[int] = 3
    TITLE: ClassVar[str] = "A compliant axis still tracks"

    def jobs(self, options: Options) -> list[Job]:
        """Return one job, which runs `swing`."""
        return [Job("swing", swing, (self.source,))]

    def measure(self, outcomes: Mapping[str, Trace]) -> Numbers:
        """Return rms error over amplitude, and the largest deviation of the other positions."""
        arm, trace = load(self.source), outcomes["swing"]
        axis = AXES.index(arm.soft)
        swing = trace.between(1.0, 17.0)
        others = [row for row in arm.rows if row < 3 and row != axis]
        return {
            "amplitude": arm.way,
            "share": metrics.rms(trace.error[swing, axis]) / arm.way,
            "others": metrics.largest(trace.error[swing][:, others]),
        }

    def chapter(self, numbers: Numbers) -> Chapter:
        """Return the chapter with statements about the tracking."""
        arm = load(self.source)
        figure = Figure(
            file="3-swing",
            title=f"A sinusoid in {arm.soft} while {arm.soft} is compliant",
            done=f"The target swings twice by {mm(numbers['amplitude'])} with a period of 8 s, η = "
            "0, default strengths.",
            caption="Above: the axis and its target. Below: the other positions of the task.",
            statements=(
                band(
                    claim="It follows with an rms error below a tenth of the amplitude.",
                    outcome=f"{numbers['share']:.3f} of the amplitude; other positions within "
                    f"{mm(numbers['others'])}.",
                    checks=(at_most("rms error / amplitude", numbers["share"], 0.10),),
                    because="the softest strength is not far above what friction takes; a firmer "
                    "axis tracks better.",
                ),
            ),
        )
        return Chapter(
            number=self.NUMBER,
            title=self.TITLE,
            lead="A soft axis must follow its target without a large lag.",
            figures=(figure,),
            numbers=numbers,
            headline=(("rms error / amplitude", f"{numbers['share']:.3f}"),),
        )

    def draw(self, outcomes: Mapping[str, Trace], options: Options) -> None:
        """Draw the tool's motion along the soft axis, and its deviations along the others."""
        draw_swing(load(self.source), outcomes["swing"], options.figures)


@dataclass(frozen=True)
class CapChapter:
    """Chapter 4: accuracy of the caps, compared with the force on a hand."""

    source: Source
    NUMBER: ClassVar[int] = 4
    TITLE: ClassVar[str] = "Promised and measured forces"

    def jobs(self, options: Options) -> list[Job]:
        """Return one job per pose, with pushes along every axis in both directions."""
        return [Job(f"pose {k}", promises, (self.source, k)) for k in range(POSES[options.quick])]

    def measure(self, outcomes: Mapping[str, Sequence[Promise]]) -> Numbers:
        """Return the forces of all pushes, their median error, and the number of kept caps."""
        pushes = _tried(outcomes)
        errors = [abs(push.error) for push in pushes]
        return {
            "pushes": len(pushes),
            "kept": sum(push.kept for push in pushes),
            "median_error": float(np.median(errors)) if errors else float("nan"),
            "each": [
                {
                    "axis": p.axis,
                    "sign": p.sign,
                    "cap": p.cap,
                    "promise": p.promise,
                    "measured": p.measured,
                }
                for p in pushes
            ],
        }

    def chapter(self, numbers: Numbers) -> Chapter:
        """Return the chapter with a statement about the share of caps that are kept."""
        share = numbers["kept"] / max(numbers["pushes"], 1)
        figure = Figure(
            file="4-promise",
            title="Promised cap against measured push-back",
            done="At well conditioned random poses each task axis in turn is made soft with one "
            "cap, 30 % of this arm's median static capacity (rotations 14 %), the tool is dragged "
            "away, and the force is read when it is still. Pushes are left out where the servos "
            "cannot give the cap, or where the report says that a joint meets its stop.",
            caption="Diagonal: measured equals expected force; band: ± 15 % of the cap. A cap "
            "counts as kept if the rest of the difference is below the friction of the joints.",
            statements=(
                band(
                    claim="At least 92 % of the promises are kept within 15 % of the cap and the "
                    "joints' friction.",
                    outcome=f"{numbers['kept']} of {numbers['pushes']} ({share:.0%}); median error "
                    f"{numbers['median_error']:.1%} of the cap.",
                    checks=(
                        at_least("share kept", share, 0.92),
                        at_least("pushes", numbers["pushes"], 1.0),
                    ),
                ),
            ),
        )
        return Chapter(
            number=self.NUMBER,
            title=self.TITLE,
            lead="The settings of law cap are forces; this chapter measures them with a hand.",
            figures=(figure,),
            numbers=numbers,
            headline=(("promises kept", f"{numbers['kept']} of {numbers['pushes']}"),),
        )

    def draw(self, outcomes: Mapping[str, Sequence[Promise]], options: Options) -> None:
        """Draw measured against expected force of all pushes."""
        draw_promises(_tried(outcomes), options.figures)


def _tried(outcomes: Mapping[str, Sequence[Promise]]) -> list[Promise]:
    """Return the pushes that were run and for which no stop was announced."""
    pushes = [push for results in outcomes.values() for push in results]
    return [push for push in pushes if not push.refused and not push.announced]


def experiments(source: Source) -> dict[int, Any]:
    """Return the chapters of the report for an arm, by number."""
    kinds = (ActivationChapter, DragChapter, TrackingChapter, CapChapter)
    return {kind.NUMBER: kind(source) for kind in kinds}


# --- Chapter: drag of a soft axis ---

#: Arguments of the runs of `drag`: kind (`soft` or `stiff`), target adaptation η, direction.
DRAGS = (
    ("soft", 0.999, 1),
    ("soft", 0.999, -1),
    ("soft", 0.0, 1),
    ("soft", 0.0, -1),
    ("stiff", 0.0, 1),
    ("stiff", 0.0, -1),
)


@dataclass(frozen=True)
class DragChapter:
    """Chapter 2: a hand drags the arm, with one axis soft and with all axes stiff."""

    source: Source
    NUMBER: ClassVar[int] = 2
    TITLE: ClassVar[str] = "Dragged by a hand and released"

    def jobs(self, options: Options) -> list[Job]:
        """Return the runs of `DRAGS`, and a job that reads the arm's default caps.

        With option `quick`, only the runs in the positive direction are returned.
        """
        runs = [d for d in DRAGS if d[2] == 1] if options.quick else DRAGS
        return [
            Job("strengths", strengths, (self.source,)),
            *(
                Job(f"{k} {eta:g} {sign:+d}", drag, (self.source, k, eta, sign))
                for k, eta, sign in runs
            ),
        ]

    def measure(self, outcomes: Mapping[str, Any]) -> Numbers:
        """Return forces and displacements of each kind of run: worse value of both directions."""
        arm, caps = load(self.source), outcomes["strengths"]
        kinds: dict[str, dict[str, float]] = {}
        for name, trace in outcomes.items():
            if name == "strengths":
                continue
            kind = name.rsplit(" ", maxsplit=1)[0]
            push = self._one(arm, trace, caps)
            had = kinds.get(kind, push)
            kinds[kind] = {k: (min if k == "moved" else max)(v, had[k]) for k, v in push.items()}
        return {
            "soft_axis": arm.soft,
            "way": arm.way,
            "strengths": {
                "soft": caps.soft,
                "firm": caps.firm,
                "hold": caps.hold,
            },
            **kinds,
        }

    def _one(self, arm: Arm, trace: Trace, caps: Strengths) -> dict[str, float]:
        axis = AXES.index(arm.soft)
        others = [row for row in arm.rows if row < 3 and row != axis]
        is_still = trace.between(*metrics.HELD)
        forces = trace.force[:, axis]
        c = float(np.nanmean(trace.compliance[is_still, arm.axes.index(arm.soft)]))
        jacobian = np.asarray(arm.model.jacobian(trace.q[trace.at(metrics.HELD[1])]))
        inverse = np.linalg.pinv(jacobian[arm.rows])[:, arm.rows.index(axis)]
        before = trace.at(metrics.PULLING[0])
        return {
            "before": metrics.largest(
                trace.error[before, arm.rows][: len([r for r in arm.rows if r < 3])]
            ),
            "moved": metrics.moved(trace, axis),
            "force": metrics.largest(forces),
            "held": abs(float(forces[is_still].mean())),
            "promised": c * caps.soft + (1.0 - c) * caps.firm,
            "friction": float(np.abs(inverse) @ np.asarray(arm.servos.friction)),
            "give": max(
                (float(jacobian[row] ** 2 @ (1.0 / np.asarray(arm.servos.kp))) for row in others),
                default=0.0,
            ),
            "drift": metrics.drift(trace, others) if others else 0.0,
            "left": abs(float(trace.error[-1, axis])),
            "crept": abs(
                float(trace.moved[-1, axis] - trace.moved[trace.at(metrics.PULLING[1]), axis])
            ),
        }

    def chapter(self, numbers: Numbers) -> Chapter:
        """Return the chapter, which compares the forces of the soft axis and of the stiff arm."""
        arm = load(self.source)
        follow, firm, stiff = numbers["soft 0.999"], numbers["soft 0"], numbers["stiff 0"]
        caps, soft = numbers["strengths"], numbers["soft_axis"]
        figure = Figure(
            file="2-dragged",
            title=f"A hand drags the tool by {mm(numbers['way'])} in {soft}",
            done=f"Law cap with this arm's default strengths in {soft}: {caps['soft']:g} N at "
            f"small, {caps['firm']:g} N at large deviation, {caps['hold']:g} N where it is "
            "stiff. The hand pulls within 2 to 3.5 s, holds on until 5 s, and lets go. With η = "
            f"0.999, with η = 0, and with all axes stiff; {arm.where}.",
            caption="Solid: pulled toward +, dashed: toward −.",
            statements=(
                band(
                    claim="At rest the tool stays within 5 mm of its target.",
                    outcome=f"All stiff: {mm(stiff['before'])} off; soft, η = 0.999: "
                    f"{mm(follow['before'])}.",
                    checks=(at_most("off", max(stiff["before"], follow["before"]), 0.005, "m"),),
                    because="dry friction of the gears holds the arm against a small error.",
                ),
                band(
                    claim="A soft axis follows a hand for less than half the force of a stiff one.",
                    outcome=f"{follow['force']:.2f} N instead of {stiff['force']:.2f} N for "
                    f"{mm(follow['moved'])}.",
                    checks=(at_most("share", follow["force"] / stiff["force"], 0.5),),
                    because="friction that is not fed forward and the arm's inertia are most of "
                    "what the hand feels.",
                ),
                band(
                    claim="The stiff positions drift by less than 15 % of the distance, and less "
                    "than on a stiff arm.",
                    outcome=f"{mm(follow['drift'])} of {mm(numbers['way'])}; {mm(stiff['drift'])} "
                    "when all is stiff.",
                    checks=(
                        at_most("drift over way", follow["drift"] / numbers["way"], 0.15),
                        at_most(
                            "drift over stiff", follow["drift"] / max(stiff["drift"], 1e-6), 1.0
                        ),
                    ),
                    because=f"a newton on its stiff axes moves them by up to {mm(follow['give'])}: "
                    "no law makes servos stiffer than they are.",
                ),
                band(
                    claim="η = 0: a held arm pulls back with the force that is set for this "
                    "deviation, within 15 % and friction, and returns.",
                    outcome=f"{firm['held']:.2f} N of {firm['promised']:.2f} N; {mm(firm['left'])} "
                    "from the target 4 s after the release.",
                    checks=(
                        near(
                            "held",
                            firm["held"],
                            firm["promised"],
                            rel=0.15,
                            plus=firm["friction"],
                            unit="N",
                        ),
                        at_most("left over way", firm["left"] / numbers["way"], 0.15),
                    ),
                ),
                band(
                    claim="η = 0.999: the released arm stays where it is.",
                    outcome=f"It moves by {mm(follow['crept'])} in the next 4 s.",
                    checks=(at_most("moves", follow["crept"], 0.015, "m"),),
                ),
            ),
        )
        return Chapter(
            number=self.NUMBER,
            title=self.TITLE,
            lead="One axis yields, the others hold. The force of a hand that moves the arm, the "
            "motion of the other axes, and the return of the arm.",
            figures=(figure,),
            tables=(_drag_table(numbers),),
            numbers=numbers,
            headline=(
                (
                    f"dragged in {soft}, soft",
                    f"{follow['force']:.2f} N, {mm(follow['drift'])} drift",
                ),
                (
                    f"dragged in {soft}, all stiff",
                    f"{stiff['force']:.2f} N, {mm(stiff['drift'])} drift",
                ),
            ),
        )

    def draw(self, outcomes: Mapping[str, Any], options: Options) -> None:
        """Draw the dragged axis, the other positions and the force of the hand over time."""
        traces = {name: one for name, one in outcomes.items() if name != "strengths"}
        draw_dragged(load(self.source), traces, options.figures)


def _drag_table(numbers: Numbers) -> Table:
    rows = [
        (
            name,
            mm(figures["moved"]),
            f"{figures['force']:.2f} N",
            f"{figures['held']:.2f} N",
            mm(figures["drift"]),
            mm(figures["left"]),
        )
        for name, figures in ((k, numbers[k]) for k in ("soft 0.999", "soft 0", "stiff 0"))
    ]
    return Table(
        caption="The worse of both directions. Held: mean force while the hand holds still; left: "
        "4 s after the release.",
        columns=("axis and η", "moved", "force", "held", "drift of the others", "left"),
        rows=tuple(rows),
    )


# --- Subject of an experiment from any robot model ---


def subject(source: Source) -> Subject:
    """Return the robot of a demonstration with the chapters of this module.

    Raises:
        PliantError: The arm is rejected.
    """
    arm = load(source)
    name = source.name or arm.model.name
    return Subject(
        name,
        experiments(source),
        f"Compliant control of {name} ({arm.model.n} joints, task axes {' '.join(arm.axes)}) on "
        "simulated position servos with torque limits: what the default law does with this arm, in "
        "numbers of this run.",
        arm.notes,
    )


# --- Figures ---

KINDS = (
    ("stiff 0", "all stiff", LAW_COLOURS["stiff"]),
    ("soft 0", "soft, η 0", SKY),
    ("soft 0.999", "soft, η 0.999", BLUE),
)


def draw_activation(arm: Arm, matrix: Array, folder: Path) -> None:
    """Draw the figure `1-activation`: the arm in its start pose, and its activation matrix."""
    with canvas(1, 2, size=(WIDE, 1.1 + 0.42 * matrix.shape[0]), width_ratios=[1.0, 1.75]) as (
        figure,
        axes,
    ):
        show(axes[0, 0], posture(arm.model, arm.pose, servos=arm.servos), "")
        heat(axes[0, 1], matrix, arm.model.joint_names, [*arm.axes, "null"])
        save(figure, folder, "1-activation")


def draw_dragged(arm: Arm, traces: Mapping[str, Trace], folder: Path) -> None:
    """Draw `2-dragged`, three plots over time with one curve per run.

    They show the deviation of the dragged axis from its target, the largest deviation of the other
    translations (no curve if the task has no other), and the force of the hand.
    """
    axis = AXES.index(arm.soft)
    others = [row for row in arm.rows if row < 3 and row != axis]
    with canvas(1, 3, size=(WIDE, 3.6)) as (figure, axes):
        position_axes, error_axes, force = axes[0]
        for kind, _, colour in KINDS:
            for sign, style in (("+1", "-"), ("-1", (0, (3.5, 2.0)))):
                trace = traces.get(f"{kind} {sign}")
                if trace is None:
                    continue
                step = thin(trace.t)
                t = trace.t[step]
                position_axes.plot(t, -1e3 * trace.error[step, axis], color=colour, linestyle=style)
                if others:
                    deviation = np.abs(trace.error[step][:, others]).max(axis=1)
                    error_axes.plot(t, 1e3 * deviation, color=colour, linestyle=style)
                force.plot(t, trace.force[step, axis], color=colour, linestyle=style)
        for ax in axes[0]:
            ax.margins(y=0.12)
            shade(ax, 2.0, 5.0, "hand")
            ax.set_xlabel("time [s]")
            ax.set_xlim(0.0, 9.0)
        error_axes.set_ylim(bottom=0.0)
        position_axes.set_ylabel(f"{arm.soft}, from its target [mm]")
        error_axes.set_ylabel("farthest other position [mm]")
        force.set_ylabel("hand [N]")
        names(force, [(name, colour) for _, name, colour in KINDS])
        save(figure, folder, "2-dragged")


def draw_swing(arm: Arm, trace: Trace, folder: Path) -> None:
    """Draw `3-swing`: soft axis and target, and the deviations of the other positions."""
    axis = AXES.index(arm.soft)
    step = thin(trace.t)
    t = trace.t[step]
    with canvas(2, 1, size=(WIDE * 0.8, 4.4), sharex=True, height_ratios=[1.2, 1.0]) as (
        figure,
        axes,
    ):
        top, low = axes[:, 0]
        top.plot(t, 1e3 * trace.moved[step, axis], color=BLUE)
        target = trace.moved[step, axis] + trace.error[step, axis]
        top.plot(t, 1e3 * target, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        ends = []
        for row in arm.rows:
            if row < 3 and row != axis:
                name = AXES[row]
                low.plot(t, -1e3 * trace.error[step, row], color=AXIS_COLOURS[name])
                ends.append((-1e3 * float(trace.error[-1, row]), name, AXIS_COLOURS[name]))
        top.set_ylabel(f"{arm.soft} [mm]")
        low.set_ylabel("others, from target [mm]")
        low.set_xlabel("time [s]")
        low.xaxis.set_major_locator(MultipleLocator(4.0))
        label_end(top, float(t[-1]), [(1e3 * float(target[-1]), "target (dashed)", INK)])
        label_end(low, float(t[-1]), ends)
        save(figure, folder, "3-swing")


def draw_promises(pushes: Sequence[Promise], folder: Path) -> None:
    """Draw `4-promise`: measured against expected force of each push, both divided by the cap."""
    with canvas(1, 1, size=(WIDE * 0.55, 4.8)) as (figure, axes):
        ax = axes[0, 0]
        line = np.array([0.0, 1.3])
        ax.fill_between(line, line - 0.15, line + 0.15, color=MUTED, alpha=0.12, linewidth=0)
        ax.plot(line, line, color=MUTED, linewidth=0.9, linestyle=(0, (4, 3)))
        for name in AXES:
            axis_pushes = [p for p in pushes if p.axis == name]
            if axis_pushes:
                is_rotation = AXES.index(name) > 2
                ax.plot(
                    [p.promise / p.cap for p in axis_pushes],
                    [p.measured / p.cap for p in axis_pushes],
                    "^" if is_rotation else "o",
                    markersize=5,
                    markerfacecolor="none" if is_rotation else AXIS_COLOURS[name],
                    color=AXIS_COLOURS[name],
                    label=name,
                    linestyle="none",
                )
        ax.set_xlim(0.0, 1.3)
        ax.set_ylim(0.0, 1.5)
        ax.set_aspect("equal")
        ax.set_xlabel("promised / cap")
        ax.set_ylabel("felt by the hand / cap")
        ax.legend(loc="upper left", ncols=2)
        save(figure, folder, "4-promise")
