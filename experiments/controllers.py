"""The controllers of the experiments, by name, as settings.

All of them have no tool speed limit and no bound of the stiffening rate, so that the results show
the laws alone.

| name | what it is |
|---|---|
| `paper` | the paper: torque budgets, no gravity model, step limits |
| `limits_only` | the same without step limits: the literal reading |
| `rec` | `paper` with gravity in goals and limits and tighter soft steps: the J⁺ form |
| `task` | `rec` with each axis' budget acting on the goal as well |
| `rows_free` | `rec` with soft rows outside the inverse kinematics |
| `cap` | the default law |
| `cap_tracking` | `cap` whose soft rotations have a little more torque for tracking |
| `impedance` | springs on the stiff axes, the soft ones free, force caps as `cap` |
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

NONE = float("inf")
#: No tool speed limit, no stiffening rate.
UNBLURRED: Mapping[str, Any] = {
    "max_tool_speed": (NONE, NONE),
    "torque_limits": TorqueLimits(stiffening_time=0.0),
}
#: Damping of the J⁺ forms: λ₀, σ₀, λ_max.
JACOBIAN_DAMPING = (0.02, 0.15, 0.2)
#: Soft rotation force at small deviations that still tracks [N·m].
TRACKING_TORQUE = 0.84
#: Steps of stiff and soft axes: [m/s], [rad/s].
STIFF_STEPS: Steps = (0.4, 2.0)
SOFT_STEPS: Steps = (0.05, 0.25)
SOFT_STEPS_WITHOUT_GRAVITY: Steps = (0.1, 0.5)
NO_STEPS: Steps = (NONE, NONE)
#: Steps near the edge of the workspace.
EDGE_STEPS: Steps = (0.1, 0.5)
#: A budget [N·m] above any servo's torque: its limit is then its maximum.
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
    """The paper's law with one budget for every axis, 0.5 N·m on soft ones at small deviations.

    Args:
        torque: Budget T of each axis [N·m].
        soft: Axes that yield, by name; "" for none.
        eta: Target adaptation of these.
        gravity: True if goals and limits contain gravity.
        steps: Step limits of stiff axes [m/s, rad/s].
        soft_steps: The same of soft axes.
        **more: Further settings.

    Returns:
        Settings with damping 0.02 growing to 0.2 below σ = 0.15, without slew or lead clamp.
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
        max_tool_speed=(NONE, NONE),
        tracking=Tracking(damping=JACOBIAN_DAMPING, goal_slew=NONE),
        null_space=NullSpace(max_torque=2.0),
        torque_limits=TorqueLimits(floor=np.zeros(7), stiffening_time=0.0),
        paper_options=PaperOptions(gravity_scale=1.0, direction_band=0.0, lead_limit=NONE),
    )
    return settings.replace(**more)


def limits_only(torque: float = 6.0, *, soft: str = "y", eta: float = 0.0, **more: Any) -> Settings:
    """Return the literal reading: budgets [N·m] in the limits, unbounded goals."""
    return paper(torque, soft=soft, eta=eta, steps=NO_STEPS, soft_steps=NO_STEPS, **more)


def rec(torque: float = 8.0, *, soft: str = "y", eta: float = 0.999, **more: Any) -> Settings:
    """Return `paper` with gravity in goals and limits and soft steps of 0.05 m/s, 0.25 rad/s."""
    options = {"gravity": True, "soft_steps": SOFT_STEPS, **more}
    return paper(torque, soft=soft, eta=eta, **options)


def task(torque: float = 8.0, *, soft: str = "y", eta: float = 0.0, **more: Any) -> Settings:
    """Return `rec` with A τˣ enforced axis by axis on the goal too."""
    settings = rec(torque, soft=soft, eta=eta, **more)
    return settings.replace(paper_options=PaperOptions(budget_on_goal=True))


