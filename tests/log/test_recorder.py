"""`Recorder`: errors for invalid arguments, and for calls in the wrong order."""

import os

import numpy as np
import pytest

pytest.importorskip("mcap", reason="logs need the extra log")

from bare_arm import bare_arm

import pliant
from pliant.log import Recorder, read, verify


@pytest.fixture
def arm():
    with bare_arm("so101", on_exit="leave_enabled") as live:
        yield live


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"path": 3}, TypeError, r"path must be the path of a file, got 3 \(int\)"),
        ({"config": "so101"}, TypeError, "config must be what pliant.config.load gives"),
        ({"note": 5}, TypeError, "note must be a str"),
    ],
)
def test_arguments_of_another_kind_are_named(change, kind, message, tmp_path):
    arguments = {"path": tmp_path / "x.mcap", **change}
    with pytest.raises(kind, match=message):
        Recorder(arguments.pop("path"), **arguments)
    assert not list(tmp_path.iterdir())


def test_a_recorder_serves_one_loop_and_is_closed_with_it(arm, tmp_path):
    recorder = Recorder(tmp_path / "x.mcap")
    for tick in pliant.Loop(arm, duration=0.05, recorder=recorder):
        tick.skip()
    recorder.close()
    log = read(tmp_path / "x.mcap")
    assert log.whole
    assert len(log) == recorder.ticks == 5
    with pytest.raises(pliant.ConfigError, match=r"x\.mcap belongs to another loop"):
        pliant.Loop(arm, recorder=recorder)


def test_the_writer_does_not_inherit_a_real_time_priority(arm, tmp_path, real_time_priority):
    recorder = Recorder(tmp_path / "x.mcap")
    with real_time_priority:
        loop = pliant.Loop(arm, duration=0.05, recorder=recorder)
        assert os.sched_getscheduler(recorder._process.pid) not in {os.SCHED_FIFO, os.SCHED_RR}
    for tick in loop:
        tick.skip()
    assert read(tmp_path / "x.mcap").whole


def test_a_loop_left_early_leaves_a_whole_log_with_its_last_tick(arm, tmp_path):
    controller = pliant.Controller(arm.model, pliant.Settings.firm(task="xyz"), arm.servos)
    target = arm.model.forward_kinematics(arm.read().q)
    for tick in pliant.Loop(arm, controller, recorder=Recorder(tmp_path / "x.mcap")):
        command = tick.step(target)
        if tick.index == 7:
            break
    log = read(tmp_path / "x.mcap")
    assert log.whole
    assert len(log) == 8
    assert log.goal[-1].tolist() == command.goal.tolist()
    assert verify(log).same


def test_a_loop_without_a_controller_cannot_step(arm):
    for tick in pliant.Loop(arm, duration=0.02):
        with pytest.raises(pliant.ConfigError, match=r"tick\.step\(...\) needs a controller"):
            tick.step(arm.model.forward_kinematics(tick.q))
        tick.skip()


def test_an_error_of_the_program_is_not_hidden_by_the_recorder(arm, tmp_path):
    recorder = Recorder(tmp_path / "x.mcap")
    with pytest.raises(TypeError, match="command must be a Command"):
        [tick.write(5) for tick in pliant.Loop(arm, recorder=recorder)]
    log = read(tmp_path / "x.mcap")
    assert log.whole
    assert len(log) == 1
    assert np.isnan(log.goal).all()


def test_a_disk_that_fills_up_is_reported_at_once_and_the_log_is_readable(arm, tmp_path, capfd):
    resource = pytest.importorskip("resource", reason="Windows has no limit of file sizes")
    path, limits = tmp_path / "x.mcap", resource.getrlimit(resource.RLIMIT_FSIZE)
    controller = pliant.Controller(arm.model, pliant.Settings.firm(task="xyz"), arm.servos)
    recorder = Recorder(path)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (45_000, limits[1]))
        loop = pliant.Loop(arm, controller, duration=5.0, recorder=recorder)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)

    def run():
        for tick in loop:
            tick.step(arm.model.forward_kinematics(tick.q))
            if tick.index == 400:
                recorder._sender.finish(60.0)
                recorder._process.wait(60.0)

    with pytest.raises(OSError, match=r"x\.mcap: the log could not be written to its end"):
        run()
    error = capfd.readouterr().err
    assert error == f"pliant: {path}: File too large; the log ends here\n"
    log = read(path)
    assert 20 < len(log) < 400
    assert not log.whole
