"""Processor time of a vector environment, beside that of its physics alone.

    python benches/gym_share.py              # Door
    python benches/gym_share.py Drawer Wipe

Two equal environments with one thread alternate, step by step. The first one makes complete steps.
The second one computes the physics only, with the commands of the first, so that both have the same
states. Physics are the steps of MuJoCo, and the forces in tasks that compute forces in Python.
"""

from __future__ import annotations

import statistics
import sys
import time
from typing import TYPE_CHECKING

import numpy as np

from pliant import gym
from pliant.gym._arms import RATE
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from pliant.sim import Plant

ARMS, STEPS, REPEATS = 64, 15, 9


def run_physics(task: gym.Task, plants: list[Plant]) -> None:
    """Run the physics of all plants for one control period."""
    for plant in plants:
        if task.native:
            mujoco.mj_step(plant.mj_model, plant.mj_data, plant.steps)
        else:
            plant.advance()


def send(task: gym.Task, plants: list[Plant], goals: np.ndarray, limits: np.ndarray) -> None:
    """Send the commands of one tick to all plants."""
    for plant, goal, limit in zip(plants, goals, limits, strict=True):
        if task.native:
            plant.mj_data.ctrl[: plant.n] = goal
            plant.mj_model.actuator_forcerange[: plant.n] = np.stack([-limit, limit], axis=1)
        else:
            plant.write(goal, limit)


def ticks_of_one_arm(task: gym.Task, episodes: int = 4) -> float:
    """Return the ticks per second of processor time of a `TaskEnv`, in episodes of equal length."""
    env, total, steps = gym.TaskEnv(task), 0.0, 0
    rng = np.random.default_rng(0)
    for seed in range(episodes):
        env.reset(seed=seed)
        action = rng.uniform(-0.1, 0.1, env.action_space.shape)
        is_over = False
        while not is_over and steps < (seed + 1) * STEPS * REPEATS:
            start = time.process_time()
            is_over = env.step(action)[2]
            total += time.process_time() - start
            steps += 1
    return steps * round(RATE / task.decision_rate) / total


def measure(task: gym.Task) -> None:
    """Print ticks per second of processor time, and the share of it that is not physics."""
    whole, other = (
        gym.VectorTaskEnv(task, num_envs=ARMS, threads=1, autoreset_mode="Disabled")
        for _ in range(2)
    )
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, whole.action_space.shape)
    for env in (whole, other):
        env.reset(seed=0)
        env.step(actions)
    arms, others = whole._arms[0], other._arms[0]
    times, count = [], 0
    for _ in range(REPEATS):
        total = alone = 0.0
        for _ in range(STEPS):
            # An arm whose episode has ended stands still.
            rows = np.flatnonzero(~whole._ended)
            start = time.process_time()
            whole.step(actions)
            total += time.process_time() - start
            plants = [others.plants[row] for row in rows]
            for goals, limits in zip(arms._goals[1:], arms._limits[1:], strict=True):
                send(task, plants, goals[rows], limits[rows])
                start = time.process_time()
                run_physics(task, plants)
                alone += time.process_time() - start
            count += len(rows) * len(arms._goals[1:])
        times.append((total, alone))
    for one, two in zip(arms.plants, others.plants, strict=True):
        assert (one.mj_data.qpos == two.mj_data.qpos).all(), "the two environments differ"
    total, alone = (
        REPEATS * statistics.median(column) / count for column in zip(*times, strict=True)
    )
    shares = sorted(1.0 - part / both for both, part in times)
    print(f"{type(task).__name__}: {1.0 / total:.0f} ticks of an arm per second of", end=" ")
    print(f"processor time ({ticks_of_one_arm(task):.0f} in a TaskEnv),", end=" ")
    print(
        f"{1e6 * total:.1f} µs each, of which physics {1e6 * alone:.1f} µs; not physics:", end=" "
    )
    print(f"{100.0 * statistics.median(shares):.1f} %", end=" ")
    print(f"({100.0 * shares[0]:.1f} to {100.0 * shares[-1]:.1f} %)")


def main() -> None:
    """Measure the tasks that are named on the command line."""
    for name in sys.argv[1:] or ["Door"]:
        measure(getattr(gym, name)())


if __name__ == "__main__":
    main()