def rows_free(torque: float = 8.0, *, soft: str = "y", eta: float = 0.999, **more: Any) -> Settings:
    """Return `rec` with soft rows outside the inverse kinematics of the stiff ones."""
    settings = rec(torque, soft=soft, eta=eta, **more)
    return settings.replace(paper_options=PaperOptions(follow="free"))


def all_stiff(**more: Any) -> Settings:
    """Return task-space control with full torque in every axis."""
    return rec(UNLIMITED, soft="", **more)


def cap(
    *, soft: str = "y", eta: float = 0.999, axis: Mapping[str, Any] | None = None, **more: Any
) -> Settings:
    """The default law with its default strengths, `soft` axes yielding.

    Args:
        soft: Axes that yield, by name; "" for none.
        eta: Target adaptation of these.
        axis: Further attributes of the soft axes.
        **more: Further settings.

    Returns:
        The default settings without tool speed limit and stiffening rate.
    """
    yielding = Axis(**{"yields": "both", "adaptation": eta, **(axis or {})})
    axes = {soft: yielding} if soft else {}
    return Settings(axes=axes, **UNBLURRED).replace(**more)


def impedance(
    *,
    soft: str = "y",
    eta: float = 0.0,
    stiffness: Steps | None = None,
    damping: Steps = (0.0, 0.0),
    **more: Any,
) -> Settings:
    """Springs and dampers: law `impedance` with its default stiffness, `soft` axes free.

    Args:
        soft: Axes that yield, by name; "" for none.
        eta: Target adaptation of these; without effect on axes that have no spring.
        stiffness: Springs of the other axes [N/m, N·m/rad]; None for the arm's.
        damping: Dampers of these [N·s/m, N·m·s/rad].
        **more: Further settings.

    Returns:
        The default settings without tool speed limit and stiffening rate.
    """
    axes: dict[str, Axis] = {}
    for index, name in enumerate(AXES):
        if name in soft.split():
            axes[name] = Axis(yields="both", adaptation=eta)
        else:
            spring = None if stiffness is None else stiffness[index // 3]
            axes[name] = Axis(stiffness=spring, damping=damping[index // 3])
    return Settings(law="impedance", axes=axes, **UNBLURRED).replace(**more)


def cap_tracking(*, soft: str = "y", eta: float = 0.0, **more: Any) -> Settings:
    """Return `cap` for a soft axis that follows its target though friction is known to 30 % only.

    The uncompensated friction must not exceed the force of a soft rotation.
    """
    axis = {"soft": TRACKING_TORQUE} if soft in AXES[3:] else None
    return cap(soft=soft, eta=eta, axis=axis, **more)


def cap_at_edge(**more: Any) -> Settings:
    """Return `cap` without a soft axis, with small steps for the edge of the workspace."""
    axes = {"xyz": Axis(max_velocity=EDGE_STEPS[0]), "rpy": Axis(max_velocity=EDGE_STEPS[1])}
    return cap(soft="", axes=axes, **more)


def rec_at_edge(torque: float = 8.0, **more: Any) -> Settings:
    """Return `rec` without a soft axis, with small steps for the edge of the workspace."""
    return rec(torque, soft="", steps=EDGE_STEPS, **more)


# --- Baselines: made for a model and a control period, they step like `pliant.Controller` ---

#: Largest stable stiffness, translations [N/m] and rotations [N·m/rad]: with position servos at
#: 100 Hz, and with torque sources at 1 kHz.
STIFFNESS, TORQUE_STIFFNESS = (800.0, 20.0), (1600.0, 40.0)
#: Distance of the goal from q [rad] for a torque source, whose torque limit is the torque command.
FAR = 1.0
#: Shares of friction and damping that are fed forward, and the speed of full friction [rad/s], as
#: in the default law; filter of the velocity [s].
FRICTION_SHARE, DAMPING_SHARE, FRICTION_SPEED, FILTER = 0.9, 0.8, 0.05, 0.02


@dataclass(frozen=True)
class Goals:
    """Goals (n,) [rad] and torque limits (n,) [N·m]."""

    goal: Array
    torque_limit: Array


class Joints:
    """Resistance of gears: dry friction and damping at a filtered velocity."""

    def __init__(self, model: pliant.Model, period: float) -> None:
        """Take the servo table of a model and a control period [s]."""
        table = servos(model)
        self._friction = np.asarray(table.friction)
        self._damping = np.asarray(table.damping)
        self._period = period

    def reset(self, q: Array) -> None:
        """Start at rest in q (n,) [rad]."""
        self._before, self.velocity = q.copy(), np.zeros(q.size)

    def see(self, q: Array) -> None:
        """Process a reading (n,) [rad]."""
        raw = (q - self._before) / self._period
        self.velocity += self._period / (FILTER + self._period) * (raw - self.velocity)
        self._before = q.copy()

    def resistance(self, friction: float, damping: float) -> Array:
        """Return the torque (n,) [N·m] of shares of friction and damping at this velocity."""
        dry = self._friction * np.tanh(self.velocity / FRICTION_SPEED)
        return friction * dry + damping * self._damping * self.velocity


class JointPosition:
    """Position control by inverse kinematics, at full or a fraction of the servo torque."""

    def __init__(self, model: pliant.Model, period: float, *, fraction: float = 1.0) -> None:
        """Take the arm; `fraction` of the servos' torque is the limit of every joint."""
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
    """A Cartesian spring ``τ = Jᵀ K e + g + N k (q_rest - q)``, optionally friction compensated.

    As a torque source it is an arm with torque-controlled joints: the goal is far ahead on the
    right side, so that the limit is the torque.
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
        """Take the arm.

        Args:
            model: The arm, with its servos.
            period: Control period [s].
            soft: Axes with a `spring` of their own [N/m, N·m/rad].
            stiffness: Of the others [N/m, N·m/rad].
            spring: Of the soft axes.
            compensated: True: feed forward friction and damping of the servo table, in the same
                shares as the default law.
        """
        free = [name in soft.split() for name in AXES]
        self._spring = np.where(free, spring, np.repeat(stiffness, 3))
        self._model = model
        self._kp = np.asarray(servos(model).kp)
        self._torque = np.asarray(servos(model).max_torque)
        self._joints = Joints(model, period) if compensated else None

    def reset(self, q: Array) -> None:
        """Start in q (n,) [rad], the posture of the null space."""
        self._rest = q.copy()
        if self._joints is not None:
            self._joints.reset(q)

    def step(self, q: Array, target: Array) -> Goals:
        """Turn the pose error into torques."""
        pose, jacobian = self._model.kinematics(q)
        force = self._spring * np.asarray(pliant.functional.pose_error(pose, target))
        inverse = np.linalg.pinv(jacobian)
        null = self._rest - q
        null = null - inverse @ (jacobian @ null)
        torque = jacobian.T @ force + self._model.gravity(q) + 0.1 * self._kp * null
        if self._joints is not None:
            self._joints.see(q)
            torque = torque + self._joints.resistance(FRICTION_SHARE, DAMPING_SHARE)
        return Goals(q + np.copysign(FAR, torque), np.minimum(np.abs(torque), self._torque))


def stiff_joints() -> FromModel:
    """Return position control of the joints at full torque."""
    return JointPosition


def uniform_limit(fraction: float) -> FromModel:
    """Return position control of the joints, every limit at a fraction of the torque."""
    return partial(JointPosition, fraction=fraction)


def torque_impedance(
    *,
    soft: str = "y",
    stiffness: tuple[float, float] = TORQUE_STIFFNESS,
    spring: float = 0.0,
    compensated: bool = False,
) -> FromModel:
    """Return impedance control with ideal torque sources, for a control rate of 1 kHz."""
    return partial(
        Impedance, soft=soft, stiffness=stiffness, spring=spring, compensated=compensated
    )


# --- Admittance control driven by motor current: an alternative method on position servos ---


@dataclass(frozen=True, kw_only=True)
class Current:
    """Error model of a servo's reported current.

    Attributes:
        noise: Standard deviation of a reading, as a share of the largest torque.
        count: One count of the register, as a share of the largest torque.
        filter: Time constant of the filter against the noise [s].
    """

    noise: float = 0.01
    count: float = 0.0005
    filter: float = 0.03


@dataclass(frozen=True, kw_only=True)
class Virtual:
    """Virtual mass, damper and spring that turn the estimated force into a motion.

    Attributes:
        mass: [kg]
        damper: [N·s/m]
        spring: Toward the target [N/m].
        dead_zone: Force below which the estimate counts as zero [N].
        most_speed: Bound of the target's speed, as in the default law [m/s].
    """

    mass: float = 1.0
    damper: float = 20.0
    spring: float = 0.0
    dead_zone: float = 1.0
    most_speed: float = 0.25


class Admittance:
    """One soft translation; the other axes are stiff position control at full torque.

    The external wrench is estimated from the motors' currents, and a virtual mass and damper turn
    it into a motion of the target, which stiff position servos follow. The current does not show
    friction: at rest the motor torque may be anywhere within the friction band around the load. The
    estimate therefore needs a dead zone, which is the force to start a motion.
    """

    def __init__(
        self,
        model: pliant.Model,
        period: float,
        *,
        soft: str = "y",
        current: Current,
        virtual: Virtual,
        seed: int = 0,
    ) -> None:
        """Take the arm, its current sensors and the virtual body; `soft` is x, y or z."""
        self._model, self._period, self._axis = model, period, AXES.index(soft)
        self._current, self._virtual = current, virtual
        table = servos(model)
        self._limit, self._kp = np.asarray(table.max_torque), np.asarray(table.kp)
        self._joints = Joints(model, period)
        self._chance = np.random.default_rng(seed)

    def reset(self, q: Array) -> None:
        """Start at rest in q (n,) [rad]."""
        self._joints.reset(q)
        self._goal = q.copy()
        self._load = self._model.gravity(q)
        self._offset = self._speed = 0.0

    def listen(self, torque: Array) -> None:
        """Read the motors' torques (n,) [N·m] through their current sensors."""
        size, sensor = self._limit, self._current
        seen = torque + sensor.noise * size * self._chance.standard_normal(size.size)
        seen = np.round(seen / (sensor.count * size)) * sensor.count * size
        self._load = self._load + self._period / (sensor.filter + self._period) * (
            seen - self._load
        )

    def step(self, q: Array, target: Array) -> Goals:
        """Move the virtual body by the estimated force; follow it."""
        self._joints.see(q)
        _, jacobian = self._model.kinematics(q)
        gravity = self._model.gravity(q)
        external = gravity + self._joints.resistance(1.0, 1.0) - self._load
        force = float((np.linalg.pinv(jacobian.T) @ external)[self._axis])
        body = self._virtual
        felt = np.sign(force) * max(abs(force) - body.dead_zone, 0.0)
        pull = felt - body.damper * self._speed - body.spring * self._offset
        # Semi-implicit Euler: stable with a stiff damper at a low control rate.
        self._speed += pull * self._period / (body.mass + body.damper * self._period)
        self._speed = float(np.clip(self._speed, -body.most_speed, body.most_speed))
        self._offset += self._speed * self._period
        wanted = np.array(target)
        wanted[self._axis, 3] += self._offset
        self._goal = np.asarray(self._model.inverse_kinematics(wanted, self._goal).q)
        return Goals(self._goal + gravity / self._kp, self._limit)


def by_current(*, spring: float = 0.0, soft: str = "y", noise: float = Current.noise) -> FromModel:
    """Make an admittance controller driven by motor current.

    Args:
        spring: Toward the target [N/m].
        soft: The soft translation.
        noise: Standard deviation of the current, as a share of the largest torque.
    """
    return partial(
        Admittance, soft=soft, current=Current(noise=noise), virtual=Virtual(spring=spring)
    )
