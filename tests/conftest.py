"""Selection of quick and slow tests, and their distribution to workers; see CONTRIBUTING.md."""

import os
import signal
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: Folders whose tests simulate an arm, emulate a bus, draw pages or start processes.
SLOW = {
    "arm",
    "bands",
    "cli",
    "contact",
    "demo",
    "emulator",
    "identify",
    "lerobot_plugin",
    "log",
    "ros",
    "servo",
    "sim",
    "soak",
    "teach",
    "view",
}
#: Slow test files outside the folders in `SLOW`.
SLOW_FILES = {
    "config/test_arm.py",
    "config/test_rest.py",
    "test_benches.py",
    "test_experiments.py",
    "test_latency.py",
    "test_mismatch.py",
}
#: Groups of slow tests or test files that use the same simulated run. pytest-xdist runs a group in
#: one worker, so that the run is made only once.
SHARED = (
    (
        "tests/demo/test_chapters.py",
        "tests/demo/test_report.py::test_processes_do_not_change_a_digit",
        "tests/demo/test_report.py::test_quick_demo_leaves_a_report_that_needs_nothing",
    ),
    ("tests/bands/test_campaign.py",),
    tuple(
        f"tests/cli/test_measure.py::test_{name}"
        for name in (
            "a_file_of_another_arm_is_not_continued",
            "every_number_has_a_unit_and_a_line_in_the_document",
            "every_step_says_first_what_arm_and_person_do",
            "the_file_has_no_private_data",
            "the_file_names_servos_latencies_and_the_ending",
            "the_scale_shows_that_the_servos_are_stronger_than_promised",
            "the_weight_shows_a_wrong_stiffness_and_a_hidden_load",
        )
    ),
    ("tests/emulator/test_process.py",),
    *((f"tests/lerobot_plugin/test_{name}.py",) for name in ("follower", "teleoperators")),
    *((f"tests/log/test_{name}.py",) for name in ("damage", "hostile", "log", "report")),
    *((f"tests/ros/test_{name}.py",) for name in ("foxglove", "node")),
    *((f"tests/view/test_{name}.py",) for name in ("browser", "page")),
)
UNITS = {name: line[0] for line in SHARED for name in line}
#: Further test files that start a separate program in each test.
PROGRAMS = {"tests/test_house.py"}
#: Number of workers in addition to the number of cores, because many tests wait for an emulated bus
#: or another process. With more workers, replies of emulated buses were late now and then.
WAITING = 3


def pytest_configure() -> None:
    """Handle SIGINT in a run in the background too, so that programs of tests inherit this."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def real_time_priority():
    """Return a context in which this thread has a real-time priority; skip where it may not."""
    import pliant
    from pliant._processes import real_time_priority

    try:
        with real_time_priority(5):
            pass
    except (pliant.ConfigError, AttributeError) as error:  # macOS has no os.sched_getscheduler
        pytest.skip(f"not permitted here: {error}")
    return real_time_priority(5)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """Return the number of workers for `--numprocesses=auto`; None leaves it to xdist."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    return (os.cpu_count() or 1) + WAITING


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Return a scheduler that distributes slow tests one by one, and the others by file.

    Tests that share a simulated run (`SHARED`) go to the same worker.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Units(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file, _, name = nodeid.partition("::")
            test = f"{file}::{name.partition('[')[0]}"
            is_single = is_slow(file) or file in PROGRAMS
            return UNITS.get(test) or UNITS.get(file) or (nodeid if is_single else file)

    return Units(config, log)


def is_slow(file: str) -> bool:
    """Return True if `make check` skips the tests of a file, given by its path from the root."""
    name = file.removeprefix("tests/")
    return name.partition("/")[0] in SLOW or name in SLOW_FILES


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that `make check` skips, and skip those that this system cannot run."""
    for item in items:
        if not hasattr(os, "openpty") and item.get_closest_marker("pty"):
            item.add_marker(pytest.mark.skip(reason="the emulator's ports are pseudo-terminals"))
        if is_slow(item.path.relative_to(ROOT).as_posix()):
            item.add_marker("slow")


@pytest.fixture
def grasp():
    """Return the vertical grasp pose of `arm7` (7,) [rad]."""
    from pliant.sim.postures import VERTICAL

    return VERTICAL.copy()
