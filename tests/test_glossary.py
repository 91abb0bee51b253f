"""The glossary contains every public word, and only existing words."""

from __future__ import annotations

import builtins
import inspect
import re
from pathlib import Path

import pytest

import pliant
import pliant.ros
from pliant.config.factory import ARM_OPTIONS

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
ROWS = [line for line in TEXT.splitlines() if line.startswith("| ")]
#: Words in backticks in the first column of the glossary's tables.
TERMS = {word for row in ROWS for word in re.findall(r"`([^`]+)`", row.split("|")[1])}
#: Options without an entry: they are self-explanatory, or the docstring of their class has them.
SELF_EXPLAINING = {
    *("grippers", "handle_signals", "name", "power_budget", "rate", "table", "watchdog"),
}


def words_of(*objects: object) -> set[str]:
    """Return the names of public members and arguments of these classes and modules."""
    words = set()
    for item in objects:
        words |= {name for name in dir(item) if not name.startswith("_")}
        if inspect.isclass(item):
            words |= set(inspect.signature(item).parameters)
            documented = re.findall(r"^ +([\w, ]+): ", item.__doc__ or "", re.MULTILINE)
            words |= {name for names in documented for name in names.split(", ")}
    return words


PUBLIC_NAMES = words_of(
    *(pliant, pliant.Arm, pliant.Axis, pliant.Command, pliant.Controller, pliant.Loop),
    *(pliant.feasibility.AxisReport, pliant.feasibility.PoseReport),
    *(pliant.Servos, pliant.Settings, pliant.Task, pliant.Tick, pliant.types.WrenchEstimate),
    *(pliant.arm, pliant.feasibility, pliant.identify, pliant.log, pliant.servo),
    *(
        pliant.ros,
        pliant.config,
        pliant.servo.ServoSpec,
        pliant.teleop,
        pliant.teleop.JointFollower,
    ),
)


def test_every_field_of_an_axis_and_option_of_an_arm_is_explained():
    expected = set(inspect.signature(pliant.Axis).parameters) | ARM_OPTIONS - SELF_EXPLAINING
    assert expected - {"soft_step_limit"} <= {term.split(".")[-1] for term in TERMS}


def test_every_exception_is_listed_with_the_built_in_that_it_derives_from():
    kinds = [getattr(pliant, name) for name in pliant.__all__ if name.endswith("Error")]
    assert len(kinds) == 9
    for kind in kinds:
        if kind is pliant.PliantError:
            continue
        (row,) = [row for row in ROWS if row.startswith(f"| `{kind.__name__}`")]
        for base in re.findall(r"`(\w+)`", row.split("|")[3]):
            assert issubclass(kind, getattr(builtins, base)), row


@pytest.mark.parametrize("term", sorted(TERMS))
def test_every_term_exists(term):
    last = term.split(".")[-1].split("(")[0]
    symbols = {"x y z roll pitch yaw", "q", "dq", "target"}
    assert term in symbols or last in PUBLIC_NAMES, f"{term} is not a public name"
