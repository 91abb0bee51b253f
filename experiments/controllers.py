"""Controllers of the experiments: functions that return settings, and baseline controllers.

The settings have no tool speed limit and no limit on the rate at which torque limits rise, so that
the results depend on the control laws only. A step limit is the largest velocity that a law
commands along an axis.

| name | control law |
|---|---|
| `paper` | the paper: torque budgets, no gravity model, step limits |
| `limits_only` | `paper` without step limits, as the paper's equations state |
| `rec` | `paper` with gravity torques in goals and limits, and smaller step limits of soft axes |
| `task` | `rec`, in which the torque budget of an axis also bounds the step of its goal |
| `rows_free` | `rec` with the soft axes excluded from the inverse kinematics |
| `cap` | the default law |
| `cap_tracking` | `cap` whose soft rotations have more torque for tracking |
| `impedance` | springs on the stiff axes, no spring on the soft ones, force caps as in `cap` |
| `all_stiff` | `rec` without a soft axis, limits at the servo maximum |
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from experiments.poses import AXES, servos
from pliant import Axis, NullSpace, Settings, TorqueLimits, Tracking
from pliant.functional import PaperOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from experiments.poses import Array
    from experiments.simulation import FromModel

    Steps = tuple[float, float]

NO_LIMIT = float("inf")
#: Settings without tool speed limit and without limit on the rate at which torque limits rise.
NO_RATE_LIMITS: Mapping[str, Any] = {
    "max_tool_speed": (NO_LIMIT, NO_LIMIT),
    "torque_limits": TorqueLimits(stiffening_time=0.0),
}
#: Singularity damping λ of the pseudo-inverse in law `paper`: (λ₀, σ₀, λ_max). λ² is λ₀², plus
#: (1 − (σ/σ₀)²) λ_max² if the smallest singular value σ of the Jacobian is below σ₀; see
#: docs/derivations.md, "Damping comes from the arm".
JACOBIAN_DAMPING = (0.02, 0.15, 0.2)
#: Cap of a soft rotation at small deviations that suffices for tracking [N·m].
TRACKING_TORQUE = 0.84
#: Step limits of stiff axes and of soft axes, as velocities of translations [m/s] and rotations
#: [rad/s].
STIFF_STEPS: Steps = (0.4, 2.0)
SOFT_STEPS: Steps = (0.05, 0.25)
SOFT_STEPS_WITHOUT_GRAVITY: Steps = (0.1, 0.5)
NO_STEPS: Steps = (NO_LIMIT, NO_LIMIT)
#: Step limits near the edge of the workspace: translations [m/s], rotations [rad/s].
EDGE_STEPS: Steps = (0.1, 0.5)
#: Torque budget above the torque of all servos, so that their limits are at the maximum [N·m].
UNLIMITED = 1e3


def paper(
    torque: float = 10.0,
    *,
    soft: str = "y",
    eta: float = 0.999,
    gravity: bool = False,
    steps: Steps = STIFF_STEPS,
    soft_steps: Steps = SOFT_STEPS_WITHOUT_GRAVITY,
    **more: Any,
) -> Settings:
    """Return settings of law `paper` with one torque budget for all axes.

    The budget of soft axes at small deviations is at most 0.5 N·m.

    Args:
        torque: Budget of each axis [N·m].
        soft: Names of the soft axes; "" for none.
        eta: Target adaptation of the soft axes.
        gravity: True if goals and limits contain gravity torques.
        steps: Largest velocity of stiff axes: translations [m/s], rotations [rad/s].
        soft_steps: Step limit of soft axes: translations [m/s], rotations [rad/s].
        **more: Further settings.

    Returns:
        Settings without limits on the rate of the goals and on the lead, that is goal minus
        position of a joint.
    """
    axes = {}
    for index, name in enumerate(AXES):
        if name in soft.split():
            axes[name] = Axis(
                soft=min(0.5, torque),
                firm=torque,
                hold=torque,
                adaptation=eta,
                max_velocity=steps[index // 3],
                soft_step_limit=soft_steps[index // 3],
            )
        else:
            axes[name] = Axis(hold=torque, max_velocity=steps[index // 3])
    settings = Settings(
        law="paper",
        axes=axes,
        gravity=gravity,
        max_tool_speed=(NO_LIMIT, NO_LIMIT),
        tracking=Tracking(damping=JACOBIAN_DAMPING, goal_slew=NO_LIMIT),
        null_space=NullSpace(max_torque=2.0),
        torque_limits=TorqueLimits(floor=np.zeros(7), stiffening_time=0.0),
        paper_options=PaperOptions(gravity_scale=1.0, direction_band=0.0, lead_limit=NO_LIMIT),
    )
    return settings.replace(**more)


def limits_only(torque: float = 6.0, *, soft: str = "y", eta: float = 0.0, **more: Any) -> Settings:
    """Return the settings `paper` without step limits: `torque` [N·m] bounds only torque limits."""
    return paper(torque, soft=soft, eta=eta, steps=NO_STEPS, soft_steps=NO_STEPS, **more)


def rec(torque: float = 8.0, *, soft: str = "y", eta: float = 0.999, **more: Any) -> Settings:
    """Return `paper` with gravity torques in goals and limits, and smaller steps of soft axes.

    The step limit of soft axes is 0.05 m/s or 0.25 rad/s; `torque` is the budget of each axis
    [N·m].
    """
    options = {"gravity": True, "soft_steps": SOFT_STEPS, **more}
    return paper(torque, soft=soft, eta=eta, **options)


def task(torque: float = 8.0, *, soft: str = "y", eta: float = 0.0, **more: Any) -> Settings:
    """Return `rec`, in which the torque budget [N·m] of an axis also bounds the step of its goal.

    The budgets τˣ of the axes, distributed by the activation matrix A, are the joint torques A τˣ.
    """
    settings = rec(torque, soft=soft, eta=eta, **more)
    return settings.replace(paper_options=PaperOptions(budget_on_goal=True))


def rows_free(torque: float = 8.0, *, soft: str = "y", eta: float = 0.999, **more: Any) -> Settings:
    """Return `rec` with the soft axes excluded from the inverse kinematics of the stiff axes."""
    settings = rec(torque, soft=soft, eta=eta, **more)
    return settings.replace(paper_options=PaperOptions(follow="free"))


def all_stiff(**more: Any) -> Settings:
    """Return `rec` without a soft axis and with full torque in every axis."""
    return rec(UNLIMITED, soft="", **more)


def cap(
    *, soft: str = "y", eta: float = 0.999, axis: Mapping[str, Any] | None = None, **more: Any
) -> Settings:
    """Return settings of law `cap` with its default caps and the given soft axes.

    Args:
        soft: Names of the soft axes; "" for none.
        eta: Target adaptation of the soft axes.
        axis: Further attributes of the soft axes.
        **more: Further settings.

    Returns:
        Default settings, changed by `NO_RATE_LIMITS`.
    """
    yielding = Axis(**{"yields": "both", "adaptation": eta, **(axis or {})})
    axes = {soft: yielding} if soft else {}
    return Settings(axes=axes, **NO_RATE_LIMITS).replace(**more)


def impedance(
    *,
    soft: str = "y",
    eta: float = 0.0,
    stiffness: Steps | None = None,
    damping: Steps = (0.0, 0.0),
    **more: Any,
) -> Settings:
    """Return settings of law `impedance`; soft axes have no spring.

    Args:
        soft: Names of the soft axes; "" for none.
        eta: Target adaptation of the soft axes; without effect, because they have no spring.
        stiffness: Stiffness of the other axes [N/m, N·m/rad]; None: the default of the arm.
        damping: Damping of the other axes [N·s/m, N·m·s/rad].
        **more: Further settings.

    Returns:
        Default settings, changed by `NO_RATE_LIMITS`.
    """
    axes: dict[str, Axis] = {}
    for index, name in enumerate(AXES):
        if name in soft.split():
            axes[name] = Axis(yields="both", adaptation=eta)
        else:
            spring = None if stiffness is None else stiffness[index // 3]
            axes[name] = Axis(stiffness=spring, damping=damping[index // 3])
    return Settings(law="impedance", axes=axes, **NO_RATE_LIMITS).replace(**more)


def cap_tracking(*, soft: str = "y", eta: float = 0.0, **more: Any) -> Settings:
    """Return `cap` for a soft axis that tracks a target although the assumed friction is wrong.

    With a friction error of 30 %, a soft rotation needs a cap above the friction that is not
    compensated: `TRACKING_TORQUE`.
    """
    axis = {"soft": TRACKING_TORQUE} if soft in AXES[3:] else None
    return cap(soft=soft, eta=eta, axis=axis, **more)


def cap_at_edge(**more: Any) -> Settings:
    """Return `cap` without a soft axis, with low velocities for the edge of the workspace."""
    axes = {"xyz": Axis(max_velocity=EDGE_STEPS[0]), "rpy": Axis(max_velocity=EDGE_STEPS[1])}
    return cap(soft="", axes=axes, **more)


def rec_at_edge(torque: float = 8.0, **more: Any) -> Settings:
    """Return `rec` without a soft axis, with low velocities for the edge of the workspace."""
    return rec(torque, soft="", steps=EDGE_STEPS, **more)


# --- Baseline controllers, with the same `reset` and `step` as `pliant.Controller` ---

#: Stiffness of `Impedance`, the largest that is stable, for translations [N/m] and rotations
#: [N·m/rad]: with control at 100 Hz, and with control at 1 kHz.
STIFFNESS, TORQUE_STIFFNESS = (800.0, 20.0), (1600.0, 40.0)
#: Lead (goal minus position) that saturates a position servo [rad]. The servo then exerts its
#: torque limit, which thus acts as a torque command.
SATURATING_LEAD = 1.0
#: Feed-forward as in the default law: shares of friction and of damping, and speed at which the
#: friction term saturates [rad/s]; and time constant of the velocity filter [s].
FRICTION_SHARE, DAMPING_SHARE, FRICTION_SPEED, FILTER = 0.9, 0.8, 0.05, 0.02


@dataclass(frozen=True)
class Goals:
    """Command of a baseline controller: goals (n,) [rad] and torque limits (n,) [N·m]."""

    goal: Array
    torque_limit: Array


class Joints:
    """Estimates the friction and damping torques of the gears at a filtered joint velocity."""

    def __init__(self, model: pliant.Model, period: float) -> None:
        """Read friction and damping from the model's servos; `period` is the control period [s]."""
        table = servos(model)
        self._friction = np.asarray(table.friction)
        self._damping = np.asarray(table.damping)
        self._period = period

    def reset(self, q: Array) -> None:
        """Reset the state for an arm at rest in q (n,) [rad]."""
        self._before, self.velocity = q.copy(), np.zeros(q.size)

    def see(self, q: Array) -> None:
        """Update the filtered velocity from positions q (n,) [rad]."""
        raw = (q - self._before) / self._period
        self.velocity += self._period / (FILTER + self._period) * (raw - self.velocity)
        self._before = q.copy()

    def resistance(self, friction: float, damping: float) -> Array:
        """Return the torque (n,) [N·m] that friction and damping need at the filtered velocity.

        The arguments are the shares of dry friction and of damping that are included.
        """
        dry = self._friction * np.tanh(self.velocity / FRICTION_SPEED)
        return friction * dry + damping * self._damping * self.velocity


