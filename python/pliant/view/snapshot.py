"""What the arm tells a page: once per scene, once per change of settings, thirty times a second."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.view.visuals import Visual

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Phase = Literal["starting", "running", "lowering", "down"]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """What stays the same until the scene changes.

    Attributes:
        figure: The arm and its scene as a MuJoCo model, to be drawn.
        arm: Name of the arm.
        where: `simulated`, or what drives the joints.
        axes: Task axes in their order.
        joints: Joint names.
        start: Generalised positions of the figure at the beginning.
        usable: Largest torque of each joint (n,) [N·m].
        scene: Name of the scene; empty without scenes.
        scenes: Name and one sentence of every scene there is.
        play: What `Play` does here; empty: nothing.
        presets: Names of presets.
        walls: Planes to be drawn: a point (3,) [m] and the direction (3,) into it.
        home: First pose of the tool (4, 4).
        strong: Force [N] and torque [N·m] that fill the push sliders; None: nobody can push.
        force: Force [N] that the longest arrow stands for.
        reach: Of the arm [m].
        visuals: Shapes of the arm's URDF.
        table: Height of the table that the arm stands on [m]; None: not known.
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
    strong: tuple[float, float] | None
    force: float
    reach: float
    visuals: tuple[Visual, ...] = ()
    table: float | None = None


@dataclass(frozen=True, kw_only=True)
class Shown:
    """The settings in force, as controls show them.

    Attributes:
        law: Of the controller.
        preset: The last one that was chosen.
        firm: Whether nothing yields for now.
        axes: Per task axis the fields of `pliant.Axis`, all that depends on the arm filled in.
        thresholds: Effective d- and d+ of each axis (k, 2) [m or rad].
    """

    law: str
    preset: str
    firm: bool
    axes: Mapping[str, Mapping[str, Any]]
    thresholds: Array


@dataclass(frozen=True, kw_only=True)
class Health:
    """How the loop has kept its time since torque came on.

    Attributes:
        rate: Ticks per second that were asked for [Hz].
        ticks: So far.
        p50, p99, largest: Lateness of ticks [s].
        missed, stale, refused, restarts: Counts of `pliant.Loop`.
        delay: From positions to the arrival of the goal [s]; None: not yet measured.
        speed: Simulated seconds per second; 1 where time is real.
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
    """What the controller knows after a step; arrays as of `pliant.Controller`."""

    target: Array
    reference: Array
    deviation: Array
    compliance: Array
    softness: Array
    strength: Array
    wrench: Array
    activation: Array
    limit: Array
    saturated: Flags
    locked: Flags


@dataclass(frozen=True, kw_only=True)
class Felt:
    """What the positions of the joints say of the force at the tool, base axes.

    Attributes:
        force: Force and torque (6,) of the surroundings on the tool [N, N·m].
        bound: How far each may be off (6,); inf where nothing can be told.
    """

    force: Array
    bound: Array

    @property
    def certain(self) -> Array:
        """The force (3,) [N] along the axes where it is above its bound; 0 along the others."""
        return np.where(np.abs(self.force) > self.bound, self.force, 0.0)[:3]


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """One moment.

    Attributes:
        time: On the arm's clock [s].
        phase: Of the arm's life.
        qpos: Generalised positions of the figure.
        mocap: Positions and quaternions wxyz of what is moved by prescription.
        tool: Pose of the tool (4, 4).
        step: The controller's step; None while there is none.
        pull: Point of attack (3,) [m] and force (3,) [N] of the hand on the arm; of a real arm
            what is felt at the tool beyond doubt. None: no hand.
        felt: What is felt at the tool; None while there is no controller.
        health: Of the loop.
        report: Sentences on the present pose.
        said: How many errors and news there were, the last of them, and whether it is an error.
        edit: Number of the last edit that was dealt with.
        shown: The settings in force; None before the first.
    """

    time: float
    phase: Phase
    qpos: Array
    mocap: tuple[Array, Array]
    tool: Array
    step: Step | None
    pull: tuple[Array, Array] | None
    felt: Felt | None
    health: Health
    report: tuple[str, ...] = ()
    said: tuple[int, str, bool] = (0, "", False)
    edit: int = 0
    shown: Shown | None = None
