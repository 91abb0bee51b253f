"""The same hand under a fault: a host that stalls, gears unlike their table."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from experiments.chapters.common import drag
from experiments.conditions import NOMINAL
from experiments.result import Numbers, Statement, at_least, at_most, mm
from experiments.runner import Job
from pliant._report.page import Table
from pliant.sim.hand import STRONG

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from experiments.conditions import Conditions
    from experiments.hands import Dragged, Law

#: Time at which the host is silent, while the hand moves [s].
STALL = (2.6, 3.6)
#: Friction and damping of the gears over the table's.
TIGHT, LOOSE = 1.0 / 0.7, 1.0 / 1.3
#: Methods that are run: one of each kind.
WHO = (
    "stiff",
    "uniform 30",
    "paper 0.999",
    "cap 0.999",
    "springs",
    "impedance",
    "impedance compensated",
    "admittance",
)


class Way(Protocol):
    """Interface of a control method."""

    @property
    def make(self) -> Callable[[], Law]:
        """Factory of the law."""

    @property
    def rate(self) -> float:
        """Control rate [Hz]."""


def jobs(ways: Mapping[str, Way]) -> list[Job]:
    """Return three runs for each available method of `WHO`."""
    out = []
    for key in WHO:
        if key not in ways:
            continue
        nominal = replace(NOMINAL, rate=ways[key].rate)
        for what, conditions in _stresses(nominal).items():
            out.append(
                Job(f"{key}/{what}", drag, (ways[key].make, STRONG), {"conditions": conditions})
            )
    return out


def _stresses(nominal: Conditions) -> dict[str, Conditions]:
    return {
        "stall": nominal.with_plant(silent=STALL),
        "tight": nominal.with_plant(friction_scale=TIGHT, damping_scale=TIGHT),
        "loose": nominal.with_plant(friction_scale=LOOSE, damping_scale=LOOSE),
    }


def measure(key: str, outcomes: Mapping[str, Dragged]) -> dict[str, float | None]:
    """Compute the figures of one method; empty for a method that was not run."""
    if f"{key}/stall" not in outcomes:
        return {}
    stall, tight, loose = (outcomes[f"{key}/{what}"] for what in ("stall", "tight", "loose"))
    after = stall.trace.t > STALL[0]
    return {
        "stall_force": stall.peak,
        "stall_drift": stall.drift,
        "stall_speed": float(np.abs(stall.trace.dq[after]).max()),
        "tight_force": tight.peak,
        "tight_drift": tight.drift,
        "loose_force": loose.peak,
        "loose_walks": loose.stays,
    }


def table(numbers: Numbers, names: Mapping[str, str]) -> Table:
    """Return the table of all methods."""
    rows = [
        (
            names[key],
            f"{one['stall_force']:.1f} N",
            mm(one["stall_drift"]),
            f"{one['stall_speed']:.1f} rad/s",
            f"{one['tight_force']:.1f} N",
            mm(one["tight_drift"]),
            f"{one['loose_force']:.1f} N",
            mm(one["loose_walks"]),
        )
        for key, one in numbers.items()
        if "stall_force" in one
    ]
    return Table(
        caption="The same hand toward +y. Stall: from 2.6 to 3.6 s, in the middle of its way, the "
        "host sends nothing and reads nothing; largest force, drift of x and z, largest joint "
        "speed from then on. Tight, loose: friction and damping of the gears are 1.43 and 0.77 "
        "times what the controllers believe; walks: how far y still goes after the release.",
        columns=(
            "way",
            "stall: force",
            "drift",
            "speed",
            "tight: force",
            "drift",
            "loose: force",
            "walks",
        ),
        rows=tuple(rows),
    )


def statements(numbers: Numbers) -> tuple[Statement, ...]:
    """Return the statements on the runs, if they were made."""
    needed = ("cap 0.999", "admittance", "stiff", "impedance")
    if not all("stall_force" in numbers.get(key, {}) for key in needed):
        return ()
    ours, current, stiff, torque = (numbers[key] for key in needed)
    return (
        Statement(
            claim="When the host stalls for a second the limits of the last tick still protect; "
            "what is soft by its goals alone is stiff then, and is thrown when the host returns.",
            outcome=f"Largest force and joint speed: cap {ours['stall_force']:.1f} N, "
            f"{ours['stall_speed']:.1f} rad/s; admittance {current['stall_force']:.1f} N, "
            f"{current['stall_speed']:.1f} rad/s; stiff {stiff['stall_force']:.1f} N; torque "
            f"impedance {torque['stall_force']:.1f} N.",
            tests=(
                at_most("cap over admittance", ours["stall_force"] / current["stall_force"], 0.8),
                at_most("speed, cap over stiff", ours["stall_speed"] / stiff["stall_speed"], 0.5),
            ),
            source="study",
        ),
        Statement(
            claim="Gears that resist more than the table says cost force, here as elsewhere; the "
            "stiff axes stay where they are.",
            outcome=f"Tight gears: cap {ours['tight_force']:.1f} N, {mm(ours['tight_drift'])}; "
            f"admittance {current['tight_force']:.1f} N, {mm(current['tight_drift'])}; torque "
            f"impedance {torque['tight_force']:.1f} N, {mm(torque['tight_drift'])}.",
            tests=(
                at_least("more force", ours["tight_force"] / ours["force"], 1.0),
                at_most("drift", ours["tight_drift"], 0.005, "m"),
            ),
            source="study",
        ),
    )