class JointPosition:
    """Joint position control by inverse kinematics, with constant torque limits."""

    def __init__(self, model: pliant.Model, period: float, *, fraction: float = 1.0) -> None:
        """Set the torque limits to a `fraction` of the usable torques; `period` is not used."""
        self._model = model
        self._limit = fraction * np.asarray(servos(model).max_torque)

    def reset(self, q: Array) -> None:
        """Start in q (n,) [rad]."""
        self._goal = q.copy()

    def step(self, q: Array, target: Array) -> Goals:
        """Return goals for the target pose (4, 4); the measured positions are not used."""
        self._goal = np.asarray(self._model.inverse_kinematics(target, self._goal).q)
        return Goals(self._goal, self._limit)


class Impedance:
    """Cartesian impedance control with torque commands τ = Jᵀ K e + g + k N (q_rest - q).

    J is the Jacobian, K the stiffness of the axes, e the deviation of the tool from its target, g
    the gravity torques, and N the null-space projector. k is a tenth of the servos' stiffness, and
    q_rest the start pose. The goal of each servo is far ahead of its position in the direction of
    the torque, so that the servo exerts its torque limit |τ|.
    """

    def __init__(
        self,
        model: pliant.Model,
        period: float,
        *,
        soft: str = "y",
        stiffness: tuple[float, float] = STIFFNESS,
        spring: float = 0.0,
        compensated: bool = False,
    ) -> None:
        """Set the stiffness of the axes and the feed-forward of friction.

        Args:
            model: The arm, with its servos.
            period: Control period [s].
            soft: Names of the soft axes.
            stiffness: Stiffness of the stiff axes [N/m, N·m/rad].
            spring: Stiffness of the soft axes [N/m, N·m/rad].
            compensated: True feeds friction and damping of the servo table forward, with the shares
                of the default law.
        """
        free = [name in soft.split() for name in AXES]
        self._spring = np.where(free, spring, np.repeat(stiffness, 3))
        self._model = model
        self._kp = np.asarray(servos(model).kp)
        self._torque = np.asarray(servos(model).max_torque)
        self._joints = Joints(model, period) if compensated else None

    def reset(self, q: Array) -> None:
        """Start in q (n,) [rad], which is also the null-space posture."""
        self._rest = q.copy()
        if self._joints is not None:
            self._joints.reset(q)

    def step(self, q: Array, target: Array) -> Goals:
        """Return goals and torque limits at positions q (n,) [rad] for the target pose (4, 4)."""
        pose, jacobian = self._model.kinematics(q)
        force = self._spring * np.asarray(pliant.functional.pose_error(pose, target))
        inverse = np.linalg.pinv(jacobian)
        null = self._rest - q
        null = null - inverse @ (jacobian @ null)
        torque = jacobian.T @ force + self._model.gravity(q) + 0.1 * self._kp * null
        if self._joints is not None:
            self._joints.see(q)
            torque = torque + self._joints.resistance(FRICTION_SHARE, DAMPING_SHARE)
        return Goals(
            q + np.copysign(SATURATING_LEAD, torque), np.minimum(np.abs(torque), self._torque)
        )


