"""Programs that do not react to a signal: the supervisor thread lowers the arm instead."""

import math
import os
import signal
import sys
import threading
import time

import numpy as np
import pytest
from bare_arm import bare_arm

import pliant
from pliant.arm import _supervisor
from pliant.arm._messages import MESSAGES
from pliant.arm._supervisor import Supervisor


def until(condition):
    """Run a busy loop until a condition holds, like a program that does not call the arm."""
    rounds = 0
    while not condition():
        rounds += 1
    return rounds


def test_silence_is_detected_once_and_raised_at_the_next_call():
    calls = []
    supervisor = Supervisor(lambda: calls.append(sys.getswitchinterval()))
    interval = sys.getswitchinterval()
    with supervisor.supervised(0.05) as check:
        for _ in range(5):
            with supervisor:
                assert not calls
        until(lambda: calls)
        with supervisor.exclusive():
            pass
        with pytest.raises(pliant.ServoTimeoutError, match="did not come back"):
            check()
        with pytest.raises(pliant.ServoTimeoutError, match=r"enable\(\) starts again"), supervisor:
            pass
    assert len(calls) == 1
    assert calls[0] <= 1e-4 < interval == sys.getswitchinterval()


def test_the_guardian_sees_accesses_beats_and_the_timeout():
    supervisor = Supervisor(lambda: None)
    heartbeat, begin = supervisor.heartbeat, time.perf_counter()
    for act in (supervisor.__exit__, supervisor.beat):
        heartbeat[0] = 0.0
        supervisor.lock.acquire()
        act()
        assert begin <= heartbeat[0] <= time.perf_counter()
        assert heartbeat[1] == 0.0
    with supervisor.supervised(50.0):
        assert heartbeat[1] == 50.0
    assert heartbeat[1] == 0.0


@pytest.mark.parametrize("owner", ["none", "this", "another"])
def test_a_forked_process_has_no_access_to_an_arm_with_torque(monkeypatch, owner):
    monkeypatch.setattr(_supervisor, "_NOT_FORKED", bytes(1))
    supervisor = Supervisor(lambda: None)
    supervisor.owner = {"none": None, "this": os.getpid(), "another": os.getppid()}[owner]
    for context in (lambda: supervisor, supervisor.exclusive):
        if owner == "another":
            with pytest.raises(pliant.ServoError, match=f"process {os.getppid()}"), context():
                pass
        else:
            with context():
                pass


@pytest.mark.parametrize("ending", ["access", "dismissal"])
def test_an_access_that_takes_longer_than_the_timeout_is_no_stall(ending):
    calls = []
    supervisor = Supervisor(lambda: calls.append(ending))
    with supervisor.supervised(0.8) as check:
        with supervisor:
            time.sleep(0.9)  # the thread waits for the lock meanwhile
            if ending == "dismissal":
                supervisor.end_supervision()
        check()
        # Let the thread acquire the lock, for which it waits.
        time.sleep(0.05)
        with supervisor:
            assert not calls
    assert supervisor.reason is None


def test_two_arms_that_stall_at_once_restore_the_switch_interval():
    interval, intervals = sys.getswitchinterval(), []
    begun, ends = [threading.Event(), threading.Event()], [threading.Event(), threading.Event()]

    def leave(arm):
        begun[arm].set()
        assert ends[arm].wait(10.0)
        intervals.append(sys.getswitchinterval())

    first, second = (Supervisor(lambda arm=arm: leave(arm)) for arm in range(2))
    with first.supervised(0.05):
        assert begun[0].wait(10.0)
        with second.supervised(0.05):
            assert begun[1].wait(10.0)
            for supervisor, end in ((first, ends[0]), (second, ends[1])):
                assert sys.getswitchinterval() <= 1e-4
                end.set()
                # The thread restores the interval before it releases the lock.
                assert supervisor.lock.acquire(timeout=10.0)
                supervisor.lock.release()
    assert max(intervals) <= 1e-4
    assert sys.getswitchinterval() == interval


def test_no_supervision_outside_a_loop_or_in_simulated_time(make, grasp):
    MESSAGES.start()
    before = threading.active_count()
    with make() as arm:
        for tick in pliant.Loop(arm, duration=0.05):
            tick.skip()
            assert threading.active_count() == before
    supervisor = Supervisor(lambda: None)
    with supervisor.supervised(10.0):
        assert threading.active_count() == before + 1
    assert supervisor.reason is None


