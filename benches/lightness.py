"""Measure pliant's import time, start time of the command line, memory, and size of the wheel.

    python benches/lightness.py

Each import or start is timed in a new process. The table has medians of processor time, which
hardly depends on the machine's load, and of wall time. The import time of NumPy excludes the start
of Python, and the import time of pliant excludes that of NumPy.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STARTS = 15
#: Python program that runs the code `before` and prints its largest resident memory [MB].
RUNNING = """
import numpy as np
{before}
import resource
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
CONTROLLER = """
import pliant
arm = pliant.robots.arm7()
controller = pliant.Controller(arm, pliant.Settings.soft("y"))
q = np.full(arm.n, -0.3)
target = arm.forward_kinematics(q)
for i in range(20_000):
    controller.step(q + 1e-6 * i, target)
"""


def now() -> tuple[float, float]:
    """Return the total processor time of ended child processes, and the wall clock [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime, time.perf_counter()


def medians(times: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the medians over pairs of processor time and wall time [s]."""
    return statistics.median(t[0] for t in times), statistics.median(t[1] for t in times)


def starts(*arguments: str) -> tuple[float, float]:
    """Run Python `STARTS` times with these arguments; return median processor and wall time [s]."""
    out = []
    for _ in range(STARTS):
        start = now()
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
        end = now()
        out.append((end[0] - start[0], end[1] - start[1]))
    return medians(out)


def imports(code: str) -> tuple[float, float]:
    """Return median processor and wall time [s] of a statement that runs after NumPy's import."""
    command = (
        "import numpy, time; p, t = time.process_time(), time.perf_counter(); "
        f"{code}; print(time.process_time() - p, time.perf_counter() - t)"
    )
    results = [
        subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
        for _ in range(STARTS)
    ]
    fields = [result.stdout.split() for result in results]
    return medians([(float(cpu), float(clock)) for cpu, clock in fields])


def memory(before: str) -> float:
    """Return the largest resident memory [MB] of a Python process that runs the code `before`."""
    code = RUNNING.format(before=before)
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return float(result.stdout)


def line(name: str, times: tuple[float, float]) -> None:
    """Print a row of the table: name, and processor and wall time `times` in milliseconds."""
    print(f"{name:30}{1e3 * times[0]:6.1f} ms {1e3 * times[1]:6.1f} ms")


def main() -> None:
    """Measure and print start times, memory and wheel size."""
    print(f"{'':30}processor    clock")
    interpreter = starts("-c", "pass")
    line("python", interpreter)
    numpy = starts("-c", "import numpy")
    line("import numpy, beyond python", (numpy[0] - interpreter[0], numpy[1] - interpreter[1]))
    line("import pliant, beyond numpy", imports("import pliant"))
    for flags in ("--version", "--help", "run --help"):
        line(f"pliant {flags}", starts("-m", "pliant.cli", *flags.split()))
    numpy_alone = memory("")
    print(f"memory of numpy               {numpy_alone:8.1f} MB")
    growth = memory(CONTROLLER) - numpy_alone
    print(f"memory of a running controller{growth:8.1f} MB more")
    for wheel in sorted((ROOT / "build").glob("**/wheels/*.whl")):
        print(f"{wheel.stat().st_size / 1e6:.2f} MB  {wheel.name}")


if __name__ == "__main__":
    main()
