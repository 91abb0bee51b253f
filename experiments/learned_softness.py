"""Comparison of a learned policy with a constant action: opening doors with little force.

    python -m experiments.learned_softness            three seeds of both searches, then the picture
    python -m experiments.learned_softness --draw     only the picture, from the last results

The radius and friction of the doors are unknown. CMA-ES searches two kinds of parameters with the
same number of episodes, the same doors and the same start: a constant action (pull, sideways, turn,
and the softness of y and yaw), and a policy whose action depends linearly on the rotation of the
tool and on the estimated force. The cost of an episode is the largest force in the grip [N] plus
100 N times the missing share of an opening of 60°. Every few generations, the mean of the search
is measured on validation doors; the best of these means is measured once on the test doors.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from cmaes import CMA

import pliant.gym  # noqa: F401 - registers the environments

if TYPE_CHECKING:
    from pliant._typing import Array

#: Doors per candidate, candidates per generation, generations.
DOORS, CANDIDATES, GENERATIONS = 6, 10, 20
#: Generations between two measurements of the mean of the search.
MEASURE_EVERY = 5
#: Seeds of the doors that validate these means, and of those that test the best of them; no search
#: uses them.
VALIDATION, TEST = list(range(10**7, 10**7 + 24)), list(range(2 * 10**7, 2 * 10**7 + 48))
#: Seeds of the searches.
SEEDS = (1, 2, 3)
#: Length of an episode [steps of 0.05 s].
STEPS = 120
#: Cost of a door that stays closed [N].
CLOSED = 100.0
#: Indices of the searched entries of an action: velocity along x and y, rotation about z, softness
#: of y and of yaw.
SEARCHED = (0, 1, 5, 6, 7)
#: Action at which both searches start, and its standard deviation.
START, SPREAD = np.array([-0.8, 0.0, 0.0, -0.5, -0.5]), 0.3
#: Number of features of the policy, with the constant 1.
FEATURES = 4


def features(observation: dict[str, Array], first: dict[str, Array]) -> Array:
    """Return the features (N, FEATURES): 1, rotation about z from the start, force along x, y."""
    current, start = observation["tool"], first["tool"]
    (a, b, _, c, d, _), (e, f, _, g, h, _) = start[:, 3:].T, current[:, 3:].T
    angle = np.arctan2(a * f - b * e + c * h - d * g, a * e + b * f + c * g + d * h)
    force = np.clip(observation["force"][:, :2] / 20.0, -1.0, 1.0)
    return np.column_stack([np.ones(len(angle)), angle, force])


class Trial:
    """Vector environment in which each arm opens one door per call.

    Args:
        arms: Number of arms.
    """

    def __init__(self, arms: int) -> None:
        self._envs = gymnasium.make_vec(
            "pliant/Door-v0",
            num_envs=arms,
            vectorization_mode="vector_entry_point",
            autoreset_mode="Disabled",
            max_episode_steps=STEPS,
            threads=1,
        )

    def costs(self, gains: Array, seeds: list[int]) -> tuple[Array, Array, Array]:
        """Open one door with each arm.

        Args:
            gains: Parameters (N, 5, number of features): 1 for a constant action, or FEATURES.
            seeds: Seed of each door; equal seeds are equal doors.

        Returns:
            Costs (N,) [N], largest forces (N,) [N], and True for open doors (N,).
        """
        observation, _ = self._envs.reset(seed=seeds)  # type: ignore[arg-type]
        first = observation
        actions = np.zeros(self._envs.action_space.shape or ())
        peak, has_ended = np.zeros(len(seeds)), np.zeros(len(seeds), dtype=bool)
        while not has_ended.all():
            values = features(observation, first)[:, : gains.shape[2]]
            actions[:, SEARCHED] = (gains @ values[:, :, None])[:, :, 0]
            observation, _, terminated, truncated, info = self._envs.step(np.clip(actions, -1, 1))
            peak = np.where(has_ended, peak, np.maximum(peak, info["force"]))
            has_ended = terminated | truncated
        return peak + CLOSED * (1.0 - info["progress"]), peak, info["is_success"]


def search(kind: str, seed: int) -> list[dict[str, Any]]:
    """Optimize a constant action or a policy with CMA-ES; return its measurements in order.

    The last measurement is that of the best validated parameters on the test doors.

    Args:
        kind: "constant" or "policy".
        seed: Seed of the search and of its doors.
    """
    count = 1 if kind == "constant" else FEATURES
    mean = np.zeros((len(SEARCHED), count))
    mean[:, 0] = START
    optimizer = CMA(mean=mean.ravel(), sigma=SPREAD, population_size=CANDIDATES, seed=seed)
    trial, validation = Trial(CANDIDATES * DOORS), Trial(len(VALIDATION))
    measured: list[dict[str, Any]] = []
    start = time.process_time()
    for generation in range(GENERATIONS + 1):
        if generation % MEASURE_EVERY == 0:
            result = measure(validation, optimizer.mean.reshape(mean.shape), VALIDATION)
            result |= {"doors": "validation", "episodes": generation * CANDIDATES * DOORS}
            measured.append(result | {"cpu_seconds": time.process_time() - start})
            print(kind, seed, {k: v for k, v in result.items() if k != "parameters"}, flush=True)
        if generation < GENERATIONS:
            candidates = [optimizer.ask() for _ in range(CANDIDATES)]
            gains = np.repeat(np.array(candidates).reshape(-1, *mean.shape), DOORS, axis=0)
            doors = [1000 * (100 * seed + generation) + door for door in range(DOORS)]
            cost, _, _ = trial.costs(gains, doors * CANDIDATES)
            means = cost.reshape(CANDIDATES, DOORS).mean(axis=1)
            optimizer.tell(list(zip(candidates, means.tolist(), strict=True)))
    best = min(measured, key=lambda result: result["cost"])
    last = best | measure(Trial(len(TEST)), np.array(best["parameters"]), TEST) | {"doors": "test"}
    last["cpu_seconds"] = time.process_time() - start
    return [result | {"kind": kind, "seed": seed} for result in [*measured, last]]


def measure(trial: Trial, gains: Array, seeds: list[int]) -> dict[str, Any]:
    """Open doors with one set of parameters (5, number of features); return means over the doors.

    Args:
        trial: Environment with one arm per door.
        gains: The parameters.
        seeds: Seeds of the doors.
    """
    cost, force, is_open = trial.costs(np.tile(gains, (len(seeds), 1, 1)), seeds)
    return {
        "cost": float(cost.mean()),
        "force": float(force.mean()),
        "open": float(is_open.mean()),
        "parameters": gains.tolist(),
    }


def draw(measured: list[dict[str, Any]], path: Path) -> None:
    """Draw the cost on the validation doors against the number of episodes of each search."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6.0, 3.4), layout="constrained")
    for kind, color in (("constant", "0.45"), ("policy", "tab:blue")):
        runs: dict[int, list[tuple[float, float]]] = {}
        for row in measured:
            if row["kind"] == kind and row["doors"] == "validation":
                runs.setdefault(row["seed"], []).append((row["episodes"], row["cost"]))
        for i, run in enumerate(runs.values()):
            label = None if i else {"constant": "constant action", "policy": "policy"}[kind]
            axes.plot(*zip(*run, strict=True), color=color, marker=".", label=label)
    axes.set(xlabel="episodes of the search", ylabel="cost on unseen doors [N]")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def _search(job: tuple[str, int]) -> list[dict[str, Any]]:
    return search(*job)


def main() -> None:
    """Run both searches with three seeds, one process per core; print and draw the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("build/learned_softness"))
    parser.add_argument("--processes", type=int, default=multiprocessing.cpu_count())
    parser.add_argument("--draw", action="store_true", help="draw the last results only")
    arguments = parser.parse_args()
    results = arguments.output / "results.json"
    if not arguments.draw:
        jobs = [(kind, seed) for seed in SEEDS for kind in ("constant", "policy")]
        with multiprocessing.get_context("spawn").Pool(arguments.processes) as pool:
            measured = [row for run in pool.imap(_search, jobs) for row in run]
        results.parent.mkdir(parents=True, exist_ok=True)
        results.write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")
    measured = json.loads(results.read_text(encoding="utf-8"))
    print("| search | seed | largest force, mean of the test doors | cost | opened | CPU time |")
    print("|---|---|---|---|---|---|")
    for row in measured:
        if row["doors"] == "test":
            print(
                f"| {row['kind']} | {row['seed']} | {row['force']:.1f} N | {row['cost']:.1f} N | "
                f"{row['open']:.0%} | {row['cpu_seconds']:.0f} s |"
            )
    draw(measured, arguments.output / "learned_softness.png")


if __name__ == "__main__":
    main()
