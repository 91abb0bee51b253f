"""Simulated arms at one task: physics, controllers, contact estimation and rewards of N arms."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant import robots
from pliant._core import ContactEstimator, Controller, PliantError, Settings, update_contacts
from pliant._validation import AXES
from pliant.gym.soft_action import SoftAction, holding_forces
from pliant.sim import Plant
from pliant.sim._native import NativeArms

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant._typing import Array, Mask
    from pliant.gym.tasks import Episode, Task

#: Rate of the controller [Hz].
RATE = 100.0
#: Largest distance of the target from the tool, also while the arm is blocked: along each base axis
#: [m], and angle [rad].
LEASH = (0.08, 0.5)
#: Trace of a rotation by the largest angle: 1 + 2 cos(angle).
LEASH_TRACE = 1.0 + 2.0 * float(np.cos(LEASH[1]))
#: Bounds of the observed uncertainty of force [N] and torque [N·m], which is infinite in the first
#: tick.
MAX_WRENCH = np.array([100.0] * 3 + [20.0] * 3)


class Arms:
    """Arms of one or more environments; every array has one row per arm.

    Args:
        task: The task of all arms.
        action: Mapping of actions; None: twist and the softness of the task's axes.
        count: Number of arms N.

    Attributes:
        action: The mapping.
        sizes: Number of entries of each observation, by key.
        episodes: Episode of each arm; None before its first reset.
        plants: Simulated arms; None before their first reset.
        force: Largest force on the tool in the last step (N,) [N].
    """

    def __init__(self, task: Task, action: SoftAction | None, count: int) -> None:
        self._task, self._count = task, count
        self.action = SoftAction(soft=task.soft) if action is None else action
        self.model = robots.arm7()
        settings = Settings(rate=RATE)
        axes = settings.task.names
        self.action_size = self.action.size(self.model, axes)
        soft = self.action.axes(axes)
        self._columns = [AXES.index(name) for name in soft]
        self._hold = holding_forces(self.model, settings)
        self._softest = -np.ones(len(soft))
        self._settings = self.action.softened(settings, self._hold, self._softest)
        self._controller = Controller(self.model, self._settings)
        self._state = self._controller.batch_state(count)
        self._scales = self.action.scales(axes)
        self._ticks = round(RATE / task.decision_rate)
        # `step_joints` also uses the joint target as rest posture, which a batch does not support.
        joints = self.action.motion == "joints"
        self._own = [Controller(self.model, self._settings) for _ in range(count * joints)]
        self._contact = [ContactEstimator(self._controller) for _ in range(count)]
        self.plants: list[Plant | None] = [None] * count
        self.episodes: list[Episode | None] = [None] * count
        n = self.model.n
        self._native = NativeArms(count, n) if task.native else None
        self.sizes = {
            "q": n, "dq": n, "tool": 9, "deviation": 6, "force": 6, "uncertainty": 6,
            "caps": len(soft),
        }  # fmt: skip
        self._q, self._dq = np.zeros((count, n)), np.zeros((count, n))
        self._target = np.tile(np.eye(4), (count, 1, 1))
        self._felt, self._uncertainty = np.zeros((count, 6)), np.tile(MAX_WRENCH, (count, 1))
        self._softness = np.tile(self._softest, (count, 1))
        self._has_command = np.zeros(count, dtype=bool)
        self._speed = np.zeros((count, n))
        # Positions and forces at the ticks of an action; the commands before and after each tick.
        ticks = self._ticks
        self._readings, self._forces = np.zeros((ticks, count, n)), np.zeros((ticks, count))
        self._goals, self._limits = np.zeros((2, ticks + 1, count, n))
        # Positions and commands arm by arm: an estimator reads contiguous memory in place.
        self._series = np.zeros((3, count, ticks, n))
        self._progress, self._force, self._place = np.zeros((3, count))
        self.force = np.zeros(count)

    def reset(self, row: int, rng: np.random.Generator) -> None:
        """Start an episode of an arm with new random parameters."""
        episode = self.episodes[row] = self._task.episode(rng)
        seed = int(rng.integers(2**31))
        plant = self.plants[row] = Plant(self.model, scene=episode.scene, rate=RATE, seed=seed)
        plant.reset(self._task.start)
        if self._native is not None:
            self._native.put(row, plant)
        q = self._q[row] = plant.read().q
        self._state.reset(row, q)
        if self._own:
            self._own[row].update(self._settings)
            self._own[row].reset(q)
        # Create an estimator: `reset` would leave rounding errors of the last episode in filters.
        self._contact[row] = ContactEstimator(self._controller)
        self._target[row] = self.model.forward_kinematics(q)
        self._softness[row], self._dq[row], self._felt[row] = self._softest, 0.0, 0.0
        self._uncertainty[row], self._has_command[row], self.force[row] = MAX_WRENCH, False, 0.0
        self._progress[row], self._force[row], self._place[row] = 0.0, 0.0, np.nan

    def step(self, actions: Array, rows: Mask) -> tuple[Array, Mask, Mask]:
        """Run the controllers of some arms for one period of the decision rate.

        Args:
            actions: Actions (N, size).
            rows: Mask (N,) of the arms that move; each has an episode.

        Returns:
            Rewards, success and failure (N,); undefined for other arms.

        Raises:
            PliantError: The physics diverged.
        """
        active = [int(row) for row in np.flatnonzero(rows)]
        given = np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0)
        moved, softness = np.split(given, [given.shape[1] - self._softest.size], axis=1)
        self._softness[rows] = softness[rows]
        before = self._progress.copy()
        dt = 1.0 / RATE
        drive = self._start(moved, rows)
        for tick in range(self._ticks):
            self._readings[tick] = self._q
            goal, limit = self._goals[tick + 1], self._limits[tick + 1]
            drive(dt, goal, limit)
            self._advance(active, rows, dt, goal, limit)
            self._forces[tick] = self._force
        free = self._task.free_force
        excess = np.maximum(self._forces - free, 0.0) / free
        # `np.sum` would add in another order for one arm than for many.
        cost = functools.reduce(np.add, self._task.force_weight * excess * dt)
        largest = self._forces.max(axis=0)
        if not np.isfinite(self._q).all():
            wrong = int((~np.isfinite(self._q)).any(axis=1).argmax())
            raise PliantError(f"the simulation of arm {wrong} of {self._count} diverged")
        self.force[rows] = largest[rows]
        self._feel(rows, dt)
        self._goals[0], self._limits[0] = goal, limit
        self._has_command[rows] = True
        success, failure = self._progress >= 1.0, largest > self._task.max_force
        return self._progress - before - cost + success - failure, success, failure

    def observation(self) -> dict[str, Array]:
        """Return the observations by key, arrays (N, size)."""
        tool = self.model.forward_kinematics_batch(self._q)
        difference = self._target[:, :3, :3] @ tool[:, :3, :3].transpose(0, 2, 1)
        caps, _ = self.action.caps(self._hold, self._softness)
        return {
            "q": self._q.copy(),
            "dq": self._dq.copy(),
            "tool": np.concatenate([tool[:, :3, 3], tool[:, :3, 0], tool[:, :3, 1]], axis=1),
            "deviation": np.concatenate(
                [self._target[:, :3, 3] - tool[:, :3, 3], _rotation_vectors(difference)], axis=1
            ),
            "force": self._felt.copy(),
            "uncertainty": self._uncertainty.copy(),
            "caps": caps,
        }

    def info(self, row: int) -> dict[str, Any]:
        """Return the `info` of an arm: true values that its policy does not observe."""
        episode = self.episodes[row]
        assert episode is not None
        return {
            "force": float(self.force[row]),
            "progress": float(self._progress[row]),
            "is_success": bool(self._progress[row] >= 1.0),
            **episode.parameters,
        }

    def progress(self) -> Array:
        """Return the progress of each episode (N,); 0 for an arm without an episode."""
        return self._progress.copy()

    def _start(self, moved: Array, rows: Mask) -> Callable[[float, Array, Array], None]:
        """Return the function that steps all controllers once per tick of this action."""
        if self.action.motion == "joints":
            reach = 0.1 * self.action.max_speed[1]
            wanted = np.clip(self._q + reach * moved, self.model.lower, self.model.upper)
            return self._joint_steps(wanted, rows)
        dt = 1.0 / RATE
        caps, adaptation = np.full((2, self._count, 6), np.nan)
        caps[:, self._columns], adaptation[:, self._columns] = self.action.caps(
            self._hold, self._softness
        )
        twist = self.action.motion == "twist"
        change = moved * self._scales * (dt if twist else 0.1)
        turn = _rotations(change[:, 3:])
        if not twist:
            tool = self.model.forward_kinematics_batch(self._q)
            self._target[rows] = tool[rows]
            self._move(change, turn, tool, rows)

        def step(dt: float, goal: Array, limit: Array) -> None:
            if twist:
                tool = self.model.forward_kinematics_batch(self._q)
                self._move(change, turn, tool, rows)
            self._controller.step_batch(
                self._q,
                self._target,
                state=self._state,
                dt=dt,
                caps=caps,
                adaptation=adaptation,
                out=(goal, limit, self._speed),
            )

        return step

    def _joint_steps(self, wanted: Array, rows: Mask) -> Callable[[float, Array, Array], None]:
        """Return the function that steps the arms toward joint targets `wanted` (N, n) [rad]."""
        active = [int(row) for row in np.flatnonzero(rows)]
        for row in active:
            settings = self.action.softened(self._settings, self._hold, self._softness[row])
            self._own[row].update(settings)

        def step(dt: float, goal: Array, limit: Array) -> None:
            for row in active:
                command = self._own[row].step_joints(self._q[row], wanted[row], dt=dt)
                goal[row], limit[row] = command.goal, command.torque_limit

        return step

    def _move(self, change: Array, turn: Array, tool: Array, rows: Mask) -> None:
        """Move targets along the base axes, up to the distance `LEASH` from the tool.

        Args:
            change: Displacements (N, 6) [m, rad]; the last three entries are a rotation vector.
            turn: Rotation matrices of these rotation vectors (N, 3, 3).
            tool: Poses of the tools (N, 4, 4).
            rows: Mask of the arms whose targets move.
        """
        place, target = tool[:, :3, 3], self._target[:, :3, :3]
        offset = self._target[:, :3, 3] + change[:, :3] - place
        np.maximum(np.minimum(offset, LEASH[0], out=offset), -LEASH[0], out=offset)
        turned = turn @ np.ascontiguousarray(target)
        near = (turned * tool[:, :3, :3]).sum(axis=(1, 2)) >= LEASH_TRACE
        np.copyto(self._target[:, :3, 3], place + offset, where=rows[:, None])
        np.copyto(target, turned, where=(near & rows)[:, None, None])

    def _feel(self, rows: Mask, dt: float) -> None:
        """Update contact estimators with the readings and commands of all ticks."""
        for i, ticks in enumerate((self._readings, self._goals[:-1], self._limits[:-1])):
            self._series[i] = ticks.transpose(1, 0, 2)
        q, goal, limit = self._series
        ready = (rows & self._has_command).tolist()
        contacts = [
            one if is_ready else None for one, is_ready in zip(self._contact, ready, strict=True)
        ]
        out = (self._dq, self._felt, self._uncertainty)
        update_contacts(contacts, q, dt=dt, sent=(goal, limit), out=out)
        # The first reading of an episode has no command before it.
        for row in np.flatnonzero(rows & ~self._has_command).tolist():
            contact = self._contact[row]
            felt = contact.update(q[row, 0], dt=dt)
            if self._ticks > 1:
                sent = (goal[row, 1:], limit[row, 1:])
                felt = contact.update_series(q[row, 1:], dt=dt, sent=sent)
            self._dq[row], self._felt[row] = felt.velocity, felt.force
            self._uncertainty[row] = felt.uncertainty
        np.minimum(self._uncertainty, MAX_WRENCH, out=self._uncertainty)

    def _advance(self, active: list[int], rows: Mask, dt: float, goal: Array, limit: Array) -> None:
        """Send the commands, run the physics of one tick, and update force and progress."""
        if self._native is not None:
            native = self._native
            native.goal[:], native.limits[:, :, 1] = goal, limit
            np.negative(limit, out=native.limits[:, :, 0])
            native.advance(active)
            self._q[:], self._force[:], place = native.q, native.force, native.travel
        else:
            place = self._place.copy()
            for row in active:
                plant, episode = self.plants[row], self.episodes[row]
                assert plant is not None
                assert episode is not None
                plant.write(goal[row], limit[row])
                plant.advance()
                self._q[row] = plant.read().q
                place[row], self._force[row] = self._task.measure(episode, plant)
        move = np.where(np.isnan(self._place), 0.0, place - self._place)
        progress = self._task.progress(self._progress, move, place, self._force, dt)
        np.copyto(self._progress, progress, where=rows)
        np.copyto(self._place, place, where=rows)


def _rotations(vectors: Array) -> Array:
    """Return the rotation matrices (N, 3, 3) of rotation vectors (N, 3) [rad]."""
    angle = np.sqrt((vectors * vectors).sum(axis=1))
    x, y, z = (vectors / np.maximum(angle, 1e-12)[:, None]).T
    cross = np.zeros((angle.size, 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    sine, versine = np.sin(angle)[:, None, None], (1.0 - np.cos(angle))[:, None, None]
    out: Array = np.eye(3) + sine * cross + versine * (cross @ cross)
    return out


def _rotation_vectors(rotations: Array) -> Array:
    """Return the rotation vectors (N, 3) [rad] of rotations by less than half a turn."""
    trace = rotations[:, 0, 0] + rotations[:, 1, 1] + rotations[:, 2, 2]
    angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    axis = np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    large = angle > 1e-6
    scale = np.where(large, angle / np.sin(np.where(large, angle, 1.0)), 1.0)
    vectors: Array = 0.5 * axis * scale[:, None]
    return vectors
