"""Servos that are in no table, but have the control table of a known model."""

import json
import pickle
import re

import pytest

pytest.importorskip("rustypot", reason="servo buses need the extra servo")

import pliant
from pliant import config
from pliant.cli import main
from pliant.config import factory
from pliant.emulator import Device, Emulator
from pliant.servo import ServoBus, ServoSpec

NUMBER = 1999
TOML = """
robot.builtin = "koch"
[[port]]
path = "{port}"
[servo]
shoulder_pan = {{ model = "XL430-W250", id = 1{fields} }}
shoulder_lift = {{ model = "XL430-W250", id = 2{fields} }}
elbow_flex = {{ model = "XL430-W250", id = 3{fields} }}
wrist_flex = {{ model = "XL430-W250", id = 4{fields} }}
wrist_roll = {{ model = "XL430-W250", id = 5{fields} }}
"""
MODEL_FIELDS = f", model_number = {NUMBER}, stall = 2.8, no_load = 70.0, voltage = [9.0, 15.0]"


@pytest.fixture
def bus():
    """Return emulated servos with factory settings and a model number that no table has."""
    with Emulator([Device("XL430-W250", i, model_number=NUMBER) for i in range(1, 6)]) as bus:
        yield bus


def test_the_error_names_the_number_and_the_line_that_fixes_it(bus):
    arm_config = config.parse(TOML.format(port=bus.port, fields=""))
    servo_bus = factory.make_bus(arm_config, {"main": bus.port})
    with pytest.raises(pliant.ServoError, match=f"model number {NUMBER}, which is in no") as error:
        servo_bus.open()
    line = re.search(r"add `(.*?)`", str(error.value))[1]
    fixed = config.parse(TOML.format(port=bus.port, fields=f", {line}"))
    with factory.make_bus(fixed, {"main": bus.port}) as servo_bus:
        assert [info.model for info in servo_bus.found] == ["XL430-W250"] * 5


def test_the_values_of_the_file_replace_those_of_the_model(bus):
    arm_config = config.parse(TOML.format(port=bus.port, fields=MODEL_FIELDS))
    assert arm_config.model().servos.max_torque == pytest.approx(2.8)
    with factory.make_bus(arm_config, {"main": bus.port}) as servo_bus:
        spec = servo_bus.specs[0]
        assert (spec.row.model_number, spec.row.voltage) == (NUMBER, (9.0, 15.0))
        assert spec.row.no_load == ((spec.row.rated, 70.0),)
        copy = pickle.loads(pickle.dumps(servo_bus.closed_copy()))  # as the guardian gets it
        assert copy.specs[0].row.model_number == NUMBER
    bus.supply(8.0)
    # The allowed range is that of the file ±0.5 V, within the EEPROM limits of an XL430 (14 V).
    with (
        pytest.raises(pliant.ServoError, match=r"takes 8\.5 to 14 V"),
        factory.make_bus(arm_config, {"main": bus.port}),
    ):
        pass


def test_its_eeprom_is_set_up_and_restored(bus, tmp_path, capsys):
    file, backup = tmp_path / "arm.toml", tmp_path / "old.json"
    file.write_text(TOML.format(port=bus.port, fields=MODEL_FIELDS))
    assert main(["servos", "setup", str(file), "--backup", str(backup), "--yes"]) == 0
    assert json.loads(backup.read_text())["changes"]
    assert main(["servos", "setup", str(file), "--undo", str(backup), "--yes"]) == 0
    assert bus.servo(1).get("return_delay_time") == 250
    capsys.readouterr()


def test_the_emulator_answers_with_the_number_of_the_file():
    text = TOML.format(port="auto", fields=MODEL_FIELDS)
    with factory.make_emulator(config.parse(text, backend="emulator"), clock="steps") as emulated:
        arm_config = config.parse(text, port=emulated.port)
        with factory.make_bus(arm_config, {"main": emulated.port}) as servo_bus:
            assert len(servo_bus.found) == 5


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"model_number": 1060}, None),
        ({"model_number": 777}, "777 is that of STS3215-7.4V, not of a servo"),
        ({"no_load": -1.0}, "no_load must be above 0 rpm, got -1"),
        ({"no_load": float("nan")}, "no_load must be above 0 rpm, got nan"),
        ({"voltage": (12.0, 6.0)}, r"voltage is lowest and highest \[V\], got \(12.0, 6.0\)"),
    ],
)
def test_impossible_values_are_refused(values, message):
    if message is None:
        assert ServoSpec(name="a", model="XL430-W250", id=1, port="p", **values).row.rated > 0.0
        return
    with pytest.raises(pliant.ConfigError, match=message):
        ServoSpec(name="a", model="XL430-W250", id=1, port="p", **values)


def test_a_number_of_another_model_is_an_error_of_the_file():
    extra = ", model_number = 777"
    with pytest.raises(pliant.ConfigError, match="777 is that of STS3215"):
        ServoBus(
            factory.servo_specs(config.parse(TOML.format(port="p", fields=extra)), {"main": "p"})
        )
