"""Instructions per call of the hot path, counted by callgrind and held against the stored ones.

    cargo bench --bench paths --no-run      # prints the program
    python benches/counts.py PROGRAM [--store]

Counts repeat exactly on a noisy machine. They are keyed by the compiler's version and taken on the
forced baseline and AVX2 sets, which valgrind knows. More than 5 % above the stored count fails;
a compiler without stored counts, or a machine without valgrind, is skipped loudly.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

STORE = Path(__file__).with_name("counts.json")
STAGES = ("kinematics", "paper", "cap", "impedance")
SETS = ("baseline", "avx2")
CALLS = (2000, 4000)  # their difference leaves the set-up out
MOST = 1.05


def instructions(program: str, chosen: str, stage: str, calls: int) -> int:
    """All instructions of one run."""
    command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null"]
    run = subprocess.run(
        [*command, program, "count", stage, str(calls)],
        env={**os.environ, "PLIANT_INSTRUCTIONS": chosen},
        capture_output=True,
        text=True,
        check=True,
    )
    found = re.search(r"Collected : (\d+)", run.stderr)
    if found is None:
        sys.exit(f"callgrind said nothing of its count:\n{run.stderr}")
    return int(found.group(1))


def count(program: str) -> dict[str, float]:
    """Instructions per call of each stage on each set."""
    out = {}
    for chosen in SETS:
        for stage in STAGES:
            few, many = (instructions(program, chosen, stage, calls) for calls in CALLS)
            out[f"{stage} {chosen}"] = round((many - few) / (CALLS[1] - CALLS[0]), 1)
    return out


def main() -> None:
    """Count, print, and store or compare."""
    if shutil.which("valgrind") is None:
        print("!! SKIPPED: valgrind is not installed; nothing was counted")
        return
    version = subprocess.run(["rustc", "-V"], capture_output=True, text=True, check=True)
    compiler = version.stdout.strip()
    stored = json.loads(STORE.read_text(encoding="utf-8")) if STORE.exists() else {}
    counted = count(sys.argv[1])
    before = stored.get(compiler, {})
    for name, value in counted.items():
        print(f"{name:24} {value:10.0f}   stored {before.get(name, float('nan')):10.0f}")
    if "--store" in sys.argv[2:]:
        stored[compiler] = counted
        STORE.write_text(json.dumps(stored, indent=2) + "\n", encoding="utf-8")
    elif not before:
        print(f"!! SKIPPED: no counts stored for {compiler}; store them with --store")
    elif any(value > MOST * before.get(name, value) for name, value in counted.items()):
        sys.exit("the hot path takes over 5 % more instructions than stored")


if __name__ == "__main__":
    main()
