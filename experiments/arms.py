"""Arms of the experiments: built-in arms, and real robots whose URDF is available locally."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import pliant
from pliant import robots
from pliant.sim._parameters import tabulate
from pliant.sim.postures import task_axes

if TYPE_CHECKING:
    from experiments.poses import Array


AXES = ("x", "y", "z", "roll", "pitch", "yaw")
#: Number of random poses of an arm, and smallest accepted singular value of the Jacobian of a pose,
#: as a share of the median over these poses.
SAMPLES, LEAST_SIGMA = 512, 0.65
#: Force caps of the campaign as shares of the arm's median static capacity (`Arm.capacity`): for
#: translations, and for rotations.
SHARES = ((0.15, 0.30, 0.60), (0.07, 0.14))
#: Scale of rotations in singular values: 1 rad counts as much as (reach / `REACH_OF_ONE`) m, with
#: the reach of the arm and this constant in m.
REACH_OF_ONE = 0.71


def _robots() -> Path:
    """Return the folder with URDFs of real robots.

    The folder is the environment variable `PLIANT_ROBOTS` if it is set; else `shared/robots` beside
    a clone of this repository; else `robots` in the working directory.
    """
    if folder := os.environ.get("PLIANT_ROBOTS"):
        return Path(folder)
    root = Path(__file__).resolve().parents[1]
    # Only a clone of the repository has a pyproject.toml. A folder `shared` beside an installed
    # package would belong to another program, so it is not used.
    return (
        root.parent / "shared" / "robots" if (root / "pyproject.toml").is_file() else Path("robots")
    )


#: Folder with URDFs of real robots.
ROBOTS = _robots()
BESIDE = {
    "so101 (real)": ("so101/so101_new_calib.urdf", "base_link", "gripper_frame_link"),
    "koch (real)": ("koch_low_cost/low-cost-arm.urdf", "base_link", "gripper-static-motor_v2_1"),
    "vx300s": ("vx300s/vx300s.urdf", "vx300s/base_link", "vx300s/ee_gripper_link"),
    "panda": ("panda/panda.urdf", "panda_link0", "panda_link8"),
    "ur5e": ("ur5e/ur5e.urdf", "world", "tool0"),
    "xarm7": ("xarm7/xarm7.urdf", "world", "link_tcp"),
}


@dataclass(frozen=True)
class Arm:
    """Robot with servos, task axes and random poses.

    Attributes:
        name: Name in tables.
        model: The robot, with servo parameters.
    """

    name: str
    model: pliant.Model

    @property
    def servos(self) -> pliant.Servos:
        """Servo parameters that the controller assumes."""
        table = self.model.servos
        if table is None:
            raise pliant.ConfigError(f"{self.name} has no servos")
        return table

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Names of the task axes, as many as the joints can control."""
        return task_axes(self.model.n)

    @cached_property
    def rows(self) -> list[int]:
        """Indices of the rows of the Jacobian (6, n) that belong to the task axes."""
        return [AXES.index(name) for name in self.axes]

    @cached_property
    def drawn(self) -> Array:
        """Random poses (512, n) [rad] within the joint `ranges`."""
        low, high = ranges(self.model)
        return np.random.default_rng(0).uniform(low, high, (SAMPLES, self.model.n))

    def sigma(self, q: Array) -> Array:
        """Return the smallest singular value of the task rows of the Jacobian (..., 6, n) at q.

        Translations are divided by reach / `REACH_OF_ONE`. `q` is a pose (n,), or poses (N, n)
        [rad].
        """
        jacobian = self.model.jacobian if q.ndim == 1 else self.model.jacobian_batch
        length = self.model.reach / REACH_OF_ONE
        weight = np.array([1.0 / length if row < 3 else 1.0 for row in self.rows])
        rows = weight[:, None] * np.asarray(jacobian(q))[..., self.rows, :]
        return np.asarray(np.linalg.svd(rows, compute_uv=False)[..., -1])

    def poses(self, count: int) -> Array:
        """Return the first `count` of `drawn` that are not near a singularity (count, n) [rad]."""
        sigma = self.sigma(self.drawn)
        accepted: Array = self.drawn[sigma > LEAST_SIGMA * np.median(sigma)]
        return accepted[:count]

    def capacity(self, q: Array, row: int, sign: float, payload: float = 0.0) -> float:
        """Return the largest push along an axis that the servos hold in pose q [N or N·m].

        The value is that of the function `capacity`, but 0 if no joint moves the axis.
        """
        size = capacity(self.model, self.servos, q, row, sign, payload=payload)
        return 0.0 if np.isinf(size) else size

    @cached_property
    def median_capacity(self) -> tuple[float, float]:
        """Medians of `capacity` over `drawn`, axes and signs: translations [N], rotations [N·m]."""

        def median(rows: list[int]) -> float:
            signs = (1.0, -1.0)
            sizes = [self.capacity(q, r, s) for q in self.drawn for r in rows for s in signs]
            return float(np.median(sizes)) if sizes else 0.0

        return median([r for r in self.rows if r < 3]), median([r for r in self.rows if r > 2])

    def caps(self, row: int) -> tuple[float, ...]:
        """Return the caps that the campaign tests on an axis, rounded to one digit [N or N·m].

        For `arm7` these are 5, 10 and 20 N for a translation, and 0.5 and 1 N·m for a rotation.
        """
        kind = row // 3
        return tuple(float(f"{s * self.median_capacity[kind]:.0e}") for s in SHARES[kind])


