"""Log files: content, replay, limits on memory and time, and command `log`."""

import os
import signal
import subprocess
import sys
import time
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bare_arm import bare_arm

import pliant
from pliant.cli import main
from pliant.log import Recorder, read, verify
from pliant.log.reader import arguments
from pliant.reactions import After, Reaction, Yield

parquet = pytest.importorskip("pyarrow.parquet")
rosbags = pytest.importorskip("rosbags.highlevel")
read_ros2_messages = pytest.importorskip("mcap_ros2.reader").read_ros2_messages

START = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]


def record(path, ticks=40, **options):
    """Record a run that uses every input of the controller once."""
    with bare_arm("arm7", q=START) as arm:
        settings = pliant.Settings.soft("y")
        recorded_controller = pliant.Controller(arm.model, settings, arm.servos)
        recorder = Recorder(path, **options)
        pose = arm.model.forward_kinematics(arm.read().q)
        loop = pliant.Loop(arm, recorded_controller, duration=ticks / 100.0, recorder=recorder)
        controller = loop.controller
        for tick in loop:
            options_of_step = {"dt": tick.dt} if tick.index % 2 else {}
            if tick.index == 10:
                controller.update(settings.replace(axes={"x": pliant.Axis(soft=3.0)}))
                controller.set_payload(0.1, [0.0, 0.0, 0.05])
                controller.set_gravity([0.1, 0.0, -9.8])
                controller.set_delay(0.013)
            if tick.index > 15:
                options_of_step["dq"] = 0.01 * np.sin(np.arange(7) + tick.index)
                options_of_step["gradient"] = np.full(7, 0.1)
            if tick.index > 20:
                options_of_step["twist"] = [0.0, 0.02, 0.0, 0.0, 0.0, 0.1]
            if tick.index == 30:
                command = controller.step_joints(tick.q, tick.q + 0.01, **options_of_step)
            else:
                target = pliant.Pose(pose) if tick.index == 5 else pose
                command = controller.step(tick.q, target, **options_of_step)
            tick.write(command)
        assert recorder.dropped == 0
    return read(path)


def test_settings_that_a_reaction_changes_are_in_the_log(tmp_path):
    with bare_arm("arm7", q=START) as arm:
        controller = pliant.Controller(arm.model, pliant.Settings.soft("y"), arm.servos)
        recorder = Recorder(tmp_path / "run.mcap")
        loop = pliant.Loop(arm, controller, duration=0.3, recorder=recorder)
        reaction = Reaction(After(0.1), Yield("z", {"soft": 2.0}))
        watch = pliant.ReactionMonitor(loop.controller, [reaction])
        pose = arm.model.forward_kinematics(arm.read().q)
        for tick in loop:
            tick.step(watch.update(tick.q, pose, dt=tick.dt))
    assert controller.settings.axes["z"].soft == (2.0, 2.0)
    assert verify(read(recorder.path)).same


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    record(path)
    return path


def test_the_same_inputs_give_the_same_commands(file):
    log = read(file)
    assert log.whole
    assert {call.what for call in log.calls} == {
        "reset", "step", "step_joints", "update", "set_payload", "set_gravity", "set_delay"
    }  # fmt: skip
    again = verify(log)
    assert again.same
    assert again.steps == len(log) + 1  # the loop adds a step before the first tick
    np.testing.assert_array_equal(again.goal[1:], log.goal)


@pytest.mark.parametrize("field", ["dt", "dq", "twist", "gradient", "target", "call"])
def test_every_input_counts(file, field):
    log = read(file)
    if field == "call":
        log.calls = [call for call in log.calls if call.what != "update"]
    elif field == "dt":
        # Change dt in all calls: in one step, with dq given, it may have no effect.
        for call in log.calls:
            if call.what == "step" and np.isfinite(call.dt):
                call.dt *= 1.01
    else:
        call = next(c for c in log.calls if c.what == "step" and c.sequence > 30)
        getattr(call, field)[3] += 1e-3
    assert verify(log).differing > 0


def test_a_settings_change_can_be_tried_on_a_log(file):
    log = read(file)
    other = verify(log, pliant.Settings.firm())
    assert other.steps == len(log) + 1
    assert other.differing > 0


def test_columns_are_what_the_loop_saw(file):
    log = read(file)
    n, k, ticks = 7, 6, len(log)
    assert log.q.shape == log.goal.shape == log.saturated.shape == (ticks, n)
    assert log.activation.shape == (ticks, n, k + 1)
    assert log.target.shape == (ticks, 4, 4)
    assert log.run["joints"] == log.model().joint_names
    np.testing.assert_allclose(np.diff(log.time), 0.01, atol=1e-9)
    np.testing.assert_allclose(log.activation.sum(axis=1), 1.0, atol=1e-9)
    update = next(call for call in log.calls if call.what == "update")
    assert arguments(update)["settings"].axes["x"] == pliant.Axis(soft=3.0)
    with pytest.raises(AttributeError, match="torque_limit"):
        log.torques  # noqa: B018


