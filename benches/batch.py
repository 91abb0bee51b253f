"""Rate and memory use of batch calls (many configurations in one call), on one and on all cores.

    python benches/batch.py [--count 100000] [--instructions baseline] [--only kinematics,paper]

The calls of pliant are timed in two processes in turn: one with a single thread, and one with one
thread per core. Results go into preallocated arrays. The rate of one core is measured in CPU time,
so other programs hardly affect it. The rate of all cores needs an idle machine, or `nice -n -15`.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import pliant

URDF = Path(__file__).resolve().with_name("arm7_bench.urdf")
ROUNDS = 7


def settings() -> dict[str, pliant.Settings]:
    """Return settings by law: `paper` with the parameters of `comparison.problem`, and `cap`."""
    endless = {"max_velocity": np.inf, "soft_step_limit": np.inf}
    axes = {name: pliant.Axis(**endless) for name in ("x", "z", "roll", "pitch", "yaw")}
    axes["y"] = pliant.Axis(yields="both", adaptation=0.9, **endless)
    paper = pliant.Settings.paper(
        axes=axes,
        tracking=pliant.Tracking(damping=0.02),
        null_space=pliant.NullSpace(projector="paper", limit_avoidance=0.1),
    )
    return {"paper": paper, "cap": pliant.Settings.soft("y")}


def calls(count: int, only: list[str]) -> dict[str, Callable[[], object]]:
    """Return the timed calls by name, each for `count` configurations.

    Only calls whose names contain one of the texts `only` are returned.
    """
    kp, torque = [150.0] * 4 + [60.0] * 3, [10.7] * 4 + [6.4] * 3
    servos = pliant.Servos(kp=kp, max_torque=torque, friction=0.1, stiffness_known=True)
    model = pliant.Model.from_urdf(URDF, servos=servos)
    rng = np.random.default_rng(1)
    q = model.lower + (model.upper - model.lower) * rng.uniform(0.2, 0.8, (count, model.n))
    targets = model.forward_kinematics_batch(q + 0.02)
    poses, jacobians = np.ones((count, 4, 4)), np.ones((count, 6, model.n))
    torques = np.ones((count, model.n))
    out = (torques, np.ones_like(torques), np.ones_like(torques))
    functions: dict[str, Callable[[], object]] = {
        "kinematics_batch": lambda: model.kinematics_batch(q, out=(poses, jacobians)),
        "gravity_batch": lambda: model.gravity_batch(q, out=torques),
    }
    for law, law_settings in settings().items():
        controller = pliant.Controller(model, law_settings)
        name = f"step_batch, law {law}"
        functions[name] = lambda c=controller: c.step_batch(q, targets, out=out)
        # Allocate the large controller state of a batch only if a requested call uses it.
        state = controller.batch_state(count if is_selected(name + ", with a state", only) else 1)
        functions[name + ", with a state"] = lambda c=controller, s=state: c.step_batch(
            q, targets, state=s, out=out
        )
    return {name: call for name, call in functions.items() if is_selected(name, only)}


def is_selected(name: str, only: list[str]) -> bool:
    """Return True if a name contains one of the texts `only`."""
    return any(part in name for part in only)


def serve(count: int, only: list[str]) -> None:
    """Read names of calls from standard input, one per line, and run each call.

    For each, print a JSON list: wall time [s], CPU time [s] and growth of the largest resident
    memory [MB].
    """
    functions = calls(count, only)
    for name in sys.stdin:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        start, cpu_start = time.perf_counter(), time.process_time()
        functions[name.strip()]()
        times = time.perf_counter() - start, time.process_time() - cpu_start
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        print(json.dumps((*times, memory / 1024)), flush=True)


def start_server(count: int, only: list[str], threads: int) -> subprocess.Popen[str]:
    """Start and return a process that runs `serve` with this number of threads."""
    command = [sys.executable, __file__, "--count", str(count), "--only", ",".join(only), "--serve"]
    environment = os.environ | {"RAYON_NUM_THREADS": str(threads)}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment)


def ask(server: subprocess.Popen[str], name: str) -> tuple[float, float, float]:
    """Run a call in a process of `start_server`; return its times and memory.

    Returns:
        Wall time [s], CPU time [s] and growth of the largest resident memory [MB].
    """
    assert server.stdin is not None
    assert server.stdout is not None
    print(name, file=server.stdin, flush=True)
    wall, cpu, memory = json.loads(server.stdout.readline())
    return wall, cpu, memory


def main() -> None:
    """Time one thread and all threads alternately; print one row per call."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--instructions", help="baseline, avx2 or avx512; default: the widest")
    parser.add_argument("--only", default="", help="parts of names, comma-separated")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.instructions:
        os.environ["PLIANT_INSTRUCTIONS"] = arguments.instructions
    count, cores = arguments.count, len(os.sched_getaffinity(0))
    only = arguments.only.split(",")
    if arguments.serve:
        serve(count, only)
        return
    controller = pliant.Controller(pliant.robots.arm7()).simd_level
    print(f"N = {count:,}, instructions {arguments.instructions or controller}")
    print(f"{'':38} {'M/s a core':>10} {f'{cores} threads':>10} {'ratio':>6} {'MB more':>8}")
    single_thread, all_cores = start_server(count, only, 1), start_server(count, only, cores)
    for name in calls(1, only):
        memory = ask(single_thread, name)[2]
        rounds = [(ask(single_thread, name), ask(all_cores, name)) for _ in range(ROUNDS)]
        rate = count / statistics.median(single[1] for single, _ in rounds)
        together = count / statistics.median(all_threads[0] for _, all_threads in rounds)
        ratio = statistics.median(single[0] / all_threads[0] for single, all_threads in rounds)
        print(f"{name:38} {rate / 1e6:10.2f} {together / 1e6:10.2f} {ratio:6.2f} {memory:8.1f}")
    for server in (single_thread, all_cores):
        server.communicate()


if __name__ == "__main__":
    main()
