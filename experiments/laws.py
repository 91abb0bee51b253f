"""The controllers of the experiments, by name, as settings.

All of them run without tool speed limit and stiffening rate, which would blur the laws themselves.

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

from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.setups import AXES
from pliant import Axis, NullSpace, Settings, TorqueLimits, Tracking
from pliant.functional import PaperOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

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
