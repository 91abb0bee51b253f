"""Tiers of tests; CONTRIBUTING.md says which command runs which."""

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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that `make check` leaves out."""
    here = Path(__file__).parent
    for item in items:
        path = item.path.relative_to(here)
        if path.parts[0] in SLOW or path.as_posix() in SLOW_FILES:
            item.add_marker("slow")
