"""Tiers of tests, and their distribution; CONTRIBUTING.md says which command runs which."""

import os
from pathlib import Path

import pytest

#: Folders whose tests simulate an arm, emulate a bus, draw pages or start processes.
SLOW = {
    "arm",
    "bands",
    "cli",
    "contact",
    "demo",
    "emulator",
    "identify",
    "log",
    "servo",
    "sim",
    "soak",
    "teach",
    "view",
}
#: Files of the same kind outside these folders.
SLOW_FILES = {
    "config/test_arm.py",
    "config/test_rest.py",
    "test_benches.py",
    "test_experiments.py",
    "test_latency.py",
    "test_mismatch.py",
}
#: Files of slow tests that share a run: all of a unit go to one worker, which makes the run once.
UNITS = {
    "tests/bands/test_campaign.py": "campaign",
    "tests/demo/test_chapters.py": "quick demo",
    "tests/demo/test_report.py::test_processes_do_not_change_a_digit": "quick demo",
    "tests/demo/test_report.py::test_quick_demo_leaves_a_report_that_needs_nothing": "quick demo",
    "tests/emulator/test_process.py": "process",
    "tests/log/test_damage.py": "damage",
    "tests/log/test_hostile.py": "hostile",
    "tests/log/test_log.py": "log",
    "tests/log/test_report.py": "report",
    "tests/view/test_page.py": "page",
    "tests/view/test_browser.py": "browser",
}
#: Files of other tests of which each starts a program.
PROGRAMS = {"tests/test_house.py"}
#: More workers than cores: many tests wait for an emulated bus or another process.
WAITING = 2


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return the number of workers for `--numprocesses=auto`."""
    return (os.cpu_count() or 1) + WAITING


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Distribute slow tests one by one, the others by files, and shared runs together."""
    from xdist.scheduler import LoadScopeScheduling

    class Units(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file, _, name = nodeid.partition("::")
            test = f"{file}::{name.partition('[')[0]}"
            alone = is_slow(file) or file in PROGRAMS
            return UNITS.get(test) or UNITS.get(file) or (nodeid if alone else file)

    return Units(config, log)


def is_slow(file: str) -> bool:
    """Return True if `make check` leaves out the tests of a file, named from the root."""
    path = Path(file).relative_to("tests")
    return path.parts[0] in SLOW or path.as_posix() in SLOW_FILES


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that `make check` leaves out."""
    here = Path(__file__).parent
    for item in items:
        path = item.path.relative_to(here)
        if path.parts[0] in SLOW or path.as_posix() in SLOW_FILES:
            item.add_marker("slow")
