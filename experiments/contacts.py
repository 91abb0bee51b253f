"""Contact detection without force sensors: latency, missed contacts, false alarms.

``python -m experiments.contacts`` lets a hand of random stiffness and speed meet the tool 1000
times in random poses, and lets the arm move freely for one hour, both at 100 Hz, with flickering
encoder counts and friction assumed wrong by up to 30 %. Other cases (everything known, k_p off,
identified gears, servos that report their load, a small arm) get a quarter of that.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from experiments import contacts_table as table
from experiments.contacts_bench import Bench, Case, Record
from experiments.parallel import parallel

if TYPE_CHECKING:
    from collections.abc import Iterable

#: The case of the documented numbers, and the others.
MAIN = Case("encoder, friction ±30 %")
OTHERS = (
    Case("a tick each way", delay=(1, 1)),
    Case("all known", encoder=False, friction=0.0),
    Case("and k_p ±10 %", kp=0.1),
    Case("gears as they are", gears=True),
    Case("load reported", sensed=True),
    Case("load reported, gears as they are", sensed=True, gears=True),
    Case("gears as they are, told so", gears=True, told={"friction_error": 2.0}),
    Case("gears as they are, identified ±30 %", gears=True, identified=True),
    Case("so101", arm="so101"),
)
#: Length of a free run [s].
PIECE = 60.0


@dataclass(frozen=True)
class Options:
    """Measure thresholds on an estimated force.

    Attributes:
        contacts: Random contacts of the main case.
        minutes: Free motion of the main case.
        others: Share of both for each other case; 0: leave them out.
        jobs: Number of processes.
        out: Folder for results.json and the picture.
    """

    contacts: int = 1000
    minutes: int = 60
    others: float = 0.25
    jobs: int = 2
    out: Path = Path("pliant-contacts")


@dataclass(frozen=True)
class Job:
    """One run."""

    case: Case
    number: int
    seconds: float | None = None

    def run(self) -> Record:
        """Record it."""
        bench = Bench(self.case)
        if self.seconds is None:
            return bench.contact(self.number)
        return bench.free(self.number, self.seconds)


def measure(
    case: Case, contacts: int, minutes: int, processes: int = 1, piece: float = PIECE
) -> tuple[list[table.Seen], dict[str, float]]:
    """Run one case and evaluate every threshold.

    Args:
        case: The case.
        contacts: Number of random contacts.
        minutes: Duration of free motion.
        processes: Number of processes.
        piece: Length of one free run [s].

    Returns:
        A row per rule; errors, bounds and the thresholds without alarms.
    """
    pieces = round(60.0 * minutes / piece)
    free = list(parallel([Job(case, i, piece) for i in range(pieces)], processes, case.name))
    met = list(parallel([Job(case, i) for i in range(contacts)], processes, case.name))
    capacity = Bench(case).arm.median_capacity[0]
    silent = table.least_silent(free, slice(0, 3))
    sizes = sorted([*(float(f"{share * capacity:.2g}") for share in table.SHARES), silent])
    rules = [table.Rule("force", size) for size in sizes]
    rules += [table.Rule("guarded", share) for share in table.GUARDS]
    rules += [table.Rule("evidence", share) for share in table.EVIDENCE]
    strength = table.STRONG_FORCE * capacity
    rows = [table.look(case.name, rule, strength, free, met) for rule in rules]
    facts = table.honesty(free, met)
    facts["strong [N]"], facts["silent [N]"] = strength, silent
    facts["silent [N·m]"] = table.least_silent(free, slice(3, 6))
    return rows, facts


def main(options: Options) -> None:
    """Run the requested cases, print the tables, write the files."""
    rows: list[table.Seen] = []
    facts: dict[str, dict[str, float]] = {}
    plan: Iterable[tuple[Case, float]] = [(MAIN, 1.0), *((case, options.others) for case in OTHERS)]
    for case, share in plan:
        contacts, minutes = round(share * options.contacts), round(share * options.minutes)
        if min(contacts, minutes) < 1:
            continue
        found, facts[case.name] = measure(case, contacts, minutes, options.jobs)
        print(table.text(found), flush=True)
        print({name: round(value, 4) for name, value in facts[case.name].items()}, flush=True)
        rows += found
    about = {"contacts": options.contacts, "minutes": options.minutes, "facts": facts}
    table.save(options.out, rows, about)
    table.draw(options.out, rows)
    print(f"contacts: {options.out / 'results.json'}, {options.out / 'contacts.png'}")


if __name__ == "__main__":
    # Other processes import this module's jobs by its name, not as `__main__`.
    from experiments import contacts  # noqa: PLW0406 -- by name

    contacts.main(tyro.cli(contacts.Options))
