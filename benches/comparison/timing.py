"""Timing of the compared implementations: each runs in its own process, in rounds.

In each round, every task of every implementation is timed once, in random order.
"""

from __future__ import annotations

import json
import os
import random
import statistics
import subprocess
import sys
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from comparison import numpy_peer, problem
from comparison.environments import BUILD, PATHS, PLIANT_ENTRIES, ROOT, Entry, python_for

TASKS = ("kinematics", "step", "batch")
TOLERANCE = 1e-9
#: Prefixes of the environment variables ``..._NUM_THREADS``, which are set to 1: the comparison of
#: batches is per core.
ONE_THREAD = ("OMP", "OPENBLAS", "MKL", "NUMBA", "RAYON")
#: Time for which a task is timed in a round [s]: `whole` for calls timed in blocks, `single` for
#: calls timed one by one.
TASK_TIME = {"whole": 0.01, "single": 0.04}


@dataclass
class TimedProcess:
    """Process of one compared implementation, with its measured times.

    Attributes:
        entry: Description of the implementation.
        process: The process, which runs `comparison.worker`.
        version: Name and version that the implementation reports.
        medians: Median time of a call over the blocks of each round [ns], by task; NaN if the
            thread had to wait for the CPU in every block of the round.
        singles: Times of all calls that were timed singly [ns], by task.
    """

    entry: Entry
    process: subprocess.Popen[str]
    version: str = ""
    medians: dict[str, list[float]] = field(default_factory=dict)
    singles: dict[str, list[float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the implementation in the table; pliant's contains the instruction set in use."""
        if self.entry not in PLIANT_ENTRIES:
            return self.entry.name
        build = self.version.rpartition(", ")[2]
        return f"pliant ({build})" if build in PATHS else "pliant"

    @classmethod
    def start(cls, entry: Entry) -> tuple[Self | None, str]:
        """Start the process of an implementation, and compare its results with the reference.

        Returns:
            The process and an empty string; or None and the reason why it cannot be timed.
        """
        try:
            python = python_for(entry)
        except RuntimeError as error:
            return None, str(error)
        environment = {
            **os.environ,
            **{f"{name}_NUM_THREADS": "1" for name in ONE_THREAD},
            **entry.environment,
            "PYTHONPATH": os.pathsep.join(
                [str(ROOT / "benches"), *filter(None, [os.environ.get("PYTHONPATH")])]
            ),
            "PEERS_BUILD": str(BUILD),
        }
        process = subprocess.Popen(
            [python, "-m", "comparison.worker", entry.maker],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
        timed_process = cls(entry, process)
        first = timed_process._answer()
        if "missing" in first:
            return None, first["missing"]
        difference = disagreement(first["results"])
        if difference:
            timed_process.stop()
            return None, f"DISAGREES with the reference: {difference}"
        timed_process.version = first["version"]
        return timed_process, ""

    def ask(self, task: str, seconds: float) -> list[float]:
        """Time a task in the process for about `seconds`; return times per call [ns]."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"task": task, "seconds": seconds}) + "\n")
        self.process.stdin.flush()
        return list(self._answer())

    def stop(self) -> None:
        """Close the input of the process, which ends it, and wait for its end."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(timeout=10)

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        return json.loads(line) if line else {"missing": "the process ended"}


def disagreement(results: dict[str, Any]) -> str:
    """Compare results with those of the NumPy reference.

    Args:
        results: Results of each task, from `comparison.worker`.

    Returns:
        Text with the tasks whose results differ by more than `TOLERANCE`, and the differences; ""
        if there are none.
    """
    arm = problem.bench_arm()
    reference = numpy_peer.make()
    assert reference.kinematics is not None
    kinematics = reference.kinematics
    pairs = [(q, kinematics(target_q)[0]) for q, target_q in problem.states(arm)]
    expected = {
        "kinematics": [kinematics(q) for q, _ in pairs],
        "step": [reference.step_pair(q, t) for q, t in pairs],
        "batch": [kinematics(q) for q in problem.many(arm, problem.STATES)],
    }
    differences = []
    for task, result in results.items():
        error = max(
            float(np.abs(np.asarray(value) - right).max())
            for pair, rights in zip(result, expected[task], strict=True)
            for value, right in zip(pair, rights, strict=True)
        )
        if not error <= TOLERANCE:
            differences.append(f"{task} by {error:.2g}")
    return ", ".join(differences)


def run_rounds(processes: list[TimedProcess], rounds: int) -> None:
    """Time all tasks of all implementations in every round, in a new random order each time.

    The times are stored in the processes' `medians` and `singles`.
    """
    draw = random.Random(20260101)
    schedule = [
        (process, f"{task}/{kind}", kind)
        for process in processes
        for task in ("empty", *TASKS)
        for kind in TASK_TIME
        if not (task == "batch" and kind == "single")
    ]
    for number in range(rounds):
        draw.shuffle(schedule)
        for process, task, kind in schedule:
            times = process.ask(task, TASK_TIME[kind])
            if kind == "single":
                process.singles.setdefault(task, []).extend(times)
            else:
                median = statistics.median(times) if times else float("nan")
                process.medians.setdefault(task, []).append(median)
        print(f"\r   round {number + 1} of {rounds}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