def test_infinite_patience_starts_no_thread_and_ends_an_earlier_one():
    arm = bare_arm(real_time=True, handle_signals=False)
    before = set(threading.enumerate())
    # After an exception, the thread of an earlier context still runs.
    with pytest.raises(ZeroDivisionError), arm.supervised(60.0):
        raise ZeroDivisionError
    (thread,) = set(threading.enumerate()) - before
    with arm.supervised(math.inf) as check:
        check()
        thread.join(timeout=10.0)
        assert not set(threading.enumerate()) - before
        # The guardian, which reads this timeout, detects no hang either.
        assert arm._supervisor.heartbeat[1] == 0.0


def test_errors_of_the_bus_are_kept_for_the_program():
    def leave():
        raise pliant.ServoError("unplugged")

    supervisor = Supervisor(leave)
    with supervisor.supervised(0.02):
        until(lambda: supervisor.reason is not None and "unplugged" in supervisor.reason)
    with pytest.raises(pliant.ServoTimeoutError, match="unplugged"), supervisor:
        pass


def test_any_exception_is_kept_for_the_program():
    def leave():
        raise ZeroDivisionError("a bug")

    supervisor = Supervisor(leave)
    with supervisor.supervised(0.02):
        until(lambda: supervisor.reason is not None and "a bug" in supervisor.reason)
    with pytest.raises(pliant.ServoTimeoutError, match="a bug"), supervisor:
        pass


def test_an_exception_does_not_end_the_watch_and_dismissal_does():
    calls = []
    supervisor = Supervisor(lambda: calls.append(1))
    with pytest.raises(KeyError), supervisor.supervised(0.02):
        raise KeyError("policy")
    until(lambda: calls)
    supervisor.reason = None
    with pytest.raises(KeyError), supervisor.supervised(0.05):
        raise KeyError("policy")
    supervisor.end_supervision()
    time.sleep(0.2)
    assert calls == [1]


def test_an_exit_waits_for_a_descent_and_limp_ends_it():
    order = []

    def leave():
        order.append("begins")
        supervisor.abort.wait(10.0)
        order.append("ends")

    supervisor = Supervisor(leave)
    with supervisor.supervised(0.02):
        until(lambda: order)
        with supervisor.exclusive(at_once=True):
            order.append("exit")
    assert order == ["begins", "ends", "exit"]


@pytest.mark.skipif(os.name != "posix", reason="signals wake no lock on Windows")
def test_a_signal_while_enable_waits_for_a_descent_does_not_end_it():
    order, waits, interrupted = [], threading.Event(), threading.Event()

    def leave():
        order.append("begins")
        waits.wait(10.0)
        time.sleep(0.05)
        # The main thread, which waits for the lock, gets the signal, as with Ctrl-C in a terminal.
        os.kill(os.getpid(), signal.SIGINT)
        interrupted.wait(10.0)
        order.append("aborted" if supervisor.abort.is_set() else "ends")

    supervisor = Supervisor(leave)
    with supervisor.supervised(0.02):
        until(lambda: order)
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012
            waits.set()
            with supervisor.exclusive():
                pass
        interrupted.set()
        with supervisor.exclusive():
            pass
    assert order == ["begins", "ends"]


@pytest.mark.parametrize("busy", [True, pytest.param(False, marks=pytest.mark.full)])
def test_an_arm_in_real_time_comes_down_without_its_program(busy):
    arm = bare_arm("koch", real_time=True, comm_timeout=0.1, dt=0.005, handle_signals=False)
    plant, speeds = arm.drive.plant, []
    arm.open()
    plant.reset(np.array([0.0, 1.5, 0.0, 0.0, 0.0]))  # a descent of 3 cm
    height = plant.tool[2, 3]

    def run():
        with arm:
            for tick in pliant.Loop(arm):
                tick.skip()
                if tick.index == 5:
                    arm.clock.on_tick = lambda: speeds.append(
                        np.linalg.norm(plant.ground_truth.frame("tool").twist()[:3])
                    )
                    if busy:
                        until(lambda: not arm.enabled)
                    else:
                        while arm.enabled:
                            time.sleep(0.05)
                    arm.read()

    with pytest.raises(pliant.ServoTimeoutError, match="did not come back"):
        run()
    assert not arm.drive.enabled.any()
    assert plant.tool[2, 3] < height - 0.02
    assert max(speeds) < 0.18