def test_two_other_readers_open_it(file):
    log = read(file)
    by_topic = {"/joint_states": [], "/command/joint_states": []}
    for message in read_ros2_messages(file, topics=list(by_topic)):
        by_topic[message.channel.topic].append(message.ros_msg)
    np.testing.assert_array_equal([m.position for m in by_topic["/joint_states"]], log.q)
    limits = [m.effort for m in by_topic["/command/joint_states"]]
    np.testing.assert_array_equal(limits, log.torque_limit)
    with rosbags.AnyReader([file]) as reader:
        topics = {connection.topic: connection for connection in reader.connections}
        assert {"/joint_states", "/command/joint_states", "/tcp/actual", "/tcp/target"} <= set(
            topics
        )
        assert {"/tcp/intermediate", "/tf", "/task/joint_states", "/robot_description"} <= set(
            topics
        )

        def messages(topic):
            channel = topics[topic]
            return [
                (stamp, reader.deserialize(data, channel.msgtype))
                for _, stamp, data in reader.messages([channel])
            ]

        states = messages("/joint_states")
        np.testing.assert_array_equal([m.position for _, m in states], log.q)
        stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for _, m in states])
        np.testing.assert_allclose(np.diff(stamps), np.diff(log.time), atol=1e-6)
        commands = messages("/command/joint_states")
        np.testing.assert_array_equal([m.effort for _, m in commands], log.torque_limit)
        position = messages("/tcp/actual")[-1][1].pose.position
        pose = log.model().forward_kinematics(log.q[-1])
        np.testing.assert_allclose([position.x, position.y, position.z], pose[:3, 3])
        assert "<robot" in messages("/robot_description")[0][1].data
        assert len(messages("/pliant/tick")) == len(log)


LOOP = """
import sys
from test_log import *
arm = bare_arm("arm7", q=START, real_time=True, on_exit="leave_enabled")
arm.enable()
made = pliant.Controller(arm.model, pliant.Settings.soft("y"), arm.servos)
recorder = Recorder(sys.argv[1])
pose = arm.model.forward_kinematics(arm.read().q)
for tick in pliant.Loop(arm, made, recorder=recorder):
    tick.step(pose)
    if tick.index == 151:
        recorder._sender.finish(60.0)  # The writer starts late on a busy machine.
        print(recorder._process.pid, flush=True)
"""


def wait_for(condition):
    deadline = time.monotonic() + 60.0
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.05)


