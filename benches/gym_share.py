"""Processor time of a vector environment of doors, beside that of its steps of MuJoCo alone.

    python benches/gym_share.py

Two equal environments with one thread run in turn: one completely, the other with the physics only,
in the same order of arms. The caches are as cold in both.
"""

from __future__ import annotations

import statistics
import time

import numpy as np

from pliant.gym import Door, VectorTaskEnv
from pliant.gym._arms import RATE
from pliant.sim._mujoco import mujoco

ARMS, STEPS, REPEATS = 64, 15, 9


def main() -> None:
    """Print ticks per second of processor time, and the share of it that is not physics."""
    whole, physics = (
        VectorTaskEnv(Door(), num_envs=ARMS, threads=1, autoreset_mode="Disabled") for _ in range(2)
    )
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, whole.action_space.shape)
    for env in (whole, physics):
        env.reset(seed=0)
        env.step(actions)
    arms = [(plant.mj_model, plant.mj_data, plant.steps) for plant in physics._arms[0].plants]
    ticks = STEPS * round(RATE / whole.task.decision_rate)
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        for _ in range(STEPS):
            whole.step(actions)
        middle = time.process_time()
        for _ in range(ticks):
            for arm in arms:
                mujoco.mj_step(*arm)
        times.append((middle - start, time.process_time() - middle))
    all_of_it, alone = (statistics.median(column) for column in zip(*times, strict=True))
    shares = sorted(1.0 - part / total for total, part in times)
    print(f"{ARMS * ticks / all_of_it:.0f} ticks of an arm per second of processor time")
    print(f"not physics: {100.0 * statistics.median(shares):.0f} %", end=" ")
    print(f"({100.0 * shares[0]:.0f} to {100.0 * shares[-1]:.0f} %)")
    print(f"per tick: {1e6 * all_of_it / ARMS / ticks:.1f} µs, of which MuJoCo", end=" ")
    print(f"{1e6 * alone / ARMS / ticks:.1f} µs")


if __name__ == "__main__":
    main()