def stiff_joints() -> FromModel:
    """Return a factory of joint position control at full torque."""
    return JointPosition


def uniform_limit(fraction: float) -> FromModel:
    """Return a factory of joint position control with limits at a `fraction` of the torque."""
    return partial(JointPosition, fraction=fraction)


def torque_impedance(
    *,
    soft: str = "y",
    stiffness: tuple[float, float] = TORQUE_STIFFNESS,
    spring: float = 0.0,
    compensated: bool = False,
) -> FromModel:
    """Return a factory of `Impedance`; the default stiffness suits torque control at 1 kHz.

    The arguments are those of `Impedance`.
    """
    return partial(
        Impedance, soft=soft, stiffness=stiffness, spring=spring, compensated=compensated
    )


# --- Admittance control from motor currents, a baseline for position servos ---


@dataclass(frozen=True, kw_only=True)
class Current:
    """Error model of a servo's reported current.

    Attributes:
        noise: Standard deviation of a reading, as a share of the largest torque.
        count: One count of the current register, as a share of the largest torque.
        filter: Time constant of the noise filter [s].
    """

    noise: float = 0.01
    count: float = 0.0005
    filter: float = 0.03


@dataclass(frozen=True, kw_only=True)
class VirtualBody:
    """Virtual mass, damper and spring of an admittance controller.

    Attributes:
        mass: Virtual mass [kg].
        damper: Virtual damping [N·s/m].
        spring: Stiffness of the spring from the body to the target [N/m].
        dead_zone: Estimated external force below which the body is not moved [N].
        most_speed: Largest speed of the body [m/s].
    """

    mass: float = 1.0
    damper: float = 20.0
    spring: float = 0.0
    dead_zone: float = 1.0
    most_speed: float = 0.25


