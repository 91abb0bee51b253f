"""Data from the arm to the page: per scene, per change of settings, thirty times a second."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from pliant._typing import Array, Mask
    from pliant.view.robot_view import Visual

    Phase = Literal["starting", "running", "lowering", "down"]


@dataclass(frozen=True, kw_only=True)
class SceneInfo:
    """Data that stay constant until the scene changes.

    Attributes:
        figure: The arm and its scene as a MuJoCo model, for drawing.
        arm: Name of the arm.
        where: `simulated`, or the backend of the joints.
        axes: Task axes in their order.
        joints: Joint names.
        start: Initial generalised positions of the figure.
        usable: Largest torque of each joint (n,) [N·m].
        scene: Name of the scene; empty without scenes.
        scenes: Name and one sentence of every scene.
        play: Description of `Play` in this scene; empty: none.
        presets: Names of presets.
        walls: Planes to be drawn: a point (3,) [m] and the direction (3,) into it.
        home: First pose of the tool (4, 4).
        max_push: Largest force [N] and torque [N·m] of the push sliders; None: no pushing.
        force: Force [N] of the longest arrow.
        reach: Reach of the arm [m].
        visuals: Shapes of the arm's URDF.
        table: Height of the table under the arm [m]; None: not known.
    """

    figure: Any
    arm: str
    where: str
    axes: tuple[str, ...]
    joints: tuple[str, ...]
    start: Array
    usable: Array
    scene: str
    scenes: Mapping[str, str]
    play: str
    presets: tuple[str, ...]
    walls: tuple[tuple[Array, Array], ...]
    home: Array
    max_push: tuple[float, float] | None
    force: float
    reach: float
    visuals: tuple[Visual, ...] = ()
    table: float | None = None


@dataclass(frozen=True, kw_only=True)
class SettingsView:
    """The settings in force, as controls show them.

    Attributes:
        law: Law of the controller.
        preset: The last chosen preset.
        firm: True while no axis yields.
        axes: Fields of `pliant.Axis` per task axis, with all arm-dependent values filled in.
        thresholds: Effective d- and d+ of each axis (k, 2) [m or rad].
    """

    law: str
    preset: str
    firm: bool
    axes: Mapping[str, Mapping[str, Any]]
    thresholds: Array


@dataclass(frozen=True, kw_only=True)
class LoopTiming:
    """Timing of the loop since torque on.

    Attributes:
        rate: Requested ticks per second [Hz].
        ticks: Ticks so far.
        p50, p99, largest: Lateness of ticks [s].
        missed, stale, refused, restarts: Counts of `pliant.Loop`.
        delay: Time from a reading to the arrival of the goal [s]; None: not yet measured.
        speed: Simulated seconds per real second; 1 for a real arm.
    """

    rate: float
    ticks: int = 0
    p50: float = 0.0
    p99: float = 0.0
    largest: float = 0.0
    missed: int = 0
    stale: int = 0
    refused: int = 0
    restarts: int = 0
    delay: float | None = None
    speed: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Step:
    """Controller state after a step; arrays as of `pliant.Controller`."""

    target: Array
    reference: Array
    deviation: Array
    compliance: Array
    softness: Array
    strength: Array
    wrench: Array
    activation: Array
    limit: Array
    saturated: Mask
    locked: Mask


@dataclass(frozen=True, kw_only=True)
class ForceEstimate:
    """Force at the tool, estimated from joint positions, base axes.

    Attributes:
        force: Force and torque (6,) of the surroundings on the tool [N, N·m].
        bound: Uncertainty of each (6,); inf if it cannot be estimated.
    """

    force: Array
    bound: Array

    @property
    def significant_force(self) -> Array:
        """The force (3,) [N] along the axes where it is above its bound; 0 along the others."""
        return np.where(np.abs(self.force) > self.bound, self.force, 0.0)[:3]


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """State of the arm at one time.

    Attributes:
        time: On the arm's clock [s].
        phase: Phase of the arm's life.
        qpos: Generalised positions of the figure.
        mocap: Positions and quaternions wxyz of the mocap bodies.
        tool: Pose of the tool (4, 4).
        step: The controller's step; None without one.
        pull: Point of application (3,) [m] and force (3,) [N] of the hand; for a real arm, the
            estimated force at the tool above its uncertainty. None: no hand.
        felt: Estimated force at the tool; None without a controller.
        health: Timing of the loop.
        report: Sentences on the present pose.
        notice: Number of errors and messages so far, the last one, and True if it is an error.
        edit: Number of the last processed edit.
        shown: The settings in force; None before the first.
    """

    time: float
    phase: Phase
    qpos: Array
    mocap: tuple[Array, Array]
    tool: Array
    step: Step | None
    pull: tuple[Array, Array] | None
    felt: ForceEstimate | None
    health: LoopTiming
    report: tuple[str, ...] = ()
    notice: tuple[int, str, bool] = (0, "", False)
    edit: int = 0
    shown: SettingsView | None = None