@pytest.mark.parametrize("both", [False, True], ids=["the program", "program and writer"])
def test_a_killed_run_can_be_read(tmp_path, both):
    path = tmp_path / "killed.mcap"
    folder = Path(__file__).parent
    search_path = os.pathsep.join(
        (os.environ.get("PYTHONPATH", ""), str(folder), str(folder.parent))
    )
    environment = {**os.environ, "PYTHONPATH": search_path}
    with subprocess.Popen(
        [sys.executable, "-c", LOOP, str(path)], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        writer = int(process.stdout.readline())
        if both:
            # The writer adds a chunk, half a second of ticks, to the file as soon as it is full.
            wait_for(lambda: len(read(path)) > 50)
            os.kill(writer, signal.SIGKILL)
        process.kill()
    if not both:
        wait_for(lambda: read(path).whole)
    log = read(path)
    assert log.whole is not both
    assert len(log) > (50 if both else 150)
    assert verify(log).same


def test_a_writer_that_is_gone_does_not_stop_the_loop(tmp_path):
    with bare_arm("arm7", q=START) as arm:
        controller = pliant.Controller(arm.model, pliant.Settings.soft("y"), arm.servos)
        recorder = Recorder(tmp_path / "gone.mcap")
        loop = pliant.Loop(arm, controller, duration=0.1, recorder=recorder)
        recorder._process.kill()
        recorder._process.wait()
        pose = arm.model.forward_kinematics(arm.read().q)
        steps = (tick.step(pose) for tick in loop)
        assert len(list(islice(steps, 10))) == 10
        assert recorder.dropped > 0
        with pytest.raises(OSError, match=r"gone\.mcap"):
            next(steps)


def test_memory_is_bounded(tmp_path):
    from pliant.log.frames import Sender

    end, start = os.pipe()
    sender = Sender(start, max_backlog=10_000)
    for _ in range(200):
        sender.send(1, bytes(1000))
    assert sender.dropped > 100
    assert len(sender._backlog) <= 10_000 + 2000
    start_time = time.monotonic()
    assert not sender.finish(0.2)
    assert time.monotonic() - start_time < 5.0
    os.close(end)
    os.close(start)


def test_a_slow_writer_gets_all_data(monkeypatch):
    """The timeout counts from the last bytes that the pipe accepted."""
    from pliant.log import frames

    end, start = os.pipe()
    sender, now, received = frames.Sender(start), 0.0, 0
    size = 0
    while len(sender._backlog) < 1_000_000:
        assert sender.send(1, bytes(10_000))
        size += 10_000 + frames.HEADER.size

    def sleep(_):
        nonlocal now, received
        now += 4.0
        received += len(os.read(end, 100_000))

    monkeypatch.setattr(frames, "time", SimpleNamespace(monotonic=lambda: now, sleep=sleep))
    assert sender.finish(5.0)
    assert now > 20.0
    os.set_blocking(end, False)
    while received < size:
        received += len(os.read(end, 100_000))
    os.close(end)
    os.close(start)


def test_a_writer_that_takes_no_data_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr("pliant.log.recorder.CLOSE_TIMEOUT", 0.5)
    recorder = Recorder(tmp_path / "early.mcap")
    arm = bare_arm("arm7", q=START)
    recorder.start(arm, None, 100.0)
    os.kill(recorder._process.pid, signal.SIGSTOP)
    while not recorder._sender._backlog:
        recorder._sender.send(1, bytes(10_000))
    finish = recorder._sender.finish

    def finish_and_continue(timeout):
        is_sent = finish(timeout)
        os.kill(recorder._process.pid, signal.SIGCONT)
        return is_sent

    recorder._sender.finish = finish_and_continue
    wait = recorder._process.wait
    monkeypatch.setattr(recorder._process, "wait", lambda _: wait() and 0)
    with pytest.raises(OSError, match="the log ends early"):
        recorder.close()


def test_the_command_tells_draws_and_exports(file, tmp_path, capsys):
    assert main(["log", "info", str(file)]) == 0
    assert "40 ticks" in capsys.readouterr().out
    assert main(["log", "verify", str(file)]) == 0
    assert "bit for bit" in capsys.readouterr().out
    picture = tmp_path / "run.svg"
    assert main(["log", "plot", str(file), "--output", str(picture)]) == 0
    assert "deviation" in picture.read_text(encoding="utf-8")
    table = tmp_path / "run.parquet"
    assert main(["log", "export", str(file), "--parquet", "--output", str(table)]) == 0
    log = read(file)
    rows = parquet.read_table(table)
    np.testing.assert_array_equal(rows["q." + log.run["joints"][3]], log.q[:, 3])
    np.testing.assert_array_equal(rows["deviation.y"], log.deviation[:, 1])
    archive = tmp_path / "run.npz"
    assert main(["log", "export", str(file), "--output", str(archive)]) == 0
    with np.load(archive) as arrays:
        np.testing.assert_array_equal(arrays["goal"], log.goal)
    assert main(["log", "info", str(archive)]) == 2
    assert "not a log" in capsys.readouterr().err


def test_a_soft_run_can_be_logged_from_the_shell(tmp_path):
    path = tmp_path / "run.mcap"
    flags = ["run", "so101", "--backend", "sim", "--duration", "0.3", "--quiet"]
    assert main([*flags, "--log", str(path)]) == 0
    log = read(path)
    assert log.run["config"] is not None
    assert log.run["extra"] == ("gripper",)
    assert verify(log).same


def test_hand_guiding_is_logged_without_a_controller(tmp_path):
    path = tmp_path / "float.mcap"
    with bare_arm("so101", on_exit="leave_enabled") as arm:
        guiding = pliant.HandGuiding(arm.model, arm.servos)
        for tick in pliant.Loop(arm, guiding, duration=0.2, recorder=Recorder(path)):
            tick.step()
    log = read(path)
    assert len(log) == 20
    assert np.isfinite(log.goal).all()
    with pytest.raises(pliant.ConfigError, match="without a controller"):
        verify(log)


def test_invalid_logs_are_reported(tmp_path):
    with bare_arm("arm7", q=START) as arm:
        controller = pliant.Controller(arm.model, pliant.Settings.soft("y"), arm.servos)
        controller.step(START, arm.model.forward_kinematics(START))
        with pytest.raises(pliant.ConfigError, match="has made steps"):
            pliant.Loop(arm, controller, recorder=Recorder(tmp_path / "late.mcap"))
    assert not (tmp_path / "late.mcap").exists()
    (tmp_path / "none.mcap").write_bytes(b"no log")
    with pytest.raises(pliant.ConfigError, match="not a log"):
        read(tmp_path / "none.mcap")