class Admittance:
    """Admittance control of one soft translation, with stiff position control of all axes.

    The external force is estimated from motor currents. It moves a virtual body, and stiff position
    servos follow the body. At rest, dry friction hides part of the external force from the motor
    current; the estimate therefore has a dead zone, which is the force needed to start a motion.
    """

    def __init__(
        self,
        model: pliant.Model,
        period: float,
        *,
        soft: str = "y",
        current: Current,
        virtual: VirtualBody,
        seed: int = 0,
    ) -> None:
        """Store arm, error model of the current sensors, and virtual body.

        `soft` is the soft axis x, y or z; `seed` is the random seed of the sensor noise.
        """
        self._model, self._period, self._axis = model, period, AXES.index(soft)
        self._current, self._virtual = current, virtual
        table = servos(model)
        self._limit, self._kp = np.asarray(table.max_torque), np.asarray(table.kp)
        self._joints = Joints(model, period)
        self._chance = np.random.default_rng(seed)

    def reset(self, q: Array) -> None:
        """Reset the state for an arm at rest in q (n,) [rad]."""
        self._joints.reset(q)
        self._goal = q.copy()
        self._load = self._model.gravity(q)
        self._offset = self._speed = 0.0

    def listen(self, torque: Array) -> None:
        """Update the filtered motor torques: true `torque` (n,) [N·m] with sensor errors added."""
        size, sensor = self._limit, self._current
        reading = torque + sensor.noise * size * self._chance.standard_normal(size.size)
        reading = np.round(reading / (sensor.count * size)) * sensor.count * size
        self._load = self._load + self._period / (sensor.filter + self._period) * (
            reading - self._load
        )

    def step(self, q: Array, target: Array) -> Goals:
        """Move the virtual body by the estimated external force; return goals that follow it."""
        self._joints.see(q)
        _, jacobian = self._model.kinematics(q)
        gravity = self._model.gravity(q)
        external = gravity + self._joints.resistance(1.0, 1.0) - self._load
        force = float((np.linalg.pinv(jacobian.T) @ external)[self._axis])
        body = self._virtual
        felt = np.sign(force) * max(abs(force) - body.dead_zone, 0.0)
        pull = felt - body.damper * self._speed - body.spring * self._offset
        # The damper is integrated implicitly, which is stable at a low control rate too.
        self._speed += pull * self._period / (body.mass + body.damper * self._period)
        self._speed = float(np.clip(self._speed, -body.most_speed, body.most_speed))
        self._offset += self._speed * self._period
        shifted = np.array(target)
        shifted[self._axis, 3] += self._offset
        self._goal = np.asarray(self._model.inverse_kinematics(shifted, self._goal).q)
        return Goals(self._goal + gravity / self._kp, self._limit)


def by_current(*, spring: float = 0.0, soft: str = "y", noise: float = Current.noise) -> FromModel:
    """Return a factory of `Admittance`, which estimates forces from motor currents.

    Args:
        spring: Stiffness of the spring from the virtual body to the target [N/m].
        soft: Name of the soft translation.
        noise: Standard deviation of the current, as a share of the largest torque.
    """
    return partial(
        Admittance, soft=soft, current=Current(noise=noise), virtual=VirtualBody(spring=spring)
    )
