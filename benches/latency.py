"""Time of a control step on this machine, and the loop rate that it allows.

    make bench                                          the built-in arm
    make bench ARGS='--robot so101 --soft "x y"'        a built-in arm or a configuration file
    make bench ARGS='--urdf my_arm.urdf --law paper'    any URDF, with estimated servos

The median time of calls that do nothing is subtracted.
"""

from __future__ import annotations

import gc
import platform
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import pliant
from pliant import config
from pliant.cli import program
from pliant.cli._flags import Axes, File, Frame
from pliant.config._soft import check_axes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Names of task axes, separated by spaces; None if the flag is not given.
OtherAxes = Annotated[str | None, tyro.conf.arg(metavar="AXES")]
#: Path or name of an arm's configuration; None if the flag is not given.
OtherArm = Annotated[str | None, tyro.conf.arg(metavar="ARM")]

Law = Literal["cap", "impedance", "paper"]

#: Number of different states (joint positions and target), which consecutive calls use in turn.
STATES = 256
#: Share of the control period that is available to the step; the servo bus needs the rest.
SHARE = 0.1
#: A warning is printed if the thread waits for a core for a larger share of the time than this [1].
BUSY = 0.002
#: Edges of the histogram's bins, as multiples of the median duration.
EDGES = (0.0, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0, 5.0, 20.0, np.inf)
BAR = 40


@dataclass(frozen=True)
class Latency:
    """Durations of single calls.

    Attributes:
        times: Duration of each call (N,) [s], in order of the calls.
    """

    times: Array

    def at(self, percent: float) -> float:
        """Return the duration at a percentile [s]."""
        return float(np.percentile(self.times, percent))

    def less(self, seconds: float) -> Latency:
        """Return the durations minus an overhead of `seconds` [s]; none of them is negative."""
        return Latency(np.maximum(self.times - seconds, 0.0))


def run(
    *,
    urdf: File = None,
    tip: Frame = None,
    robot: OtherArm = None,
    law: Law | None = None,
    axes: Axes = "",
    soft: OtherAxes = None,
    calls: int = 1_000_000,
) -> None:
    """Time single steps on this machine, with the garbage collector on, and subtract empty calls.

    Args:
        urdf: URDF of an arm, in place of a configured one; its servos are then guessed.
        tip: Frame of the tool in the URDF; may be left out where the choice is clear.
        robot: Name of a ready arm (arm7, so101, koch, vx300s, ...) or a configuration file; default
            arm7.
        law: cap, impedance or paper; default: the law of the arm's configuration.
        axes: Axes of the task, e.g. "xyz"; default: those of the arm's configuration; with --urdf,
            as many as the arm has joints.
        soft: Axes that yield; "" for none. Default: y, or the first axis of a task without it.
        calls: Number of timed steps.
    """
    if calls < 100:
        raise pliant.ConfigError(f"--calls must be at least 100, got {calls}")
    if urdf is not None and robot is not None:
        raise pliant.ConfigError(f"--urdf {urdf} and --robot {robot} are two arms: give one")
    if urdf is None and tip is not None:
        raise pliant.ConfigError(f"--tip {tip} belongs to --urdf, which was not given")
    if urdf is not None:
        model = pliant.Model.from_urdf(urdf, tip=tip)
        settings = pliant.Settings(task=pliant.Task(axes=_axes(model)))
    else:
        arm_config = config.load(robot or "arm7")
        model, settings = arm_config.model(), arm_config.settings()
    servos = _guessed(model) if model.servos is None else model.servos
    controller = pliant.Controller(model, _wanted(settings, axes, law, soft), servos)
    states = path(model)
    targets = [model.forward_kinematics(q) for q in (*states[2:], *states[:2])]

    def step(i: int) -> object:
        command = controller.step(states[i], targets[i])
        return command.goal, command.torque_limit

    empty = measure(lambda i: states[i], calls)
    before, start = _waited(), time.perf_counter()
    latency = measure(step, calls).less(empty.at(50.0))
    share = (_waited() - before) / (time.perf_counter() - start)
    console = Console(soft_wrap=True, highlight=False)
    console.print(
        f"{model.name}: {model.n} joints, law {controller.settings.law}, instructions "
        f"{controller.simd_level}; "
        f"{_processor()}, CPython {platform.python_version()}"
    )
    console.print(_percentiles(latency, empty.less(empty.at(50.0))))
    console.print(_histogram(latency))
    rates = [_round(SHARE / max(latency.at(p), 1e-9)) for p in (50.0, 99.9)]
    console.print(
        f"Within {SHARE:.0%} of a period, half of the steps end at {rates[0]:,.0f} Hz, 99.9 % of "
        f"them at {rates[1]:,.0f} Hz."
    )
    if share > BUSY:
        console.print(
            f"[yellow]note[/] other programs had this core for {share:.0%} of the time: all beyond "
            "the median is theirs too"
        )


