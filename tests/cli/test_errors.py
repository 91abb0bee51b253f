"""Mistakes of a new user, and the error messages of the command line and `pliant.connect`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from subprocess import PIPE

import pytest
from programs import Program

import pliant
from pliant.cli import main
from pliant.emulator import Device, Emulator
from pliant.servo.transport import RustypotTransport

rustypot = pytest.importorskip("rustypot", reason="the bus needs the extra servo")

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
HEAD = 'robot.builtin = "so101"\nsettings.task = "xyz"\n[[port]]\npath = "{port}"\n[servo]\n'

#: Program that keeps a port open until its standard input ends.
HOLD_PORT = """
import rustypot, sys
port = rustypot.MxPyController(sys.argv[1], 1_000_000, 0.1)
print("open", flush=True)
sys.stdin.read()
"""


def toml(port, *, joints=JOINTS, model="STS3215-7.4V", extra=""):
    lines = [f'{name} = {{ model = "{model}", id = {i} }}' for i, name in enumerate(joints, 1)]
    return HEAD.format(port=port) + "\n".join(lines) + "\n" + extra


@pytest.fixture
def error_texts(tmp_path, capsys):
    """Return a function that returns the errors of three commands for a configuration text."""

    def ask(text):
        file = tmp_path / "arm.toml"
        file.write_text(text)
        capsys.readouterr()
        assert main(["run", str(file), "--quiet", "--duration", "1"]) == 2
        run_error = capsys.readouterr().err
        assert "Traceback" not in run_error
        assert main(["servos", "doctor", str(file)]) == 2
        doctor = capsys.readouterr()
        with (
            pytest.raises(pliant.PliantError) as error,
            pliant.connect(file, handle_signals=False),
        ):
            pass
        return [
            " ".join(text.split())
            for text in (run_error, doctor.out + doctor.err, str(error.value))
        ]

    return ask


def all_say(texts, *fragments):
    for text in texts:
        for fragment in fragments:
            assert fragment in text, text


def servos(*ids, **registers):
    return [Device("STS3215", id=i, **registers) for i in ids]


def test_a_task_with_too_many_axes_names_the_table_of_the_file(tmp_path, capsys):
    file = tmp_path / "arm.toml"
    file.write_text(toml("/none").replace('settings.task = "xyz"\n', ""))
    assert main(["run", str(file), "--quiet", "--duration", "1"]) == 2
    assert "`task` in [settings], as in" in " ".join(capsys.readouterr().err.split())


def test_wrong_port(error_texts):
    all_say(
        error_texts(toml("/dev/ttyNOWHERE7")), "there is no port /dev/ttyNOWHERE7", "there are:"
    )


def test_no_permission(error_texts, monkeypatch):
    def refuse(*_):
        raise OSError("Permission denied")

    monkeypatch.setattr(rustypot, "MxPyController", refuse)
    all_say(
        error_texts(toml("/dev/ttyUSB3")),
        "no permission to open /dev/ttyUSB3",
        "usermod -aG dialout",
    )


def test_port_in_use(error_texts):
    with Emulator(servos(1, 2, 3, 4, 5)) as bus:
        own = RustypotTransport(bus.port, 1_000_000, "p1")
        all_say(error_texts(toml(bus.port)), "is in use by another arm or bus", "close() it")
        own.close()
        with subprocess.Popen(
            [sys.executable, "-c", HOLD_PORT, bus.port], stdin=PIPE, stdout=PIPE
        ) as other:
            assert other.stdout.readline()
            all_say(error_texts(toml(bus.port)), "is in use by another program", "close it")


def test_wrong_baud(error_texts):
    with Emulator(servos(1, 2, 3, 4, 5), baud=115_200) as bus:
        all_say(
            error_texts(toml(bus.port)),
            "no servo answers",
            "baud rate",
            "`pliant servos scan`",
            "power on",
        )


def test_missing_id(error_texts):
    with Emulator(servos(1, 2, 4, 5, 9)) as bus:
        texts = error_texts(toml(bus.port))
    all_say(texts, "no answer", "elbow_flex (id 3)", "ids that answer: 1, 2, 4, 5, 9", "plug")


def test_two_servos_on_one_id(error_texts):
    with Emulator(servos(1, 2, 3, 3, 4, 5)) as bus:
        all_say(error_texts(toml(bus.port)), "elbow_flex", "Two servos on one id", "one by one")


def test_new_servos_that_all_have_one_id_are_seen_by_scan(capsys):
    with Emulator(servos(1, 1, 1, 2)) as bus:
        assert main(["servos", "scan", "--port", bus.port, "--baud", "1000000"]) == 0
    output = " ".join(capsys.readouterr().out.split())
    assert "two servos on this id?" in output
    assert "`pliant servos setup ARM --set-id OLD:NEW`" in output


def test_a_low_voltage_servo_on_12_volts(error_texts):
    with Emulator(servos(1, 2, 3, 4, 5)) as bus:
        bus.supply(12.0)
        texts = error_texts(toml(bus.port))
    all_say(
        texts, "their supply is 12.0 V", "STS3215-7.4V takes", "wrong supply", "another variant"
    )
    # The message appears once for all five servos.
    assert texts[0].count("wrong supply") == 1
    assert "shoulder_pan (id 1), shoulder_lift (id 2)" in texts[0]


def test_what_several_servos_have_in_common_is_noted_once(tmp_path, capsys):
    models = ["XL430-W250"] * 5
    file = tmp_path / "arm.toml"
    with Emulator([Device(m, id=i, return_delay_time=0) for i, m in enumerate(models, 1)]) as bus:
        file.write_text(toml(bus.port, model="XL430-W250"))
        main(["servos", "doctor", str(file)])
    out = " ".join(capsys.readouterr().out.split())
    assert out.count("it shuts off on overload") == 1
    assert "note " + ", ".join(JOINTS) + ": it shuts off on overload" in out


def test_a_motion_is_no_calibration(tmp_path, capsys):
    file = tmp_path / "wave.json"
    file.write_text('{"format": 1, "joints": ["a"], "samples": []}')
    assert main(["servos", "doctor", "so101", "--backend", "sim", "--calibration", str(file)]) == 2
    out = " ".join(capsys.readouterr().out.split())
    assert "wave.json is not a calibration file: LeRobot's has a table of id," in out
    assert "what is under format, joints, samples is not a table" in out


@pytest.mark.parametrize("rate", ["-1", "333"])
def test_an_invalid_rate_is_reported_before_a_link_is_printed(rate, capsys):
    pytest.importorskip("mjviser", reason="the page needs the extra view")
    assert main(["view", "--rate", rate]) == 2
    captured = capsys.readouterr()
    assert "http" not in captured.out
    assert rate.lstrip("-") in captured.err


@pytest.mark.parametrize("page", ["0", "-1", "99999999"])
def test_a_page_on_no_port_is_refused(page, capsys):
    assert main(["view", "--http-port", page]) == 2
    assert f"--http-port is a port from 1 to 65535, got {page}" in capsys.readouterr().err


@pytest.mark.parametrize("duration", ["nan", "-1", "0"])
def test_an_emulator_without_a_duration_that_can_be_is_refused(duration, capsys):
    assert main(["servos", "emulate", "so101", "--duration", duration]) == 2
    assert f"--duration must be above 0 s, got {duration}" in capsys.readouterr().err


def test_an_emulator_that_is_ended_leaves_nothing(tmp_path):
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with Program("-m", "pliant.cli", "servos", "emulate", "so101", env=environment) as running:
        assert "tty-main" in running.stdout.readline()
        assert list(tmp_path.iterdir())
        running.send_signal(signal.SIGTERM)
        assert running.wait(timeout=30) == 128 + signal.SIGTERM
    assert not list(tmp_path.iterdir())


def test_the_emulator_starts_first_and_reports_late_replies(monkeypatch, capsys):
    pytest.importorskip("mujoco", reason="the arm behind the bytes needs the extra sim")
    requests = []
    monkeypatch.setattr(os, "nice", requests.append)
    latencies = iter([0.001, 0.150, 0.160, *[0.350] * 1000])
    monkeypatch.setattr(Emulator, "max_latency", property(lambda _: next(latencies)))
    assert main(["servos", "emulate", "so101", "--duration", "1"]) == 0
    assert requests == [-10]
    out = " ".join(capsys.readouterr().out.split())
    assert "a reply was sent 150 ms late" in out
    assert "a reply was sent 350 ms late" in out
    assert out.count("this computer is busy") == 2


def test_another_model(error_texts):
    with Emulator(servos(1, 2, 3, 4, 5)) as bus:
        texts = error_texts(toml(bus.port, model="MX-28"))
    all_say(texts, "it is no MX-28", "`pliant servos scan`", "the configuration says MX-28")


def test_a_typo_in_the_file(error_texts, tmp_path):
    typo = toml("/dev/ttyUSB0").replace("[[port]]", "[[prot]]").replace('"so101"', '"so101"')
    with pytest.raises(pliant.ConfigError, match="prot is not a key here; did you mean 'port'"):
        pliant.config.parse(typo)
    file = tmp_path / "typo.toml"
    file.write_text(typo)
    for argv in (["run", str(file)], ["servos", "doctor", str(file)]):
        assert main(argv) == 2


def test_a_typo_in_a_model_or_unit(tmp_path, capsys):
    file = tmp_path / "arm.toml"
    file.write_text(toml("/dev/x", model="STS3512-7.4V"))
    assert main(["run", str(file)]) == 2
    assert "STS3215-7.4V" in capsys.readouterr().err
    file.write_text(toml("/dev/x", extra="[loop]\nrate = -5\n"))
    assert main(["run", str(file)]) == 2
    assert "loop.rate = -5" in capsys.readouterr().err


def test_file_and_urdf_disagree(error_texts):
    names = ("shoulder_pan", "shoulder_lft", "elbow_flex", "wrist_flex", "wrist_roll")
    texts = error_texts(toml("/dev/ttyUSB0", joints=names))
    all_say(texts, "file and URDF disagree", "no servo for shoulder_lift", "shoulder_lft")
    all_say(texts, "The chain has shoulder_pan, shoulder_lift")


def test_torque_that_is_already_on_is_reported_and_kept(tmp_path, capsys):
    file = tmp_path / "arm.toml"
    with Emulator(servos(1, 2, 3, 4, 5)) as bus:
        file.write_text(toml(bus.port))
        host = rustypot.MxPyController(bus.port, 1_000_000, 0.2)
        host.write_raw_data_with_error(2, 40, [1])
        host.close()
        main(["servos", "doctor", str(file)])
        out = " ".join(capsys.readouterr().out.split())
        assert "shoulder_lift: its torque is on already" in out
        assert main(
            ["servos", "setup", str(file), "--yes", "--backup", str(tmp_path / "b.json")]
        ) in {0, 2}
        with pliant.connect(file, handle_signals=False, comm_timeout=5.0) as arm:
            bus.log.clear()
            arm.read()
            arm.disable_torque()
        steps = [w.values["torque_enable"] for w in bus.log.writes("torque_enable", id=2)]
        assert steps == [0], "switched off by disable_torque alone"


@pytest.mark.parametrize("command", [["run", "--quiet"], ["view", "--http-port", "8943"]])
def test_invalid_settings_are_reported_before_torque_comes_on(
    command, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(pliant.arm.Arm, "enable", lambda _: pytest.fail("torque came on"))
    file = tmp_path / "arm.toml"
    file.write_text('backend = "sim"\nrobot.builtin = "so101"\n')
    assert main([command[0], str(file), *command[1:]]) == 2
    assert "6 axes on an arm of 5 joints" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["log", "info", "."], ". is a folder: name a file"),
        (["servos", "doctor", "/"], "/ is a folder: name a configuration file in it"),
        (["log", "verify", "x.mcap"], "x.mcap is not a log of pliant: it does not begin as MCAP"),
    ],
)
def test_the_wrong_kind_of_file_is_named_once(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.mcap").write_text("no log")
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {message}")
    assert error.count(words[-1]) == message.count(words[-1])
