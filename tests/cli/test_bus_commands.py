"""Commands `scan`, `setup`, `doctor` and `run` with emulated servos and the simulator."""

import json
import os
import signal

import pytest

from pliant import config
from pliant.cli import main
from pliant.config.factory import make_emulator
from pliant.emulator import Device, Emulator
from pliant.servo import eeprom

rustypot = pytest.importorskip("rustypot")

TOML = """
robot.builtin = "koch"
[[port]]
path = "{port}"
[servo]
shoulder_pan = {{ model = "XM430-W350", id = 1 }}
shoulder_lift = {{ model = "XM430-W350", id = 2, secondary = {{ id = 3 }} }}
elbow_flex = {{ model = "XL430-W250", id = 4 }}
wrist_flex = {{ model = "XL430-W250", id = 5 }}
wrist_roll = {{ model = "XL430-W250", id = 6 }}
"""
MODELS = ("XM430-W350",) * 3 + ("XL430-W250",) * 3


@pytest.fixture
def arm(tmp_path):
    """Yield emulated servos with factory settings, and the configuration file of their arm."""
    devices = [Device(model, id=i) for i, model in enumerate(MODELS, 1)]
    with Emulator(devices) as bus:
        file = tmp_path / "arm.toml"
        file.write_text(TOML.format(port=bus.port))
        yield bus, file


def test_scan_names_every_servo(arm, capsys):
    bus, _ = arm
    assert main(["servos", "scan", "--port", bus.port, "--baud", "1000000"]) == 0
    out = capsys.readouterr().out
    assert out.count("XM430-W350") == 3
    assert out.count("XL430-W250") == 3
    assert not bus.log.eeprom_writes()


def test_scan_without_servos_lists_what_to_check(arm, capsys):
    bus, _ = arm
    assert main(["servos", "scan", "--port", bus.port, "--baud", "57600"]) == 2
    assert "power" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["deaf", "lose", "late", "corrupt"])
def test_setup_asks_again_where_a_packet_is_lost(arm, tmp_path, kind, capsys):
    bus, file = arm
    for number in range(1, 7):
        for skip in (0, 5, 9):
            bus.faults.inject(kind, number, skip=skip)
    backup = tmp_path / "old.json"
    assert main(["servos", "setup", str(file), "--backup", str(backup), "--yes"]) == 0
    requests = [fault for packet in bus.log for fault in packet.faults]
    assert len(requests) >= 12, "packets were lost"
    count = len(json.loads(backup.read_text())["changes"])
    assert f"{count} registers written and read back" in capsys.readouterr().out
    assert main(["servos", "setup", str(file)]) == 0
    assert "nothing to change" in capsys.readouterr().out


def test_setup_shows_asks_writes_and_undoes(arm, tmp_path, capsys, monkeypatch):
    bus, file = arm
    backup = tmp_path / "old.json"
    flags = ["servos", "setup", str(file), "--backup", str(backup)]
    monkeypatch.setattr("builtins.input", lambda *_: "n")
    assert main(flags) == 1
    assert not bus.log.eeprom_writes()
    assert not backup.exists()

    assert main([*flags, "--yes"]) == 0
    registers = {(w.id, w.address) for w in bus.log.eeprom_writes()}
    assert {(i, 9) for i in range(1, 7)} <= registers, "return delay of every servo"
    assert {(i, 11) for i in (1, 2, 3)} <= registers, "operating mode of the current-limited"
    old = json.loads(backup.read_text())
    assert old["arm"] == str(file)
    old = old["changes"]
    assert {c["model"] for c in old} == set(MODELS)
    shutdown = next(c for c in old if c["register"] == "shutdown")
    assert shutdown["old"] & 32
    assert not shutdown["new"] & 32
    assert main(["servos", "setup", str(file)]) == 0
    assert "nothing to change" in capsys.readouterr().out

    assert main(["servos", "setup", str(file), "--undo", str(backup), "--yes"]) == 0
    assert main([*flags, "--yes"]) == 2, "the first backup is not overwritten"


@pytest.mark.parametrize("name", ["so101", "koch", "arm7"])
def test_emulated_arms_are_set_up_already(name, capsys):
    with make_emulator(config.load(name)) as bus:
        ports = [flag for port in bus.ports.values() for flag in ("--port", port)]
        assert main(["servos", "setup", name, *ports]) == 0
    assert "nothing to change" in capsys.readouterr().out


