"""Counts of CPU instructions in every stage of a control step, compared with stored counts.

    make counts-check       part of `make test`: fails if a stage needs 5 % more than stored
    make counts             stores the counts for this compiler

Callgrind counts the instructions of one function, so the counts do not depend on the load of the
machine. They depend on the compiler; without valgrind or stored counts for this compiler, the check
is skipped with a warning. The baseline and AVX2 code paths are counted; callgrind does not support
AVX-512.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
STORED = ROOT / "benches" / "counts.json"
#: Largest accepted growth of a count, as a share of the stored count.
GROWTH = 0.05
PATHS = ("baseline", "avx2")
#: Number of instructions of one call, by code path (instruction set), then by stage of the step.
Counts = dict[str, dict[str, float]]


class Skip(Exception):
    """Counting is not possible; the message gives the reason."""


def main() -> int:
    """Count instructions, and compare them with the stored counts or, with --update, store them.

    Returns:
        Exit code: 1 if a count has grown too much.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--update", action="store_true", help="store the counts")
    parser.add_argument("--binary", type=Path, help="a built bench to use")
    arguments = parser.parse_args()
    stored = json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else {}
    try:
        key = compiler()
        if not arguments.update and key not in stored:
            raise Skip(f"no counts stored for {key}; there are some for: {', '.join(stored)}")
        if shutil.which("valgrind") is None:
            raise Skip("valgrind is not installed (Debian: apt-get install valgrind)")
        counts = count_all(arguments.binary or build())
    except Skip as why:
        print(f"\n!! SKIPPED: instruction counts: {why}")
        return 0
    if arguments.update:
        stored[key] = counts
        STORED.write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        print(table(counts, {}))
        return 0
    print(table(counts, stored[key]))
    grown = list(regressions(counts, stored[key]))
    for line in grown:
        print(f"error: {line}; if that is wanted, `make counts` stores it")
    return 1 if grown else 0


def compiler() -> str:
    """Return version and target of the Rust compiler, which is the key of the stored counts."""
    try:
        output = subprocess.run(["rustc", "-vV"], capture_output=True, text=True, check=True).stdout
    except OSError as error:
        raise Skip(f"rustc cannot be started: {error}") from error
    host = re.search(r"^host: (.*)$", output, re.MULTILINE)
    return f"{output.splitlines()[0]} {host.group(1) if host else ''}".strip()


def build() -> Path:
    """Build the Rust program `counts` in release mode, like the wheel; return its path.

    `pliant-py` is named for its features only: with those of the benches alone, cargo would build
    nalgebra, pliant-core and others a second time.
    """
    command = ["cargo", "build", "--release", "-p", "pliant-benches", "-p", "pliant-py"]
    command += ["--bin", "counts"]
    command += ["--message-format=json", "--quiet", *(["--locked"] if os.environ.get("CI") else [])]
    result = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    for line in result.stdout.splitlines():
        message = json.loads(line)
        if message.get("executable") and message.get("target", {}).get("name") == "counts":
            return Path(message["executable"])
    raise Skip("cargo did not say where the bench is")


def count_all(binary: Path) -> Counts:
    """Return the counts of all stages on all code paths.

    A code path with the same counts as `baseline` is omitted: the processor or the build lacks it.
    Differences below half a percent, due to the alignment of memory, count as equal.
    """
    output = subprocess.run([binary, "--stages"], capture_output=True, text=True, check=True).stdout
    stages = [line.rsplit(" ", 1) for line in output.splitlines()]
    # Count the code paths at the same time: counts do not depend on other processes.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        totals = list(pool.map(lambda path: count(binary, path), PATHS))
    counts: Counts = {}
    for path, of_stages in zip(PATHS, totals, strict=True):
        if len(of_stages) != len(stages):
            raise Skip(f"valgrind counted {len(of_stages)} stages of {len(stages)}")
        found = {
            name: total / int(states)
            for (name, states), total in zip(stages, of_stages, strict=True)
        }
        is_equal = (
            all(abs(found[s] / other[s] - 1.0) < 5e-3 for s in found) for other in counts.values()
        )
        if not any(is_equal):
            counts[path] = found
    return counts


def count(binary: Path, path: str) -> list[int]:
    """Run all stages under valgrind; return the number of instructions of each, in their order.

    Only instructions inside the bench's function `counted` count. It runs once for each stage, and
    callgrind writes a file after each run: starting a process for each stage would take 17 times as
    long.

    Args:
        binary: Path of the bench.
        path: Code path (instruction set).
    """
    with TemporaryDirectory() as folder:
        command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={folder}/counts"]
        command += ["--toggle-collect=counts::counted", "--dump-after=counts::counted", str(binary)]
        environment = {**os.environ, "PLIANT_INSTRUCTIONS": path}
        result = subprocess.run(
            command, capture_output=True, text=True, check=False, env=environment
        )
        files = sorted(Path(folder).glob("counts.*"), key=lambda file: int(file.suffix[1:]))
        matches = [re.search(r"^summary: (\d+)$", f.read_text(), re.MULTILINE) for f in files]
    totals = [int(match.group(1)) if match else 0 for match in matches]
    if result.returncode or not totals or 0 in totals:
        raise Skip(f"valgrind counted nothing on path {path}: {result.stderr[-400:]}")
    return totals


def regressions(counts: Counts, stored: Counts) -> list[str]:
    """Return a sentence for every stage whose count exceeds the stored one by over `GROWTH`."""
    messages = []
    for path, stages in counts.items():
        for stage, number in stages.items():
            before = stored.get(path, {}).get(stage)
            if before is not None and number > (1.0 + GROWTH) * before:
                growth = number / before - 1.0
                messages.append(
                    f"{stage} ({path}) takes {number:.0f} instructions, {growth:.1%} more than the "
                    f"{before:.0f} stored; {GROWTH:.0%} is the bound"
                )
    return messages


def table(counts: Counts, stored: Counts) -> str:
    """Return a text table of the counts, with their changes from the stored counts."""
    lines = []
    for path, stages in counts.items():
        for stage, number in stages.items():
            before = stored.get(path, {}).get(stage)
            change = f"{number / before - 1.0:+7.1%}" if before else "   (new)" if stored else ""
            lines.append(f"{path:10} {stage:26} {number:9.1f} instructions a call {change}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
