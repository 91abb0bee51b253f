"""Compare the time of pliant's calls with that of other libraries for the same computation.

    make peers                      (or: python benches/peers.py --rounds 40 --plot out.png)

Each implementation runs in a separate process: in this Python environment if it has the library,
otherwise in one that is created under build/peers. An implementation is timed only if its results
agree with a NumPy reference to 1e-9. In every round all implementations are timed, in random order;
ratios compare times of the same round. Implementations that cannot be timed are reported.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from comparison import table
from comparison.environments import BUILD, PEERS, PLIANT_ENTRIES
from comparison.timing import TimedProcess, run_rounds


def main() -> None:
    """Start the implementations and verify their results, time them, print and plot the times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--only", default="", help="peers by part of their name, comma-separated")
    parser.add_argument("--plot", type=Path, default=BUILD / "peers.png")
    arguments = parser.parse_args()
    BUILD.mkdir(parents=True, exist_ok=True)
    names = [name.strip().lower() for name in arguments.only.split(",") if name.strip()]
    processes: list[TimedProcess] = []
    for entry in (*PLIANT_ENTRIES, *PEERS):
        is_own = entry in PLIANT_ENTRIES
        if not is_own and names and not any(name in entry.name.lower() for name in names):
            continue
        process, reason = TimedProcess.start(entry)
        if process is None:
            print(f"!! {entry.name} is MISSING: {reason}", file=sys.stderr)
        elif is_own and process.version in {other.version for other in processes}:
            process.stop()  # the processor or the build lacks this instruction set
        else:
            print(f"   {process.name}: {process.version}, agrees to 1e-9", file=sys.stderr)
            processes.append(process)
    if not processes or not processes[0].name.startswith("pliant"):
        sys.exit("error: pliant itself is missing")
    run_rounds(processes, arguments.rounds)
    for process in processes:
        process.stop()
    table_rows, note = table.rows(processes), table.where()
    text = f"{note}\n{processes[0].version}\n\n{table.markdown(table_rows)}\n"
    text += f"\nCalls that do nothing, in the same blocks: p99.9 {table.floor(processes):.2f} µs.\n"
    print(f"\n{text}")
    (BUILD / "peers.md").write_text(text, encoding="utf-8")
    content = {"where": note, "rows": [asdict(row) for row in table_rows]}
    (BUILD / "peers.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    table.plot(table_rows, arguments.plot, f"{note}; 7 joints, 6 axes")
    print(f"picture: {arguments.plot}")


if __name__ == "__main__":
    main()
