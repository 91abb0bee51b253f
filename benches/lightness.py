"""What a user carries: time to import, start of the command line, memory, size of the wheel.

    python benches/lightness.py

Every start is a process of its own; medians of a few. Times are beyond what they stand on: the bare
interpreter for NumPy, NumPy for pliant.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STARTS = 15
#: Prints its resident memory [MB] while a controller of the built-in arm runs.
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


def starts(*arguments: str) -> list[float]:
    """Seconds from start to end of Python with these arguments."""
    out = []
    for _ in range(STARTS):
        start = time.perf_counter()
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
        out.append(time.perf_counter() - start)
    return out


def imports(code: str) -> float:
    """Median seconds that a statement takes in a fresh interpreter that has NumPy."""
    timed = f"import numpy, time; t = time.perf_counter(); {code}; print(time.perf_counter() - t)"
    done = [
        subprocess.run([sys.executable, "-c", timed], capture_output=True, text=True, check=True)
        for _ in range(STARTS)
    ]
    return statistics.median(float(one.stdout) for one in done)


def memory(before: str) -> float:
    """Largest resident memory [MB] of a process that does this."""
    code = RUNNING.format(before=before)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)


def main() -> None:
    """Print one line each."""
    bare = statistics.median(starts("-c", "pass"))
    with_numpy = statistics.median(starts("-c", "import numpy"))
    print(f"import numpy                  {1e3 * (with_numpy - bare):8.1f} ms beyond python")
    print(f"import pliant                 {1e3 * imports('import pliant'):8.2f} ms beyond numpy")
    for flags in ("--version", "--help", "bench --help"):
        took = statistics.median(starts("-m", "pliant.cli", *flags.split()))
        print(f"pliant {flags:22} {1e3 * took:8.0f} ms, of which python {1e3 * bare:.0f}")
    numpy_alone = memory("")
    print(f"memory of numpy               {numpy_alone:8.1f} MB")
    more = memory(CONTROLLER) - numpy_alone
    print(f"memory of a running controller{more:8.1f} MB more")
    for wheel in sorted((ROOT / "build").glob("**/wheels/*.whl")):
        print(f"{wheel.stat().st_size / 1e6:.2f} MB  {wheel.name}")


if __name__ == "__main__":
    main()
