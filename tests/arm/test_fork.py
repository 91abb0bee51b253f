"""A process that forks while its arm has torque: the child leaves port, arm and signals alone."""

import os
import signal
import subprocess
import sys
import textwrap

import programs
import pytest

pytest.importorskip("mujoco", reason="these programs drive a simulated arm: extra sim")

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")

# A test run in the background ignores Ctrl-C, and its children would inherit that.
PROGRAM = """
import atexit, os, signal, sys, time, pliant

signal.signal(signal.SIGINT, signal.default_int_handler)
arm = pliant.connect("koch", backend="sim", table=False, rest_q=None)
asked, parent = [], os.getpid()

def noted(verb, call):
    return lambda *args: (asked.append(verb), call(*args))[1]

@atexit.register  # before the arm's own, so that it runs after it
def report():
    who = "parent" if os.getpid() == parent else "child"
    print(who, len(asked), flush=True)

for verb in ("read", "write", "disable", "close"):
    setattr(arm.drive, verb, noted(verb, getattr(arm.drive, verb)))
with arm:
    for tick in pliant.Loop(arm):
        tick.skip()
        if tick.index == 5:
            child = os.fork()
            if child == 0:
                asked.clear()
                {action}
            print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), arm.enabled, flush=True)
        if tick.index == 10:
            break
print(arm.enabled, arm.drive.enabled.any(), flush=True)
"""


def run(action):
    return programs.run(
        "-c", PROGRAM.replace("{action}", textwrap.indent(action, 16 * " ").lstrip())
    )


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ("sys.exit(7)", 7),
        ("raise KeyError('policy')", 1),
        ("arm.lower(); arm.park([0.0] * 5); arm.close(); sys.exit(3)", 3),
        ("os.kill(os.getpid(), signal.SIGINT)\ntime.sleep(9.0)", -signal.SIGINT),
        ("os.kill(os.getpid(), signal.SIGTERM)\ntime.sleep(9.0)", -signal.SIGTERM),
    ],
)
def test_a_child_that_ends_sends_nothing_and_the_arm_goes_on(action, code):
    result = run(action)
    lines = result.stdout.splitlines()
    assert result.returncode == 0, result.stderr
    if code != -signal.SIGTERM:  # SIGTERM ends the child before it can print
        assert lines.pop(0) == "child 0", result.stderr
    assert lines[:2] == [f"{code} True", "False False"], result.stderr
    assert lines[2].startswith("parent ")


def test_a_child_that_uses_the_arm_gets_an_error_with_the_owner():
    result = run("""
uses = [arm.read, arm.gripper.open, arm.leave_enabled, arm.disable_torque, arm.enable]
uses.append(lambda: arm.write([0.0] * 5))
for use in uses:
    try:
        use()
    except pliant.ServoError as error:
        assert f"belongs to process {parent}" in str(error), error
    else:
        raise AssertionError(use)
sys.exit(0)
""")
    assert result.stdout.splitlines()[:3] == ["child 0", "0 True", "False False"], result.stderr


@pytest.mark.parametrize("fork", ["os.fork()", "ctypes.CDLL(None).fork()"])
def test_a_fork_of_the_process_that_imported_the_package_is_noticed(fork):
    # `programs.run` is unsuitable: it forks to start a program.
    program = f"""
import ctypes, os
import pliant
from pliant.arm._supervisor import _NOT_FORKED, Supervisor

supervisor = Supervisor(lambda: None)
supervisor.owner = os.getpid()
child = {fork}
try:
    with supervisor:
        code = 1
except pliant.ServoError as error:
    code = 2 if f"belongs to process {{supervisor.owner}}" in str(error) else 3
if child == 0:
    os._exit(code)
print(code, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), bool(_NOT_FORKED[0]))
"""
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    is_marked = sys.platform == "linux"
    assert result.stdout.split() == ["1", "2", str(is_marked)], result.stderr
