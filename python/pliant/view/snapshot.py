"""Data that the control loop sends to the browser page: scene description, snapshots of the arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from pliant._typing import Array, Mask
    from pliant.view.robot_view import Visual

    Phase = Literal["starting", "running", "lowering", "down"]


@dataclass(frozen=True, kw_only=True)
class SceneInfo:
    """Description of arm and scene for the page, constant until the scene changes.

    Attributes:
        mj_model: MuJoCo model of the arm and its scene, for drawing.
        arm: Display name of the arm.
        where: `simulated`, or the backend of the configuration.
        axes: Names of the k task axes.
        joints: Names of the n joints.
        start: Initial generalised positions (`qpos`) of `mj_model`.
        max_torque: Maximum torque of each joint (n,) [N·m].
        scene: Name of the scene; empty: the arm has no scenes.
        scenes: Description of every scene by name.
        play: Label of the button that starts the action of the scene; empty: no action.
        presets: Names of the presets of settings.
        walls: Point (3,) [m] and normal (3,) into the wall, for every wall of the scene.
        home: Pose of the tool at the start (4, 4).
        max_push: Maximum force [N] and torque [N·m] of the push slider; None for a real arm.
        force: Force that is drawn as an arrow of full length [N].
        reach: Reach of the arm [m].
        visuals: Visual shapes of the arm's URDF.
        table: Height of the table under the arm, base axes [m]; None: unknown.
    """

    mj_model: Any
    arm: str
    where: str
    axes: tuple[str, ...]
    joints: tuple[str, ...]
    start: Array
    max_torque: Array
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
    """The settings in force, in the form of the page's controls.

    Attributes:
        law: Control law: `cap`, `impedance` or `paper`.
        preset: Name of the last chosen preset.
        firm: True if the user has switched off the yielding of all axes.
        axes: Fields of `pliant.Axis` by task axis; fields that the settings leave open have the
            values that the controller uses.
        thresholds: Deviations `soft_until` and `firm_from` that each axis uses (k, 2) [m or rad].
    """

    law: str
    preset: str
    firm: bool
    axes: Mapping[str, Mapping[str, Any]]
    thresholds: Array


@dataclass(frozen=True, kw_only=True)
class LoopTiming:
    """Timing of the control loop since torque was switched on.

    Attributes:
        rate: Requested control rate [Hz].
        ticks: Number of ticks so far.
        p50, p99, largest: Median, 99th percentile and maximum of the lateness of ticks [s].
        missed, missing, rejected, restarts: Counters of `pliant.Loop`.
        delay: Time from sampling positions until the servos use the goals computed from them [s];
            None before it is measured.
        speed: Simulated seconds per real second; 1 for a real arm.
    """

    rate: float
    ticks: int = 0
    p50: float = 0.0
    p99: float = 0.0
    largest: float = 0.0
    missed: int = 0
    missing: int = 0
    rejected: int = 0
    restarts: int = 0
    delay: float | None = None
    speed: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Step:
    """State of the controller after a step.

    The fields are those of `Controller.diagnostics`, except for three: `target` is the target pose
    (4, 4), `strength` is `axis_strength` there, and `limit` is `Command.torque_limit`.
    """

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
    """Estimated external force on the tool, in base axes.

    Attributes:
        force: Force and torque (6,) on the tool [N, N·m].
        bound: Uncertainty of each component (6,) [N, N·m]; inf: the component is unknown.
    """

    force: Array
    bound: Array

    @property
    def significant_force(self) -> Array:
        """Force (3,) [N], with 0 for every component within its uncertainty."""
        return np.where(np.abs(self.force) > self.bound, self.force, 0.0)[:3]


class Notice(NamedTuple):
    """Message to the user of the page.

    Attributes:
        number: Number of changes of the message so far.
        text: The message; empty: no message.
        is_error: True if the message is an error.
    """

    number: int = 0
    text: str = ""
    is_error: bool = False


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """State of the arm at one time, which the loop sends to the page.

    Attributes:
        time: Time on the arm's clock [s].
        phase: Phase of the run: `starting`, `running`, `lowering` or `down`.
        qpos: Generalised positions of the MuJoCo model `SceneInfo.mj_model`.
        mocap: Positions (m, 3) [m] and quaternions wxyz (m, 4) of the mocap bodies of that model.
        tool: Pose of the tool (4, 4).
        step: State of the controller; None while no controller runs.
        hand_force: Point of application (3,) [m] and force (3,) [N] of a simulated hand; for a real
            arm, the significant part of the estimated force on the tool. None: no force.
        contact_force: Estimated force on the tool; None while no controller runs.
        health: Timing of the control loop.
        report: Sentences on the forces that the arm can exert in its pose (`Controller.report`).
        notice: Message to the user.
        edit: Number of the last change of the settings that was handled.
        shown: The settings in force; None before the first run.
    """

    time: float
    phase: Phase
    qpos: Array
    mocap: tuple[Array, Array]
    tool: Array
    step: Step | None
    hand_force: tuple[Array, Array] | None
    contact_force: ForceEstimate | None
    health: LoopTiming
    report: tuple[str, ...] = ()
    notice: Notice = field(default_factory=Notice)
    edit: int = 0
    shown: SettingsView | None = None


class Ended(NamedTuple):
    """State of the arm at the end of the program, the last object that the loop sends to the page.

    Attributes:
        text: How the last run ended, in a sentence.
        is_off: True if the torque of all joints is off.
    """

    text: str
    is_off: bool
