"""Tail latency of a control step that is called from Python, and its time in special poses.

    python benches/tail.py       options: --steps (default 10⁷) and --turns (default 10⁶)

First, each law makes `--steps` steps through ordinary poses without a pause. Then both laws make
`--turns` steps, in all cases together: ordinary poses, near singular poses, joints at their limits,
saturated torque limits, a constant pose, and denormal numbers. The cases alternate in short blocks,
so that other programs affect them equally. Every call is timed, with the garbage collector on.
Rows of empty calls, and of waits as long as a step, show the influence of the system. A block is
"calm" if, according to the scheduler, no other program used the core meanwhile.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from comparison.pliant_peer import instructions
from comparison.worker import waited
from numpy.typing import NDArray

import pliant

Array = NDArray[np.float64]
URDF = Path(__file__).resolve().with_name("arm7_bench.urdf")
BLOCK, STATES = 64, 256
#: The table marks a case that takes more than this multiple of the time of ordinary poses [1].
MAX_RATIO = 1.2


@dataclass(frozen=True)
class Case:
    """Sequence of states for which the steps of a controller are timed.

    Attributes:
        name: Description in the table.
        states: Pairs of joint positions q (7,) [rad] and target pose (4, 4).
    """

    name: str
    states: list[tuple[Array, Array]]


def servos() -> pliant.Servos:
    """Return the servo parameters that the controllers assume for the seven-joint bench arm."""
    return pliant.Servos(
        kp=[150.0] * 4 + [60.0] * 3,
        max_torque=[10.7] * 4 + [6.4] * 3,
        friction=0.1,
        stiffness_known=True,
    )


def cases(model: pliant.Model) -> list[Case]:
    """Return all cases for an arm; the first one has ordinary poses."""
    phases = 2.0 * np.pi * np.arange(STATES)[:, None] / STATES + 0.9 * np.arange(model.n)
    middle, half = 0.5 * (model.lower + model.upper), 0.5 * (model.upper - model.lower)
    ordinary = middle + 0.4 * half * np.sin(phases)
    stretched = ordinary.copy()
    stretched[:, 3:6] = 1e-3 * np.sin(phases[:, 3:6])  # elbow and wrist straight
    limits = np.where(np.sin(phases) > 0.0, model.upper, model.lower) - 1e-9 * np.sin(phases)
    tiny = 1e-310 * np.sin(phases)
    far_target = np.eye(4)
    far_target[:3, 3] = 1.0

    def toward(q: Array, shift: Array) -> list[tuple[Array, Array]]:
        return [(a, model.forward_kinematics(b)) for a, b in zip(q, q + shift, strict=True)]

    offsets = 0.02 * np.cos(phases)
    return [
        Case("ordinary poses", toward(ordinary, offsets)),
        Case("near singular (elbow and wrist straight)", toward(stretched, offsets)),
        Case("joints at their limits", toward(limits, offsets)),
        Case("every limit saturated (target far away)", [(q, far_target) for q in ordinary]),
        Case("where it was started", toward(ordinary[:1].repeat(STATES, axis=0), offsets[:1])),
        Case("denormal positions", toward(tiny, np.zeros_like(offsets))),
        Case("at rest on the target (denormal deviations)", toward(ordinary, 1e-310 * offsets)),
    ]


def stepper(case: Case, settings: pliant.Settings) -> Callable[[], Array]:
    """Return a function that runs the next `BLOCK` steps of a case and returns their times [ns]."""
    model = pliant.Model.from_urdf(URDF)
    controller = pliant.Controller(model, settings, servos())
    parts = itertools.cycle(range(0, STATES, BLOCK))

    def block() -> Array:
        times, now, first = [], time.perf_counter_ns, next(parts)
        for q, target in case.states[first : first + BLOCK]:
            start = now()
            command = controller.step(q, target)
            _ = command.goal, command.torque_limit
            times.append(now() - start)
        return np.array(times, dtype=np.float64)

    return block


def nothing() -> Array:
    """Time `BLOCK` empty calls; return their times [ns]."""
    times, now = [], time.perf_counter_ns
    for _ in range(BLOCK):
        start = now()
        times.append(now() - start)
    return np.array(times, dtype=np.float64)


def waiter(length: float) -> Callable[[], Array]:
    """Return a function that times `BLOCK` calls and returns their times [ns].

    Each of these calls only waits for about `length` [ns].
    """

    def block(count: int) -> Array:
        times, now, consume = [], time.perf_counter_ns, deque[None](maxlen=0).extend
        for _ in range(BLOCK):
            start = now()
            consume(itertools.repeat(None, count))
            times.append(now() - start)
        return np.array(times, dtype=np.float64)

    short, long = (np.median([np.median(block(count)) for _ in range(100)]) for count in (1, 1001))
    count = 1 + round(1000 * max(length - short, 0.0) / max(long - short, 1.0))
    return lambda: block(count)


def laws() -> dict[str, pliant.Settings]:
    """Return the settings of the laws `paper` and `cap`, both with the soft axis y, by law."""
    paper = pliant.Settings.paper(axes={"y": pliant.Axis(soft=0.5, adaptation=0.9)})
    return {"paper": paper, "cap": pliant.Settings.soft("y")}


def run_blocks(block: Callable[[], Array], steps: int) -> tuple[Array, Array]:
    """Run a block repeatedly without a pause, until it has made `steps` calls.

    Returns:
        Times [ns] of all calls, and of the calls in calm blocks.
    """
    count = max(steps // BLOCK, 1)
    times, calm = np.empty((count, BLOCK), dtype=np.float32), np.empty(count, dtype=bool)
    for i in range(count):
        before = waited()
        times[i] = block()
        calm[i] = waited() == before
    return times.ravel(), times[calm].ravel()


def consecutive(model: pliant.Model, steps: int) -> None:
    """Time consecutive steps of each law, empty calls and waits; print their tail latency."""
    case = cases(model)[0]
    blocks = {"(nothing)": nothing} | {
        f"law {law}": stepper(case, settings) for law, settings in laws().items()
    }
    length = float(np.median([np.median(blocks["law paper"]()) for _ in range(1000)]))
    blocks = {"(nothing)": nothing, "(as long)": waiter(length), **blocks}
    print(f"{steps:,} calls without a pause [µs], minus the median of empty calls")
    print(f"  {'':12} {'median':>8} {'p99.9':>9} {'p99.99':>9} {'largest':>9}   calm:")
    empty = 0.0
    for name, block in blocks.items():
        all_times, calm = run_blocks(block, steps)
        empty = empty or float(np.median(all_times))
        cells = [
            1e-3 * (float(np.percentile(times, p)) - empty)
            for times in (all_times, calm if calm.size else all_times)
            for p in (50.0, 99.9, 99.99, 100.0)
        ]
        print(f"  {name:12} " + " ".join(f"{cell:9.3f}" for cell in cells))
    print()


def main() -> None:
    """Time consecutive steps, then all cases in alternating blocks; print the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=10_000_000, help="steps of each law in a row")
    parser.add_argument("--turns", type=int, default=1_000_000, help="steps of all cases and laws")
    arguments = parser.parse_args()
    gc.enable()
    model = pliant.Model.from_urdf(URDF)
    consecutive(model, arguments.steps)
    for law, settings in laws().items():
        rows: dict[str, Callable[[], Array]] = {"(nothing)": nothing}
        rows |= {case.name: stepper(case, settings) for case in cases(model)}
        times: dict[str, list[Array]] = {name: [] for name in rows}
        calm: dict[str, list[Array]] = {name: [] for name in rows}
        for _ in range(max(arguments.turns // (2 * (len(rows) - 1) * BLOCK), 1)):
            for name, block in rows.items():
                before = waited()
                times[name].append(block())
                if waited() == before:
                    calm[name].append(times[name][-1])
        simd = instructions(pliant.Controller(model, settings, servos()))
        print(f"law {law}, instructions {simd}, timer subtracted [µs]")
        print(f"  {'':44} {'median':>8} {'p99.9':>9} {'(calm)':>8} {'largest':>9} {'ratio':>6}")
        empty = float(np.median(np.concatenate(times["(nothing)"])))
        ordinary = [float(np.median(block)) - empty for block in times["ordinary poses"]]
        for name, blocks in times.items():
            all_times = np.concatenate(blocks) - empty
            medians = [float(np.median(block)) - empty for block in blocks]
            ratio = float(np.median(np.divide(medians, ordinary)))
            calm_times = np.concatenate(calm[name] or blocks) - empty
            cells = (
                np.median(all_times),
                *(np.percentile(x, 99.9) for x in (all_times, calm_times)),
            )
            mark = "" if ratio <= MAX_RATIO else f"   more than {MAX_RATIO:g} ×"
            print(
                f"  {name:44} {1e-3 * cells[0]:8.3f} {1e-3 * cells[1]:9.3f} {1e-3 * cells[2]:8.3f} "
                f"{1e-3 * all_times.max():9.1f} {ratio:6.2f}{mark}"
            )
        print()


if __name__ == "__main__":
    main()
