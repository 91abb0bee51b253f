"""Signals and interpreter exit on the simulator; each test runs a separate process."""

import signal
import textwrap
import threading

import programs
import pytest

pytest.importorskip("mujoco", reason="these programs drive a simulated arm: extra sim")

import pliant

# A test run in the background ignores Ctrl-C, and its children would inherit that.
BEGIN = """
import os, signal, sys, pliant
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
def report():
    plant = arm.drive.plant
    print(f"{arm.enabled} {arm.drive.enabled.any()} {plant.tool[2, 3] < start - 0.02}", flush=True)
arm = pliant.connect("koch", backend="sim", table=False, rest_q=None, q=[0.0, 1.2, 0.0, 0.0, 0.0])
start = arm.drive.plant.tool[2, 3]
"""


def run(program):
    return programs.run("-c", BEGIN + textwrap.dedent(program))


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_lowers_the_arm_and_the_handlers_come_back(name):
    result = run(f"""
        before = signal.getsignal(signal.{name})
        try:
            with arm:
                for tick in pliant.Loop(arm):
                    tick.skip()
                    if tick.index == 5:
                        os.kill(os.getpid(), signal.{name})
        finally:
            report()
            print(signal.getsignal(signal.{name}) is before, flush=True)
    """)
    assert result.stdout.split() == ["False", "False", "True", "True"], result.stderr
    expected = -signal.SIGINT if name == "SIGINT" else 128 + getattr(signal, name)
    assert result.returncode in {expected, 130}


def test_a_signal_during_the_descent_waits_for_the_ground():
    result = run("""
        def once():
            arm.drive.clock.on_tick = None
            os.kill(os.getpid(), signal.SIGTERM)
        try:
            with arm:
                arm.drive.clock.on_tick = None
                arm.drive.clock.wait_until(1.0)
                arm.drive.clock.on_tick = once
        finally:
            report()
    """)
    assert result.stdout.split() == ["False", "False", "True"], result.stderr
    assert "once it is down" in result.stderr
    assert "torque OFF" in result.stderr
    assert result.returncode == 128 + signal.SIGTERM


def test_the_end_of_the_program_lowers():
    result = run("""
        import atexit
        atexit.register(report)
        arm.enable()
    """)
    assert result.stdout.split() == ["False", "False", "True"], result.stderr
    assert "is being lowered (the program ends)" in result.stderr
    assert result.returncode == 0


def test_other_threads_are_warned_that_signals_do_nothing():
    arm = pliant.connect("koch", backend="sim", table=False, rest_q=None)
    messages = []

    def work():
        with pytest.warns(RuntimeWarning, match="outside the main thread"):
            arm.enable()
        arm.leave_enabled()
        messages.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert messages == [True]