def test_setup_reports_a_missing_backup(arm, tmp_path, capsys):
    _, file = arm
    assert (
        main(["servos", "setup", str(file), "--yes", "--backup", str(tmp_path / "old.json")]) == 0
    )
    capsys.readouterr()
    backup = tmp_path / "new.json"
    assert main(["servos", "setup", str(file), "--yes", "--backup", str(backup)]) == 0
    assert "nothing to change; no backup is written" in capsys.readouterr().out
    assert not backup.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["servos", "setup", "so101", "--undo", "nope.json"],
        ["run", "so101", "--backend", "sim", "--targets", "nope.json"],
    ],
)
def test_a_missing_file_comes_before_ports_and_names_those_there_are(
    arguments, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.json").write_text("")
    assert main(arguments) == 2
    assert "there is no file nope.json; there are other.json" in capsys.readouterr().err


def test_setup_leaves_servos_with_torque_alone(arm, capsys):
    bus, file = arm
    host = rustypot.Xl430PyController(bus.port, 1_000_000, 0.2)
    host.write_raw_data_with_error(2, 64, [1])
    host.close()
    before = len(bus.log.eeprom_writes())
    assert (
        main(["servos", "setup", str(file), "--yes", "--backup", str(file.with_suffix(".json"))])
        == 2
    )
    assert "torque of shoulder_lift (id 2) is on" in capsys.readouterr().err
    assert len(bus.log.eeprom_writes()) == before, "no servo is changed"
    assert not file.with_suffix(".json").exists()


def test_a_register_that_does_not_take_its_value_does_not_stop_setup(arm, tmp_path, capsys):
    bus, file = arm
    bus.stick(2, "return_delay_time", 250)
    flags = ["servos", "setup", str(file), "--yes", "--backup"]
    assert main([*flags, str(tmp_path / "old.json")]) == 2
    error = capsys.readouterr().err
    assert "shoulder_lift (id 2): return_delay reads 250 after 0 was written" in error
    assert "the same command shows what is left to write" in error
    values = [servo.get("return_delay_time") for servo in bus.servos]
    assert values == [0, 250, 0, 0, 0, 0]
    assert all(not servo.get("shutdown") & 32 for servo in bus.servos)
    bus.stick(2, "return_delay_time", None)
    assert main([*flags, str(tmp_path / "old.json")]) == 2
    assert "exists, and keeps the old values in it" in capsys.readouterr().err
    assert main([*flags, str(tmp_path / "more.json")]) == 0
    assert "1 registers written and read back" in capsys.readouterr().out


def test_a_servo_that_loses_its_power_does_not_stop_setup_of_the_others(arm, tmp_path, capsys):
    bus, file = arm
    flags = ["servos", "setup", str(file), "--yes", "--backup"]

    def watch(transaction):
        if any(write.eeprom and write.id == 2 for write in transaction.writes):
            bus.servo(2).plugged = False

    bus.log.watch = watch
    assert main([*flags, str(tmp_path / "old.json")]) == 2
    out, error = capsys.readouterr()
    assert "id 2: no answer: is it powered? `pliant servos scan` lists" in error
    assert "old values in" in out
    assert [servo.get("return_delay_time") for servo in bus.servos[2:]] == [0] * 4


def test_ctrl_c_leaves_a_backup_and_says_how_to_go_on(arm, tmp_path, capsys, monkeypatch):
    bus, file = arm
    write, count = eeprom._write, []

    def interrupted(*arguments):
        count.append(arguments)
        if len(count) == 4:
            raise KeyboardInterrupt
        write(*arguments)

    flags = ["servos", "setup", str(file), "--yes", "--backup"]
    with monkeypatch.context() as patch:
        patch.setattr(eeprom, "_write", interrupted)
        assert main([*flags, str(tmp_path / "old.json")]) == 130
    out, error = capsys.readouterr()
    assert "old.json; this puts them back: pliant servos setup" in out
    assert "registers written" not in out
    assert "interrupted: the same command shows what is left to write" in error
    written = len(bus.log.eeprom_writes())
    assert 0 < written < 4
    total = len(json.loads((tmp_path / "old.json").read_text())["changes"])
    assert main([*flags, str(tmp_path / "more.json")]) == 0
    assert f"{total - written} registers written and read back" in capsys.readouterr().out


def test_doctor_finds_settings_that_setup_repairs(arm, capsys):
    bus, file = arm
    assert main(["servos", "doctor", str(file)]) == 2
    out = " ".join(capsys.readouterr().out.split())
    assert "operating mode 3, needed is 5" in out
    assert (
        main(["servos", "setup", str(file), "--yes", "--backup", str(file.with_suffix(".json"))])
        == 0
    )
    capsys.readouterr()
    main(["servos", "doctor", str(file)])
    out = capsys.readouterr().out
    assert "operating mode" not in out
    assert "6 answer" in out
    bus.supply(24.0)
    assert main(["servos", "doctor", str(file)]) == 2
    assert "24.0 V" in capsys.readouterr().out


def test_run_on_the_simulator_lowers_the_arm(capsys):
    assert main(["run", "koch", "--backend", "sim", "--soft", "y", "--duration", "1"]) == 0
    assert "100 ticks" in capsys.readouterr().out


def test_an_unknown_soft_axis_gets_the_axes_of_the_task(capsys):
    assert main(["run", "so101", "--backend", "sim", "--soft", "y yaw"]) == 2
    stderr = capsys.readouterr().err
    assert "--soft 'yaw': yaw is not an axis of the task, which has x, y, z; task in" in stderr


def test_run_follows_a_file(tmp_path, capsys):
    file = tmp_path / "targets.jsonl"
    file.write_text('{"q": [0.1, 0, 0, 0, 0]}\n' * 50)
    assert main(["run", "so101", "--backend", "sim", "--targets", str(file), "--quiet"]) == 0
    assert "250 ticks" in capsys.readouterr().out


#: Models and EEPROM values with which `open` fails and names the remedy `pliant servos setup`.
REPAIRABLE = [
    ("XM430-W350", {"operating_mode": 3}),
    ("XM430-W350", {"operating_mode": 5, "drive_mode": 0b10}),
    ("XM430-W350", {"operating_mode": 5, "drive_mode": 0b100}),
    ("XM430-W350", {"operating_mode": 5, "drive_mode": 0b1000}),
    ("XM430-W350", {"operating_mode": 5, "secondary_id": 9}),
    ("XL430-W250", {"operating_mode": 1}),
    ("STS3215", {"operating_mode": 1}),
    ("STS3215", {"response_level": 0}),
    ("RX-64", {"ccw_angle_limit": 0}),
    ("MX-64", {"cw_angle_limit": 4095}),
    ("MX-64", {"status_return_level": 1}),
    ("EX-106+", {"drive_mode": 2}),
]


JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


def write_arm(file, bus, model):
    """Write the file of an SO-101 with servos of a model; return their name in the table."""
    table = {"STS3215": "STS3215-7.4V"}.get(model, model)
    lines = [f'{name} = {{ model = "{table}", id = {i} }}' for i, name in enumerate(JOINTS, 1)]
    head = ['robot.builtin = "so101"', "[[port]]", f'path = "{bus.port}"', "[servo]"]
    file.write_text("\n".join(head + lines))
    return table


@pytest.mark.parametrize(("model", "registers"), REPAIRABLE)
def test_setup_repairs_and_restores_what_open_rejects(model, registers, tmp_path, capsys):
    from pliant import ServoError
    from pliant.servo import ServoBus, ServoSpec

    file, backup = tmp_path / "arm.toml", tmp_path / "old.json"
    with Emulator([Device(model, id=i, **registers) for i in range(1, 6)]) as bus:
        table = write_arm(file, bus, model)
        before = [bytes(servo.stored) for servo in bus.servos]
        servo_bus = ServoBus(
            [ServoSpec(name=n, model=table, id=i, port=bus.port) for i, n in enumerate(JOINTS, 1)]
        )
        with pytest.raises(ServoError, match="`pliant servos setup`"):
            servo_bus.open()
        assert main(["servos", "setup", str(file), "--yes", "--backup", str(backup)]) == 0
        servo_bus.open()
        servo_bus.close()
        assert main(["servos", "setup", str(file), "--yes", "--undo", str(backup)]) == 0
        assert [bytes(servo.stored) for servo in bus.servos] == before


@pytest.mark.parametrize("model", ["STS3215", "XL430-W250", "MX-64"])
def test_a_servo_gets_an_id_of_its_own(model, tmp_path, capsys, monkeypatch):
    file = tmp_path / "arm.toml"
    with Emulator([Device(model, id=1), Device(model, id=2)]) as bus:
        write_arm(file, bus, model)
        setup = ["servos", "setup", str(file), "--set-id"]
        for pair, message in [
            ("1", "OLD:NEW"),
            ("1:1", "the same"),
            ("1:77", "id 77 is not the id of exactly one joint"),
            ("1:2", "answers to id 2 already"),
            ("9:5", "no answer: is it powered? `pliant servos scan` lists"),
        ]:
            assert main([*setup, pair, "--yes"]) == 2
            assert message in capsys.readouterr().err
        monkeypatch.setattr("builtins.input", lambda *_: "n")
        assert main([*setup, "1:5"]) == 1
        assert not bus.log.eeprom_writes()
        assert main([*setup, "1:5", "--yes"]) == 0
        assert "wrist_roll answers to id 5 now" in capsys.readouterr().out
        assert [servo.id for servo in bus.servos] == [5, 2]
        bus.reboot(5)
        assert bus.servos[0].id == 5, "it survives the loss of power"


def test_an_id_that_was_changed_without_an_answer_is_found(tmp_path, capsys):
    file = tmp_path / "arm.toml"
    with Emulator([Device("STS3215", id=1), Device("STS3215", id=2)]) as bus:
        write_arm(file, bus, "STS3215")

        def watch(transaction):
            if any("id" in write.values for write in transaction.writes):
                bus.log.watch = None
                bus.faults.inject("lose", 5, count=1000)

        bus.log.watch = watch
        setup = ["servos", "setup", str(file), "--set-id", "1:5", "--yes"]
        assert main(setup) == 2
        error = " ".join(capsys.readouterr().err.split())
        assert "id 1 may not have become id 5: " in error
        assert "`pliant servos scan` lists ids" in error
        bus.faults.clear()
        assert main(setup) == 2
        error = " ".join(capsys.readouterr().err.split())
        assert (
            "answers to id 5 already: connect only the one that is to get it, unless it has it now"
            in error
        )


def test_an_id_of_two_servos_is_not_changed(tmp_path, capsys):
    file = tmp_path / "arm.toml"
    servos = [Device("STS3215", id=1, angle=1.0), Device("STS3215", id=1, angle=2.0)]
    with Emulator(servos) as bus:
        write_arm(file, bus, "STS3215")
        assert main(["servos", "setup", str(file), "--set-id", "1:5", "--yes"]) == 2
        assert "Two servos on one id look like this" in capsys.readouterr().err
        assert not bus.log.writes()


def test_a_feetech_servo_that_restarts_while_it_is_set_up_is_reported(tmp_path, capsys):
    file = tmp_path / "arm.toml"
    with Emulator([Device("STS3215", id=i, operating_mode=1) for i in range(1, 6)]) as bus:
        write_arm(file, bus, "STS3215")

        def watch(transaction):
            if transaction.id == 2 and any("lock" in write.values for write in transaction.writes):
                bus.log.watch = None
                bus.servo(2).power_up()  # its EEPROM is locked again

        bus.log.watch = watch
        setup = ["servos", "setup", str(file), "--yes", "--backup"]
        assert main([*setup, str(tmp_path / "old.json")]) == 2
        error = " ".join(capsys.readouterr().err.split())
        assert "shoulder_lift (id 2) restarted: switch the supply off and on" in error
        bus.servo(2).power_up()
        assert [servo.get("operating_mode") for servo in bus.servos] == [0, 1, 0, 0, 0]
        assert main([*setup, str(tmp_path / "more.json")]) == 0
        bus.servo(2).power_up()
        assert bus.servo(2).get("operating_mode") == 0


@pytest.mark.parametrize(
    ("register", "is_set_id"), [("lock", False), ("mode", False), ("lock", True), ("id", True)]
)
def test_ctrl_c_leaves_the_eeprom_of_a_feetech_servo_locked(
    register, is_set_id, tmp_path, monkeypatch
):
    file, write = tmp_path / "arm.toml", eeprom._write

    def interrupted(io, number, family, name, value):
        write(io, number, family, name, value)
        if name == register and value != 1:
            raise KeyboardInterrupt

    with Emulator([Device("STS3215", id=i, operating_mode=1) for i in range(1, 6)]) as bus:
        write_arm(file, bus, "STS3215")
        file.write_text(file.read_text().replace("id = 5", "id = 7" if is_set_id else "id = 5"))
        monkeypatch.setattr(eeprom, "_write", interrupted)
        flags = ["--set-id", "5:7"] if is_set_id else ["--backup", str(tmp_path / "old.json")]
        assert main(["servos", "setup", str(file), "--yes", *flags]) == 130
        assert [servo.get("lock") for servo in bus.servos] == [1] * 5


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize("is_set_id", [False, True])
def test_a_signal_leaves_the_eeprom_of_a_feetech_servo_locked(
    name, is_set_id, tmp_path, monkeypatch, capsys
):
    file, write, number = tmp_path / "arm.toml", eeprom._write, getattr(signal, name)
    before = signal.getsignal(number)

    def signalled(io, id, family, register, value):
        write(io, id, family, register, value)
        # The signals also come while the EEPROM is being locked again.
        if register == "lock":
            os.kill(os.getpid(), number)

    with Emulator([Device("STS3215", id=i, operating_mode=1) for i in range(1, 6)]) as bus:
        write_arm(file, bus, "STS3215")
        file.write_text(file.read_text().replace("id = 5", "id = 7" if is_set_id else "id = 5"))
        monkeypatch.setattr(eeprom, "_write", signalled)
        flags = ["--set-id", "5:7"] if is_set_id else ["--backup", str(tmp_path / "old.json")]
        assert main(["servos", "setup", str(file), "--yes", *flags]) == 128 + number
        assert [servo.get("lock") for servo in bus.servos] == [1] * 5
        if not is_set_id:
            assert [servo.get("operating_mode") for servo in bus.servos] == [0, 1, 1, 1, 1]
            assert "the same command shows what is left" in capsys.readouterr().err
    assert signal.getsignal(number) == before
