"""Processor time of a vector environment, beside that of its physics alone.

    python benches/gym_share.py              # Door
    python benches/gym_share.py Drawer Wipe

Two equal environments with one thread take turns, step by step: one as it is; of the other only the
physics, with the commands of the first, so that both have the same states. Physics are the steps of
MuJoCo; in tasks whose forces are computed in Python, also these forces.
"""

from __future__ import annotations

import statistics
import sys
import time
from typing import TYPE_CHECKING

import numpy as np

from pliant import gym
from pliant.gym._arms import RATE, SIGNS
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.sim import Plant

ARMS, STEPS, REPEATS = 64, 15, 9


def physics_of(task: gym.Task, plants: list[Plant]) -> Callable[[], None]:
    """Return the function that runs the physics of all arms for one control period."""
    if not task.native:
        return lambda: [plant.advance() for plant in plants] and None
    arms = [(plant.mj_model, plant.mj_data, plant.steps) for plant in plants]

    def step() -> None:
        for arm in arms:
            mujoco.mj_step(*arm)

    return step


def send(task: gym.Task, plants: list[Plant], goals: np.ndarray, limits: np.ndarray) -> None:
    """Send the commands of one tick to all arms."""
    for plant, goal, limit in zip(plants, goals, limits, strict=True):
        if task.native:
            plant.mj_data.ctrl[: plant.n] = goal
            plant.mj_model.actuator_forcerange[: plant.n] = limit[:, None] * SIGNS
        else:
            plant.write(goal, limit)


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
    arms, plants = whole._arms[0], other._arms[0].plants
    physics = physics_of(task, plants)
    ticks = STEPS * round(RATE / task.decision_rate)
    times = []
    for _ in range(REPEATS):
        total = alone = 0.0
        for _ in range(STEPS):
            start = time.process_time()
            whole.step(actions)
            total += time.process_time() - start
            for goals, limits in zip(arms._goals[1:], arms._limits[1:], strict=True):
                send(task, plants, goals, limits)
                start = time.process_time()
                physics()
                alone += time.process_time() - start
        times.append((total, alone))
    for one, two in zip(arms.plants, plants, strict=True):
        assert (one.mj_data.qpos == two.mj_data.qpos).all(), "the two environments differ"
    total, alone = (statistics.median(column) for column in zip(*times, strict=True))
    shares = sorted(1.0 - part / whole for whole, part in times)
    print(f"{type(task).__name__}: {ARMS * ticks / total:.0f} ticks of an arm per second", end=" ")
    print(f"of processor time, {1e6 * total / ARMS / ticks:.1f} µs each, of which", end=" ")
    print(f"physics {1e6 * alone / ARMS / ticks:.1f} µs;", end=" ")
    print(f"not physics: {100.0 * statistics.median(shares):.1f} %", end=" ")
    print(f"({100.0 * shares[0]:.1f} to {100.0 * shares[-1]:.1f} %)")


def main() -> None:
    """Measure the tasks that are named on the command line."""
    for name in sys.argv[1:] or ["Door"]:
        measure(getattr(gym, name)())


if __name__ == "__main__":
    main()
