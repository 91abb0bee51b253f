"""Teaching by hand and replay, with the simulator and from the command line."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arm needs the extra sim")

from bare_arm import bare_arm, left_enabled

import pliant
import pliant.robots
from experiments import descent
from experiments.hand_guiding import SWING_SEED
from pliant.cli import main
from pliant.cli.teach import _save_elsewhere
from pliant.sim import Drag, ForceProfile
from pliant.teach import Motion, Replay, Teacher, record, retime
from pliant.teach import _scripted_hand as lead

START = [0.0, -0.3, 0.3, 0.9, 0.0]  # [rad]
MODEL = pliant.robots.so101()
NAMES = tuple(MODEL.joint_names)
SETTINGS = pliant.Settings(task="xyz", axes={"y": pliant.Axis(soft=2.0, profile="constant")})


def wave(seconds=2.0, size=0.3):
    time = np.linspace(0.0, seconds, 101)
    q = np.tile(START, (101, 1))
    q[:, 0] += 0.5 * size * (1.0 - np.cos(np.pi * time / seconds))
    return Motion(NAMES, time, q, {"gripper": np.linspace(0.1, 0.5, 101)})


def play(motion, scene=(), seconds=30.0, on_tick=lambda replay, tick: None, **options):
    """Replay a motion on an SO-101; return the replay, an array with a row per tick, and the state.

    A row has the time [s], the time in the motion [s], the force of the hand [N], and the positions
    of the tool (3,) [m] and of the motion (3,) [m]. The state is the last reading of the arm.
    """
    rows = []
    with bare_arm("so101", q=START, scene=scene, on_exit="leave_enabled") as arm:
        controller = pliant.Controller(arm.model, SETTINGS, arm.servos)
        replay = Replay(controller, motion, **options)
        for tick in pliant.Loop(arm, controller, duration=seconds):
            tick.write(replay.step(tick.q, dt=tick.dt), replay.extra(arm))
            plant = arm.drive.plant
            force = float(np.linalg.norm(plant.hands[0].force)) if scene else 0.0
            expected = MODEL.forward_kinematics(motion.at(replay.time))[:3, 3]
            rows.append((tick.began, replay.time, force, *plant.tool[:3, 3], *expected))
            on_tick(replay, tick)
            if replay.done:
                break
        return replay, np.array(rows), tick.state


def test_a_hand_teaches_and_the_arm_repeats(tmp_path):
    course = ForceProfile(start=9.0, rise=2.0, end=11.5)
    hand = Drag(axis="y", distance=0.06, stiffness=2000.0, limit=60.0, at="tool", course=course)
    with bare_arm("so101", q=START, scene=[hand], on_exit="leave_enabled") as arm:
        motion = record(arm, idle_timeout=1.0)
        tool = arm.drive.plant.tool[:3, 3]
    ends = [MODEL.forward_kinematics(q)[:3, 3] for q in (motion.q[0], motion.q[-1])]
    assert 1.5 < motion.duration < 3.5  # trimmed
    assert ends[1][1] - ends[0][1] > 0.05
    assert np.linalg.norm(ends[1] - tool) < 0.005
    motion.save(tmp_path / "m.json")
    replay, rows, _ = play(Motion.load(tmp_path / "m.json"))
    assert replay.done
    error = np.linalg.norm(rows[:, 3:6] - rows[:, 6:9], axis=1)[rows[:, 1] > 0.0]
    assert error.max() < 0.015
    assert error[-1] < 0.005


def test_a_blocked_replay_waits_without_force_and_goes_on():
    free, _, _ = play(wave())
    course = ForceProfile(start=3.0, rise=0.0, end=7.0)
    wall = Drag(axis="y", distance=0.0, stiffness=3000.0, limit=60.0, at="tool", course=course)
    replay, rows, _ = play(wave(4.0, 0.6), [wall])
    is_blocked = (rows[:, 0] > 5.0) & (rows[:, 0] < 7.0)
    assert free.blocked_time == 0.0
    assert np.ptp(rows[is_blocked, 1]) < 1e-9  # the motion's clock stands still
    assert 0.5 < np.median(rows[is_blocked, 2]) < 3.0  # the cap is 2 N
    assert np.ptp(rows[is_blocked, 2]) < 0.5
    assert replay.done
    assert np.linalg.norm(rows[-1, 3:6] - rows[-1, 6:9]) < 0.006
    assert replay.blocked_time > 1.5


def test_speed_and_gripper():
    slow, rows, state = play(wave(), speed=0.5)
    fast, quick, _ = play(wave(), speed=2.0)
    assert slow.done
    assert fast.done
    assert rows[-1, 0] - rows[0, 0] > 3.0 + (quick[-1, 0] - quick[0, 0]) - 1.0
    assert state.extra["gripper"] == pytest.approx(0.5, abs=0.05)


def test_a_contact_stops_it_until_it_is_told_to_go_on():
    course = ForceProfile(start=3.5, rise=0.2, end=5.0)
    hand = pliant.sim.Push(force_vector=(0.0, 0.0, -15.0), course=course)
    states = []

    def note(replay, tick):
        states.append(replay.state)
        if replay.state == "stopped" and tick.began > 6.5:
            replay.resume()

    still_motion = wave(5.0, 0.4)
    replay, rows, _ = play(still_motion, [hand], on_tick=note, stop=5.0)
    is_stopped = np.array([state == "stopped" for state in states])
    assert replay.stops == 1
    assert rows[is_stopped, 0].min() < 4.5
    assert np.ptp(rows[is_stopped, 1]) == 0.0
    assert replay.done
    controller = pliant.Controller(MODEL, SETTINGS)
    for stop in (0.1, np.nan, np.inf):
        with pytest.raises(pliant.OutOfRangeError, match=r"stop \[N\] = .* is outside") as error:
            Replay(controller, still_motion, stop=stop)
    message = str(error.value)
    # The message names no argument of `ContactEstimator`, and the bound in it is accepted.
    assert not {"accept", "guard", "touch", "kp_error"} & set(re.findall(r"\w+", message))
    for wait in ((1.0, np.nan), (np.nan, 1.0), (0.0, 1.0), (1.0, np.inf), (1.0,), 0.03):
        with pytest.raises(pliant.PliantError, match="wait"):
            Replay(controller, still_motion, wait=wait)
    Replay(controller, still_motion, stop=float(message.split("[")[2].split(",", maxsplit=1)[0]))


def test_a_press_of_the_gripper_counts_once():
    with bare_arm("so101", q=START, on_exit="leave_enabled") as arm:
        teacher, state = Teacher(arm), arm.read()
        jaw = arm.gripper
        shares = [0.5, 0.1, 0.05, 0.5, 0.0]
        positions = [jaw.closed + share * (jaw.opened - jaw.closed) for share in shares]
        presses = [
            teacher.gripper_pressed(state.replace(extra={"gripper": position}))
            for position in positions
        ]
        assert presses == [False, True, False, False, True]
        assert teacher.extra(state)["gripper"][1] < 0.5 * jaw.limit


def test_trim_smooth_and_interpolate():
    time = np.arange(0.0, 6.0, 0.01)
    q = np.zeros((600, 5))
    q[:, 1] = np.clip(time - 2.0, 0.0, 1.0)
    tremor = 0.004 * np.random.default_rng(1).standard_normal(600)
    motion = replace(wave(), time=time, q=q, extra={})
    short = motion.trimmed()
    assert short.duration == pytest.approx(1.4, abs=0.06)
    smooth = replace(short, q=short.q + tremor[: len(short.time), None]).smoothed()
    interior = slice(20, -20)
    ideal = np.interp(smooth.time, short.time, short.q[:, 1])
    assert np.abs(smooth.q[interior, 1] - ideal[interior]).max() < 0.003
    exact = np.interp(0.777, wave().time, wave().q[:, 0])
    assert wave().at(0.777)[0] == pytest.approx(exact, abs=1e-4)
    np.testing.assert_array_equal(wave().at(wave().time[30]), wave().q[30])
    np.testing.assert_array_equal(wave().at(99.0), wave().q[-1])
    with pytest.raises(pliant.ConfigError, match="nothing moved"):
        replace(motion, q=np.zeros((600, 5))).trimmed()


def test_interpolation_does_not_overshoot_the_samples():
    time, q = np.array([0.0, 1.0, 1.02, 9.0, 9.02, 10.0]), np.tile(START, (6, 1))
    q[2:4, 0] = MODEL.upper[0]
    motion = replace(wave(), time=time, q=q, extra={})
    positions = np.array([motion.at(t)[0] for t in np.linspace(0.0, 10.0, 2001)])
    assert positions.min() >= 0.0
    assert positions.max() <= MODEL.upper[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joints": NAMES[:4]}, "4 joints"),
        ({"time": np.zeros(101)}, "rise: sample 2 is at 0 s"),
        ({"q": np.full((101, 5), np.nan)}, "shoulder_pan of sample 1 of 101 is nan"),
        ({"extra": {"gripper": [0.0]}}, "as many"),
    ],
)
def test_an_invalid_motion_is_refused(change, message):
    with pytest.raises(pliant.ConfigError, match=message):
        replace(wave(), **change)


def test_a_motion_of_another_arm_is_refused(tmp_path):
    controller = pliant.Controller(MODEL, SETTINGS)
    with pytest.raises(pliant.ConfigError, match="this arm has"):
        Replay(controller, replace(wave(), joints=("a", "b", "c", "d", "e")))
    with pytest.raises(pliant.ConfigError, match=r"the motion is of .*; this arm has"):
        replace(wave(), joints=NAMES[1:], q=wave().q[:, 1:]).for_model(MODEL)
    with pytest.raises(pliant.ConfigError, match="beyond its limits"):
        Replay(controller, replace(wave(), q=wave().q + 3.0))
    (tmp_path / "no.json").write_text("{}")
    with pytest.raises(pliant.ConfigError, match=r"no\.json"):
        Motion.load(tmp_path / "no.json")
    with bare_arm("so101", q=START, on_exit="leave_enabled") as arm:
        teacher = Teacher(arm)
        with pytest.raises(pliant.PliantError, match="swings") as error:
            teacher.start()
        assert error.type is pliant.PliantError, "nothing is wrong with a configuration"


def test_a_recording_without_motion_is_not_a_config_error():
    with bare_arm("so101", q=START, on_exit="leave_enabled") as arm:
        with pytest.raises(pliant.PliantError, match="nothing was recorded") as error:
            Teacher(arm).stop()
        assert error.type is pliant.PliantError
        with pytest.raises(
            pliant.PliantError, match=r"the arm was not moved by hand within 0\.1 s"
        ) as error:
            record(arm, start_timeout=0.1)
        assert error.type is pliant.PliantError


def test_an_arm_whose_joints_have_the_same_names_is_told_apart_by_its_tool(tmp_path):
    wave().for_model(MODEL).save(tmp_path / "m.json")
    stored_motion = Motion.load(tmp_path / "m.json")
    stored_motion.validate_for(MODEL)
    with pytest.raises(pliant.ConfigError, match=r"another arm's.* koch_like"):
        stored_motion.validate_for(pliant.robots.koch())
    wave().validate_for(pliant.robots.koch())  # accepted, because the motion has no `start`


def test_bounds_are_kept_and_what_is_slower_stays():
    pytest.importorskip("ruckig")
    rate, (speed, acceleration, jerk) = 50.0, (1.0, 3.0, 30.0)
    calm = retime(wave(), (speed, acceleration, jerk), rate)
    assert np.abs(calm.q - [wave().at(t) for t in calm.time]).max() < 0.001
    fast = replace(wave(), time=0.25 * wave().time)
    retimed = retime(fast, (speed, acceleration, jerk), rate)
    first = np.diff(retimed.q, axis=0) * rate
    second = np.diff(first, axis=0) * rate
    third = np.diff(second, axis=0) * rate
    assert np.abs(first).max() < 1.001 * speed
    assert np.abs(second).max() < 1.001 * acceleration
    assert np.abs(third).max() < 1.001 * jerk
    assert np.abs(np.diff(fast.smoothed(0.0, rate).q, 3, axis=0)).max() * rate**3 > jerk
    np.testing.assert_allclose(retimed.q[[0, -1]], fast.q[[0, -1]], atol=1e-6)
    assert fast.duration < retimed.duration < 2.5 * fast.duration
    back = np.maximum.accumulate(retimed.q[:, 0]) - retimed.q[:, 0]
    assert back.max() < 0.001  # no motion backward at the start, and no overshoot at the end
    with pytest.raises(pliant.ConfigError, match="above 0"):
        retime(fast, (1.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("m.json", "{", "m.json is not a motion file: Expecting"),
        (
            "m.json",
            '{"format": "pliant motion 1"}',
            "m.json is not a motion file: it has no 'samples'",
        ),
        ("m.mcap", "junk", "m.mcap is not a log of pliant: it does not begin as MCAP does"),
        ("m.mcap", "\x89MCAP0\r\n", "m.mcap is not a log of pliant: it ends before"),
    ],
)
def test_an_invalid_file_is_named_with_the_reason(tmp_path, capsys, name, text, message):
    pytest.importorskip("mcap")
    (tmp_path / name).write_bytes(text.encode("latin-1"))
    assert main(["replay", "so101", str(tmp_path / name), "--backend", "sim"]) == 2
    assert message in capsys.readouterr().err


def test_a_missing_file_is_named_with_those_that_are_there(tmp_path, capsys):
    wave().save(tmp_path / "wave.json")
    assert main(["replay", "so101", str(tmp_path / "wav.json"), "--backend", "sim"]) == 2
    assert "wav.json; there are wave.json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--soft", "y=-2"], "--soft y=-2: a cap is a number from 0 up"),
        (["--soft", "y=nan"], "got nan"),
        (["--soft", "y=1 y=2"], "--soft 'y=1 y=2' names y twice"),
        (["--stop", "0.1"], "stop [N] = 0.1 is outside [1.87, ∞): this arm"),
        (["--speed", "50"], "speed must be in [0.05, 3]"),
        (["--max-wait", "0"], "--max-wait must be above 0 s, got 0"),
    ],
)
def test_bad_flags_of_replay_are_named(tmp_path, capsys, flags, message):
    wave().save(tmp_path / "wave.json")
    file = str(tmp_path / "wave.json")
    assert main(["replay", "so101", file, "--backend", "sim", *flags]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(("flags", "limit"), [(["--max-wait", "2"], 2), ([], 30)])
def test_a_replay_that_stays_blocked_ends_with_an_error(tmp_path, capsys, caplog, flags, limit):
    """An axis without force does not follow the motion: its clock would wait without end."""
    wave().save(tmp_path / "wave.json")
    command = ["replay", "so101", str(tmp_path / "wave.json"), "--backend", "sim", "--soft", "y=0"]
    assert main([*command, *flags]) == 2
    captured = capsys.readouterr()
    assert f"the motion has paused for {limit} s (--max-wait)" in captured.err
    assert "was lowered" in caplog.text
    words = re.search(r"played 0 times of 1 in ([\d.]+) s, waited ([\d.]+) s", captured.out)
    duration, waited = map(float, words.groups())
    assert limit <= waited <= duration < limit + 10.0
    # The state lines have the time of the loop, at which the pause began.
    begin = float(re.findall(r"([\d.]+) s  blocked", captured.out)[-1])
    assert begin + limit == pytest.approx(duration, abs=0.1)


@pytest.mark.parametrize("backend", ["sim", "emulator"])
def test_the_command_plays_and_logs(tmp_path, backend, capsys, monkeypatch):
    pytest.importorskip("rustypot")
    pytest.importorskip("mcap")
    monkeypatch.setattr("sys.stdin", io.StringIO())
    file, log = tmp_path / "m.json", tmp_path / "run.mcap"
    short = Motion(NAMES, [0.0, 0.4], [[0.0] * 5, [0.08] + [0.0] * 4], {"gripper": [0.1, 0.2]})
    short.save(file)
    arm = left_enabled(tmp_path)
    flags = ["--backend", backend, "--soft", "y=2", "--log", str(log)]
    assert main(["replay", arm, str(file), *flags]) == 0
    assert "done" in capsys.readouterr().out
    assert main(["log", "verify", str(log)]) == 0
    assert "bit for bit" in capsys.readouterr().out
    assert main(["replay", arm, str(file), "--backend", backend, "--soft", "y=a"]) == 2
    assert main(["replay", arm, str(log), "--backend", backend, "--stop", "0.01"]) == 2


def assert_scripted_motion(file):
    """Check that the file contains the motion of the scripted hand."""
    motion = Motion.load(file)
    model = pliant.robots.so101()
    tool = np.array([model.forward_kinematics(q)[:3, 3] for q in motion.q])
    displacement = tool[-1] - tool[0]
    assert displacement[1] == pytest.approx(lead.SIDE_SHARE * model.reach, abs=0.02)
    assert displacement[2] > 0.005


# The test with the emulator is in tests/cli/test_between_ticks.py.
def test_the_command_teaches_with_a_scripted_hand(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    file = tmp_path / "m.json"
    assert (
        main(["teach", left_enabled(tmp_path), str(file), "--backend", "sim", "--scripted-hand"])
        == 0
    )
    assert "pliant replay" in capsys.readouterr().out
    assert_scripted_motion(file)


def test_no_scripted_hand_leads_a_real_arm(tmp_path, capsys):
    file = tmp_path / "m.json"
    assert main(["teach", "so101", str(file), "--scripted-hand"]) == 2
    assert "simulated arms only" in capsys.readouterr().err


def test_the_command_teaches_nothing_without_a_hand(tmp_path, capsys):
    file = tmp_path / "m.json"
    flags = ["teach", "so101", str(file), "--backend", "sim", "--duration", "1"]
    assert main(flags) == 2
    captured = capsys.readouterr()
    assert "do not touch" in captured.out
    # The message also comes before the descent, which the user may leave by Ctrl-C.
    assert "not taught: nothing moved" in captured.out
    assert "nothing moved" in captured.err
    assert not file.exists()
    assert main(["teach", "so101", str(tmp_path / "m.txt"), "--backend", "sim"]) == 2
    assert main(["teach", "arm7", str(file), "--by", "gripper"]) == 2


def test_a_motion_is_handed_out_if_the_last_message_cannot_be_shown():
    course = ForceProfile(start=9.0, rise=2.0, end=11.5)
    hand = Drag(axis="y", distance=0.06, stiffness=2000.0, limit=60.0, at="tool", course=course)
    motions = []

    def on_status(line):
        if line.startswith("kept"):
            raise BrokenPipeError

    with (
        bare_arm("so101", q=START, scene=[hand], on_exit="leave_enabled") as arm,
        pytest.raises(BrokenPipeError),
    ):
        record(arm, idle_timeout=1.0, on_status=on_status, on_interrupt=motions.append)
    (motion,) = motions
    assert 1.5 < motion.trimmed().duration < 3.5


def test_a_motion_whose_file_cannot_be_written_is_kept_elsewhere(tmp_path, capsys, monkeypatch):
    file, save, other = tmp_path / "m.json", Motion.save, tmp_path / "tmp"
    other.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(other))

    def fail(motion, path):
        if path == file:
            raise OSError(28, "No space left on device")
        save(motion, path)

    monkeypatch.setattr(Motion, "save", fail)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    arm = left_enabled(tmp_path)
    assert main(["teach", arm, str(file), "--backend", "sim", "--scripted-hand"]) == 2
    (kept,) = other.iterdir()
    error = " ".join(capsys.readouterr().err.split())
    assert f"{file}: No space left on device. The motion is in {kept}" in error
    assert_scripted_motion(kept)
    motion = Motion.load(kept)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))
    with pytest.raises(OSError, match="disk full"):
        _save_elsewhere(motion, file, OSError("disk full"))


def test_teaching_begins_with_the_leads_that_hold_the_arm():
    """The joints are half as stiff as assumed."""
    model = descent.robot("so101")
    q, truth = descent.random_parameters(model, 2, seed=SWING_SEED)[1]
    assert truth.stiffness == (0.5,) * 5
    truth = replace(truth, load=0.0)
    case = descent.Case(arm="so101", number=1, over_table=False, q=tuple(q), truth=truth)
    with descent.simulated_arm(case) as (arm, _):
        arm.enable()
        state = arm.read()
        begun = Teacher(arm).step(state).goal - state.q
        assumed = np.asarray(model.gravity(state.q)) / model.servos.kp
        assert np.abs(arm.leads - assumed).max() > 0.05
        assert begun == pytest.approx(arm.leads, abs=0.01)
        arm.disable_torque()
