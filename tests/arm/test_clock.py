"""Times in ticks, events and logs are on one clock that starts with the loop, on every drive."""

from contextlib import contextmanager

import numpy as np
import pytest

pytest.importorskip("rustypot", reason="servo buses need the extra servo")
pytest.importorskip("mujoco", reason="the arm behind the bytes needs the extra sim")

from bare_arm import bare_arm

import pliant
from pliant.log import Recorder, read
from pliant.reactions import Call, Force, Reaction, ReactionMonitor
from tests.arm.test_over_bytes import arm_over_bytes

START = np.array([0.0, -0.3, 0.3, 0.9, 0.0])


@contextmanager
def simulated():
    with bare_arm("so101", q=START, on_exit="leave_enabled") as arm:
        yield arm


@contextmanager
def over_bytes():
    with arm_over_bytes("sts", START, rate=50.0) as (bus, arm):
        bus.advance(37.0)  # so that the servos' clock does not start at 0
        with arm:
            yield arm
            arm.leave_enabled()


@pytest.mark.parametrize("backend", [simulated, over_bytes])
def test_time_begins_with_the_loop(backend, tmp_path):
    reaction_times = []
    with backend() as arm:
        controller = pliant.Controller(
            arm.model, pliant.Settings.firm(task="xyz").replace(rate=50.0), arm.servos
        )
        watch = ReactionMonitor(
            controller, [Reaction(Force("z", above=90.0), Call(reaction_times.append))]
        )
        arm.clock.wait_until(arm.clock.now() + 0.7)  # so that the loop does not start at time 0
        ticks, times, drive_times = [], [], []
        target = None
        recorder = Recorder(tmp_path / "run.mcap")
        for tick in pliant.Loop(arm, controller, rate=50.0, duration=1.0, recorder=recorder):
            if target is None:
                target = arm.model.forward_kinematics(tick.q)
            watch.update(tick.q, target, dt=tick.dt)
            tick.step(target)
            ticks.append(tick.time)
            drive_times.append(tick.began)
            times.append(watch._time)
        again = next(iter(pliant.Loop(arm, controller, rate=50.0)))
        again.skip()
    assert ticks[0] == 0.0
    assert again.time == 0.0
    assert np.allclose(np.diff(ticks), np.diff(drive_times))
    assert ticks[-1] == pytest.approx(0.98, abs=0.021)
    log = read(tmp_path / "run.mcap")
    assert np.allclose(log.time + log.lag, ticks, atol=1e-9)
    assert np.allclose(times, ticks, atol=0.02), "events are of the same clock"