def path(model: pliant.Model) -> list[Array]:
    """Return joint positions (n,) [rad] along a closed path in the middle of the joint ranges.

    The range of a joint without limits counts as ±π.
    """
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    high = np.where(np.isfinite(model.upper), model.upper, np.pi)
    phases = 2.0 * np.pi * np.arange(STATES) / STATES
    wave = np.sin(phases[:, None] + 0.9 * np.arange(model.n))
    return list(0.5 * (low + high) + 0.2 * (high - low) * wave)


def measure(call: Callable[[int], object], calls: int) -> Latency:
    """Time `calls` calls one by one, with garbage collection on.

    The argument of a call is the index of a state, which changes with every call.
    """
    times = np.empty(calls)
    now = time.perf_counter_ns
    for i in range(STATES):
        call(i)
    was_enabled = gc.isenabled()
    gc.enable()
    try:
        for i in range(calls):
            start = now()
            call(i % STATES)
            times[i] = now() - start
    finally:
        if not was_enabled:
            gc.disable()
    return Latency(1e-9 * times)


def _guessed(model: pliant.Model) -> pliant.Servos:
    """Return servo parameters that are estimated from the effort limits of a model's joints.

    Stiffness and friction have the same ratio to the effort as in the simulator. An unknown effort
    counts as 1 N·m.
    """
    effort = np.nan_to_num(model.effort_limit, nan=1.0, posinf=1.0)
    return pliant.Servos(kp=effort / 0.07, max_torque=effort, friction=0.02 * effort)


def _axes(model: pliant.Model) -> str:
    """Return the names of as many task axes as the model has joints, translations first."""
    return " ".join(("x", "y", "z", "roll", "pitch", "yaw")[: model.n])


def _wanted(
    settings: pliant.Settings, axes: str, law: Law | None, soft: str | None
) -> pliant.Settings:
    task = pliant.Task(axes=axes) if axes else settings.task
    if soft is None:
        soft = "y" if "y" in task.names else task.names[0]
    elif soft:
        check_axes(soft, task, "--soft", 'another task: --axes "x y z yaw"')
    if law == "paper":
        settings = pliant.Settings.paper(task=task)
    else:
        settings = settings.replace(task=task, law=law or settings.law)
    return settings.replace(axes={soft: pliant.Axis(yields="both")}) if soft else settings


def _waited() -> float:
    """Return the total time [s] for which this thread was ready to run but had no core.

    The value is 0 if the system does not report it.
    """
    try:
        return 1e-9 * int(Path("/proc/thread-self/schedstat").read_text("ascii").split()[1])
    except OSError:
        return 0.0


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _percentiles(found: Latency, empty: Latency) -> Table:
    table = Table(box=None, pad_edge=False)
    for name in ("", "median", "p99", "p99.9", "largest"):
        table.add_column(name, justify="right" if name else "left")
    for name, latency in (("step, timer subtracted", found), ("calls that do nothing", empty)):
        cells = [f"{1e6 * latency.at(p):.2f} µs" for p in (50.0, 99.0, 99.9, 100.0)]
        table.add_row(name, *cells)
    return table


def _histogram(latency: Latency) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("of the median", justify="right")
    table.add_column("calls", justify="right")
    table.add_column("", justify="left")
    ratios = latency.times / max(latency.at(50.0), 1e-9)
    counts = np.histogram(ratios, EDGES)[0]
    for low, high, count in zip(EDGES, EDGES[1:], counts, strict=False):
        name = f"{low:g} to {high:g}" if np.isfinite(high) else f"above {low:g}"
        bar = "█" * round(BAR * count / counts.max()) or ("▏" if count else "")
        table.add_row(name, f"{count:,}", bar)
    return table


def _round(rate: float) -> float:
    """Return a rate [Hz], rounded down to two significant digits."""
    scale = 10.0 ** (np.floor(np.log10(rate)) - 1.0)
    return float(np.floor(rate / scale) * scale)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program.

    Args:
        arguments: Command-line arguments without the program's name; default: of this process.

    Returns:
        Exit code, as `pliant.cli.main`.
    """
    summary = "time a step on this machine: latency, loop rate"
    return program(run, "benches/latency.py", summary, arguments)


if __name__ == "__main__":
    sys.exit(main())
