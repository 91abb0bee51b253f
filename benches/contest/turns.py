"""Start the peers' processes, and time their tasks in rounds of random order."""

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

from contest import numpy_peer, problem
from contest.environments import BUILD, OURS, PATHS, ROOT, Entry, python_for

TASKS = ("kinematics", "step", "batch")
TOLERANCE = 1e-9
#: Libraries limited to one thread: a control loop uses one, and batches are compared per core.
ONE_THREAD = ("OMP", "OPENBLAS", "MKL", "NUMBA", "RAYON")
#: Seconds of one turn.
TURN = {"whole": 0.01, "single": 0.04}


@dataclass
class Racer:
    """A peer's process.

    Attributes:
        entry: Its row.
        version: Reported version.
        medians: By task, the median time of a call in each round [ns]; NaN for a round in which
            every block was disturbed.
        singles: By task, times of single calls over all rounds [ns].
    """

    entry: Entry
    process: subprocess.Popen[str]
    version: str = ""
    medians: dict[str, list[float]] = field(default_factory=dict)
    singles: dict[str, list[float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name in the table; pliant's with the instructions in use."""
        if self.entry not in OURS:
            return self.entry.name
        chosen = self.version.rpartition(", ")[2]
        return f"pliant ({chosen})" if chosen in PATHS else "pliant"

    @classmethod
    def start(cls, entry: Entry) -> tuple[Self | None, str]:
        """Start a peer and verify its results.

        Return the racer and an empty string, or None and the reason for which it cannot be timed.
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
            [python, "-m", "contest.worker", entry.maker],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
        racer = cls(entry, process)
        first = racer._answer()
        if "missing" in first:
            return None, first["missing"]
        wrong = disagreement(first["results"])
        if wrong:
            racer.stop()
            return None, f"DISAGREES with the reference: {wrong}"
        racer.version = first["version"]
        return racer, ""

    def ask(self, task: str, seconds: float) -> list[float]:
        """Time a task in the peer's process for about `seconds`; return times per call [ns]."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"task": task, "seconds": seconds}) + "\n")
        self.process.stdin.flush()
        return list(self._answer())

    def stop(self) -> None:
        """End the process."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(timeout=10)

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        return json.loads(line) if line else {"missing": "the process ended"}


def disagreement(results: dict[str, Any]) -> str:
    """Describe results that differ from the NumPy reference by more than 1e-9; "" if none does."""
    arm = problem.bench_arm()
    reference = numpy_peer.make()
    assert reference.kinematics is not None
    kinematics = reference.kinematics
    pairs = [(q, kinematics(ahead)[0]) for q, ahead in problem.states(arm)]
    expected = {
        "kinematics": [kinematics(q) for q, _ in pairs],
        "step": [reference.step_pair(q, t) for q, t in pairs],
        "batch": [kinematics(q) for q in problem.many(arm, problem.STATES)],
    }
    said = []
    for task, found in results.items():
        off = max(
            float(np.abs(np.asarray(got) - right).max())
            for pair, rights in zip(found, expected[task], strict=True)
            for got, right in zip(pair, rights, strict=True)
        )
        if not off <= TOLERANCE:
            said.append(f"{task} by {off:.2g}")
    return ", ".join(said)


def race(racers: list[Racer], rounds: int) -> None:
    """Run all turns, in a new random order in every round."""
    draw = random.Random(20260101)
    turns = [
        (racer, f"{task}/{kind}", kind)
        for racer in racers
        for task in ("empty", *TASKS)
        for kind in TURN
        if not (task == "batch" and kind == "single")
    ]
    for number in range(rounds):
        draw.shuffle(turns)
        for racer, task, kind in turns:
            times = racer.ask(task, TURN[kind])
            if kind == "single":
                racer.singles.setdefault(task, []).extend(times)
            else:
                median = statistics.median(times) if times else float("nan")
                racer.medians.setdefault(task, []).append(median)
        print(f"\r   round {number + 1} of {rounds}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
