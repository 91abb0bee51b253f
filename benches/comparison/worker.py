"""Program of a process that runs one compared implementation and times it on request.

First it sends the implementation's results, for comparison with the reference. Requests and replies
are JSON lines on the standard streams. Calls are timed in short blocks. A block is discarded if the
thread had to wait for the CPU meanwhile, according to the scheduler's counter. A batch takes too
long to run without such waits, so its CPU time is measured.
"""

from __future__ import annotations

import gc
import importlib
import itertools
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from comparison import numpy_peer, problem
from comparison.peer import Implementation

#: True if the process is tied to one core; False for a library that computes in its own threads.
PINNED = os.environ.get("PEERS_PIN") != "0"
#: Approximate duration of a timed block of calls [ns], shorter than a time slice of the scheduler;
#: and largest number of calls in a block.
BLOCK_TIME, BLOCK_CALLS = 300_000, 4 * problem.STATES
#: Source code of a timed block: `WHOLE` times all its calls together, `SINGLE` times each call.
WHOLE = """
def block():
    pairs = next(chunks)
    start = now()
    for q, t in pairs:
        {call}
    return [(now() - start) / len(pairs)]
"""
SINGLE = """
def block():
    times = []
    for q, t in next(chunks):
        start = now()
        {call}
        times.append(now() - start)
    return times
"""


def chunks(pairs: list[Any], count: int) -> Iterator[list[Any]]:
    """Return an endless iterator of lists, each with the next `count` of the states `pairs`."""
    states = itertools.cycle(pairs)
    prepared = [list(itertools.islice(states, count)) for _ in pairs]
    return itertools.cycle(prepared)


def blocks_of(peer: Implementation, pairs: list[Any]) -> dict[str, Callable[[], list[float]]]:
    """Return by task a function that runs one timed block and returns times per call [ns].

    `pairs` are the states: joint positions and target poses.
    """
    calls = {"empty": ("pass", None)}
    if peer.kinematics:
        calls["kinematics"] = (peer.kinematics_call, peer.kinematics)
    if peer.step:
        calls["step"] = (peer.step_call, peer.step)
    blocks = {}
    for task, (call, function) in calls.items():
        for kind, template in (("whole", WHOLE), ("single", SINGLE)):
            names = {"now": time.perf_counter_ns, "f": function, **peer.names}
            exec(template.format(call=call), names)
            names["chunks"] = chunks(pairs, len(pairs))
            call_time = min(names["block"]() + names["block"]())
            count = min(max(int(BLOCK_TIME / (call_time + 1.0)), 4), BLOCK_CALLS)
            names["chunks"] = chunks(pairs, count)
            blocks[f"{task}/{kind}"] = names["block"]
    if peer.batch:
        batch_states = problem.many(problem.bench_arm(), peer.batch_size)
        batch = peer.batch

        def timed() -> list[float]:
            start = time.process_time_ns()
            batch(batch_states)
            return [(time.process_time_ns() - start) / len(batch_states)]

        blocks["batch/whole"] = timed
    return blocks


def waited() -> int:
    """Return the total time [ns] for which this thread was ready to run but had no CPU.

    The value is 0 if the system does not report it.
    """
    try:
        with open("/proc/thread-self/schedstat", encoding="ascii") as file:
            return int(file.read().split()[1])
    except OSError:
        return 0


def results(peer: Implementation, pairs: list[Any]) -> dict[str, Any]:
    """Return the results of an implementation as lists, by task, for comparison with a reference.

    `pairs` are the states: joint positions and target poses.
    """
    values: dict[str, Any] = {}
    if peer.kinematics:
        values["kinematics"] = [
            [np.asarray(x).tolist() for x in peer.kinematics(q)] for q, _ in pairs
        ]
    if peer.step:
        values["step"] = [[np.asarray(x).tolist() for x in peer.step_pair(q, t)] for q, t in pairs]
    if peer.batch:
        batch_states = problem.many(problem.bench_arm(), problem.STATES)
        poses, jacobians = peer.batch(batch_states)
        values["batch"] = [
            [pose.tolist(), jacobian.tolist()]
            for pose, jacobian in zip(np.asarray(poses), np.asarray(jacobians), strict=True)
        ]
    return values


def run(blocks: dict[str, Callable[[], list[float]]], task: str, seconds: float) -> list[float]:
    """Run blocks of a task for about `seconds`; return times per call [ns].

    Blocks in which the thread had to wait for the CPU are discarded, except those of batches and of
    a process that is not tied to one core.
    """
    block, times = blocks.get(task), []
    if block is None:
        return times
    block()
    end = time.perf_counter() + seconds
    while True:
        before = waited()
        found = block()
        if waited() == before or not PINNED or task.startswith("batch"):
            times += found
        if time.perf_counter() >= end:
            return times


def main() -> None:
    """Send the implementation's results, then process timing requests until the input ends.

    The command-line argument names the function that returns the implementation, as
    `module:function`.
    """
    if PINNED and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    module, function = sys.argv[1].split(":")
    try:
        peer = getattr(importlib.import_module(f"comparison.{module}"), function)()
    except Exception as error:  # report any reason why an implementation is unavailable
        print(json.dumps({"missing": f"{type(error).__name__}: {error}"}), file=answers, flush=True)
        return
    arm = problem.bench_arm()
    kinematics = numpy_peer.kinematics_of(arm)
    pairs = [(q, kinematics(target_q)[0]) for q, target_q in problem.states(arm)]
    answer = {"version": peer.version, "results": results(peer, pairs)}
    print(json.dumps(answer), file=answers, flush=True)
    blocks = blocks_of(peer, pairs)
    gc.collect()
    for line in sys.stdin:
        request = json.loads(line)
        times = run(blocks, request["task"], request["seconds"])
        print(json.dumps(times), file=answers, flush=True)


if __name__ == "__main__":
    main()