def ranges(model: pliant.Model) -> tuple[Array, Array]:
    """Return lower and upper joint limits (n,) [rad]; ±π for a joint with an infinite limit."""
    lower, upper = np.asarray(model.lower), np.asarray(model.upper)
    endless = ~(np.isfinite(lower) & np.isfinite(upper))
    return np.where(endless, -np.pi, lower), np.where(endless, np.pi, upper)


def capacity(
    model: pliant.Model,
    servos: pliant.Servos,
    q: Array,
    row: int,
    sign: float,
    *,
    payload: float = 0.0,
) -> float:
    """Return the static capacity of an axis: the largest push that the servos hold [N or N·m].

    The capacity is ``min_i (usable_i + sign(a_i) g_i) / |a_i|`` over the joints i, with the usable
    torque of each servo [N·m], ``a`` = `sign` times row `row` of the Jacobian, and the gravity
    torques g [N·m] at q (n,) [rad] with a `payload` [kg] at the tool. It is negative if the arm
    cannot hold its weight, and infinite if no joint moves the axis.
    """
    jacobian = model.jacobian(q)
    gravity = model.gravity(q) - payload * model.gravity_vector @ jacobian[:3]
    lever = sign * jacobian[row]
    is_moved = np.abs(lever) > 1e-6
    room = np.asarray(servos.max_torque) + np.sign(lever) * gravity
    return float((room[is_moved] / np.abs(lever[is_moved])).min(initial=np.inf))


@cache
def load(name: str) -> Arm:
    """Load an arm by name.

    Raises:
        ConfigError: The name is unknown.
        FileNotFoundError: The URDF of the arm is not available.
    """
    if name in robots.names():
        return Arm(name, robots.load(name))
    if name not in BESIDE:
        known = ", ".join((*robots.names(), *BESIDE))
        raise pliant.ConfigError(f"no arm {name!r} in the campaign; there are {known}")
    file, base, tip = BESIDE[name]
    model = pliant.Model.from_urdf(ROBOTS / file, base=base, tip=tip)
    servos = _table(name, model)
    return Arm(name, pliant.Model.from_urdf(ROBOTS / file, base=base, tip=tip, servos=servos))


def available() -> tuple[list[str], list[str]]:
    """Return two lists of names: arms that can be loaded, and arms whose URDF is missing."""
    available_names = [name for name, (file, _, _) in BESIDE.items() if (ROBOTS / file).exists()]
    return [*robots.names(), *available_names], [
        name for name in BESIDE if name not in available_names
    ]


def _table(name: str, model: pliant.Model) -> pliant.Servos:
    """Return servo parameters for the model of a real robot, which has none.

    They are copied from a built-in arm of the same type, or estimated by the simulator.
    """
    built_in = {"so101 (real)": "so101", "koch (real)": "koch"}.get(name)
    if built_in is not None:
        table = load(built_in).servos
        fields = ("kp", "max_torque", "friction", "damping", "armature", "encoder_step")
        cut = {field: np.asarray(getattr(table, field))[: model.n] for field in fields}
        speed = np.asarray(table.no_load_speed)[: model.n]
        return pliant.Servos(**cut, limit_type="pwm", no_load_speed=speed, stiffness_known=True)
    return tabulate(model, None).replace(stiffness_known=True)
