"""Errors when a servo bus is opened, with their remedies."""

import re
import time
from types import SimpleNamespace

import pytest

from pliant import ServoError
from pliant.emulator import Device, Emulator, Timing
from pliant.servo import BusError, ServoBus, ServoSpec, transport
from pliant.servo import _device as driver
from pliant.servo._handshake import (
    RegisterImage,
    _adapter_note,
    _broken,
    _calibration_notes,
    identify,
)
from pliant.servo._transactions import Reply
from pliant.servo.models import Block


def opened(bus, *specs, **options):
    specs = [ServoSpec(port=bus.port, **spec) for spec in specs]
    with ServoBus(specs, reply_timeout_min=0.03, **options) as servo_bus:
        return servo_bus


def complaint(parts, *specs, **options):
    with Emulator(parts, clock="steps", **options) as bus:
        with pytest.raises(ServoError) as error:
            opened(bus, *specs)
        assert not bus.log.writes()
    return str(error.value)


PAN = {"name": "pan", "model": "STS3215-7.4V", "id": 1, "lower": -1.0, "upper": 1.0}
LIFT = {**PAN, "name": "lift", "id": 2}
ELBOW = {"name": "elbow", "model": "XM430-W350", "id": 3, "lower": -1.0, "upper": 1.0}


def test_a_missing_servo_is_named_with_those_that_answer():
    text = complaint([Device("STS3215", id=1), Device("STS3215", id=7)], PAN, LIFT)
    assert "lift (id 2)" in text
    assert "ids that answer: 1, 7" in text


def test_a_device_that_sends_by_itself_is_named():
    with Emulator([Device("STS3215", id=1)]) as bus:
        bus.hum()
        with pytest.raises(ServoError, match=r"never silent: .* a device that sends by itself"):
            opened(bus, PAN)


def test_a_servo_at_another_baud_rate_is_looked_for_by_a_scan():
    text = complaint([Device("STS3215", id=1), Device("STS3215", id=2, baud_rate=1)], PAN, LIFT)
    assert re.search(r"lift \(id 2\).* `pliant servos scan` finds .* another baud rate", text)


def test_a_servo_that_falls_silent_after_it_was_identified_is_named(emulated, monkeypatch):
    with emulated("sts", 2, is_open=False) as (bus, servo_bus):
        identify = ServoBus.identify

        def fall_silent(self):
            found = identify(self)
            bus.faults.inject("deaf", id=2, count=10**6)
            return found

        monkeypatch.setattr(ServoBus, "identify", fall_silent)
        with pytest.raises(ServoError, match=r"joint1 \(id 2\) .* no answer.*; check plug"):
            servo_bus.open()


def test_a_silent_bus_points_to_power_port_and_baud():
    text = complaint([Device("STS3215", id=1, baud_rate=3)], PAN)
    assert "no servo answers" in text
    assert "baud" in text


def test_another_model_is_named():
    text = complaint([Device("MX-28", id=1)], {**PAN, "model": "MX-64"})
    assert "it is MX-28, the configuration says MX-64 (310)" in text


def test_all_complaints_come_at_once():
    parts = [
        Device("XM430-W350", id=3),
        Device("XM430-W350", id=4, operating_mode=5, drive_mode=0b1000),
    ]
    text = complaint(parts, ELBOW, {**ELBOW, "name": "wrist", "id": 4})
    assert "elbow (id 3" in text
    assert "operating mode 3, needed is 5" in text
    assert "wrist (id 4" in text
    assert "switches its torque on by a goal" in text


def test_a_shadow_id_is_refused():
    part = Device("XM430-W350", id=3, operating_mode=5, secondary_id=4)
    assert "obeys id 4 as well" in complaint([part], ELBOW)


def test_a_wrong_supply_is_refused():
    with Emulator([Device("STS3215-7.4V", id=1, max_voltage_limit=140)], clock="steps") as bus:
        bus.supply(12.0)
        with pytest.raises(ServoError, match=r"12\.0 V and STS3215-7\.4V takes"):
            opened(bus, PAN)


def test_a_wrong_supply_is_told_once_where_the_servos_measure_it_differently():
    parts = [Device("STS3215-7.4V", id=number, max_voltage_limit=140) for number in (1, 2)]
    with Emulator(parts, clock="steps") as bus:
        bus.supply(12.0)
        refresh = bus.servos[0].refresh
        bus.servos[0].refresh = lambda: (refresh(), bus.servos[0].put("present_voltage", 121))
        with pytest.raises(ServoError) as error:
            opened(bus, PAN, LIFT)
    (text,) = str(error.value).splitlines()
    assert text.startswith("pan (id 1), lift (id 2) on ")
    assert ": their supply is 12.0 to 12.1 V and STS3215-7.4V takes" in text


@pytest.mark.parametrize(
    ("limits", "told"),
    [({"min_voltage_limit": 90}, "9 to 8 V"), ({"max_voltage_limit": 60}, "4 to 6 V")],
)
def test_voltage_limits_that_exclude_the_right_supply_are_told(limits, told):
    text = complaint([Device("STS3215-7.4V", id=1, **limits)], PAN)
    sheet = "STS3215-7.4V takes 3.5 to 8.9 V"
    assert f"is 7.4 V and the voltage limits in the EEPROM are {told} ({sheet}): wrong" in text


def test_a_servo_that_answers_pings_only_is_not_taken_for_a_missing_one():
    parts = [Device("XL430-W250", id=number) for number in (1, 2, 3)]
    with Emulator(parts, clock="steps") as bus:
        for servo in bus.servos[:2]:
            servo.put("status_return_level", 0)
        specs = [{**spec, "model": "XL430-W250"} for spec in (PAN, LIFT, {**ELBOW, "id": 7})]
        with pytest.raises(ServoError) as error:
            opened(bus, *specs)
    silent, mute = str(error.value).splitlines()
    assert "from elbow (id 7); ids that answer: 1, 2, 3." in silent
    assert mute.startswith("pan (id 1), lift (id 2) on ")
    assert "a ping but no read, as with Status Return Level 0" in mute


def test_a_register_that_was_not_read_has_no_value():
    device = driver.Device(ServoSpec(name="pan", model="MX-64", id=1, port=""), 0, 1, 1)
    image = RegisterImage(device, Reply(Block(36, 2), b"\7\1", 0, 0.0))
    assert image["position"] == 263
    assert "goal" in image
    with pytest.raises(KeyError, match="goal"):
        _ = image["goal"]


def test_a_range_across_the_seam_is_refused():
    text = complaint([Device("STS3215", id=1)], {**PAN, "zero": 100.0})
    assert "across the seam" in text
    assert "mount the horn" in text


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"lower": -90.0, "upper": 57.3}, "these look like degrees: write -1.57 and 1"),
        ({"lower": 1000.0, "upper": 3000.0}, "these look like counts"),
        ({"zero": 180.0}, "zero is in counts: if 180 is in degrees, write 2048; else check zero"),
        ({"zero": 3.0}, "zero is in counts: if 3 is in rad, write 1956; else check zero"),
        ({"zero": 20.0}, "encoder that ends at 0 and 4095: check zero and sign"),
    ],
)
def test_a_range_in_another_unit_is_recognised(change, expected):
    text = complaint([Device("STS3215", id=1)], {**PAN, **change})
    assert "across the seam" in text
    assert re.search(expected, text)
    assert ("mount the horn" in text) == ("check zero" in expected)


def test_wheel_mode_is_refused():
    spec = {**PAN, "model": "RX-64"}
    text = complaint([Device("RX-64", id=1, ccw_angle_limit=0)], spec)
    assert "wheel" in text


def test_two_servos_on_one_id():
    parts = [Device("STS3215", id=1, angle=1.0), Device("STS3215", id=1, angle=2.0)]
    text = complaint(parts, PAN)
    assert "pan" in text
    assert "Two servos on one id" in text


@pytest.mark.parametrize(
    ("count", "all_of_them", "is_the_line"),
    [(1, True, False), (2, True, True), (2, False, False), (3, True, True)],
)
def test_broken_replies_of_all_servos_point_to_the_line(count, all_of_them, is_the_line):
    error = BusError("broken answer", "corrupt")
    broken = [(SimpleNamespace(name=f"joint{i}"), error) for i in range(count)]
    texts = _broken(SimpleNamespace(path="port"), broken, all_of_them=all_of_them)
    assert ["every answer is broken" in text for text in texts] == (
        [True] if is_the_line else [False] * count
    )
    assert all("Two servos on one id" in text for text in texts) is not is_the_line


def test_a_noisy_line_is_reported_once():
    asked = []

    def read(number, *_, **__):
        asked.append(number)
        raise BusError("the line is never silent", "noisy")

    devices = [
        driver.Device(ServoSpec(name=f"joint{i}", model="MX-64", id=i, port=""), 0, i, 1)
        for i in (1, 2)
    ]
    guard = SimpleNamespace(start_cycle=lambda: None, find_unused_id=lambda *_: None, read=read)
    port = SimpleNamespace(path="port", devices=devices, guard=guard, highest=253)
    with pytest.raises(ServoError, match=r"\Aport: the line is never silent\Z"):
        identify(port)
    assert asked == [1]


@pytest.mark.parametrize(
    ("model", "drive_mode", "number", "has_note"),
    [
        ("STS3215-7.4V", 1, 1, True),
        ("STS3215-7.4V", 0, 1, False),
        ("STS3215-7.4V", 1, 2, False),  # the calibration file describes the first servo only
        ("XM430-W350", 1, 1, False),  # the servo has a register for the direction
    ],
)
def test_an_inverted_joint_of_a_calibration_file_is_noted(model, drive_mode, number, has_note):
    spec = ServoSpec(name="pan", model=model, id=1, port="", secondary=(2, 1))
    object.__setattr__(spec, "calibration", SimpleNamespace(drive_mode=drive_mode))
    notes = _calibration_notes(driver.Device(spec, 0, number, 1))
    assert ["drive_mode 1" in note for note in notes] == [True] * has_note


@pytest.mark.parametrize(("ports", "shown"), [([], "none: is the"), (["a", "b"], "a, b$")])
def test_a_port_that_is_not_there(monkeypatch, ports, shown):
    monkeypatch.setattr(transport, "serial_ports", lambda: ports)
    servo_bus = ServoBus([ServoSpec(port="/dev/ttyNOWHERE", **PAN)])
    with pytest.raises(ServoError, match=f"no port /dev/ttyNOWHERE; there are: {shown}"):
        servo_bus.open()


def test_a_port_that_is_taken():
    with Emulator([Device("STS3215", id=1)], clock="steps") as bus:
        spec = ServoSpec(port=bus.port, **PAN)
        refusal = pytest.raises(ServoError, match="in use by another arm or bus of this")
        with ServoBus([spec], reply_timeout_min=0.03), refusal:
            ServoBus([spec], reply_timeout_min=0.03).open()


def test_ceilings_and_gains_are_the_servos_own():
    parts = [Device("STS3215", id=1, max_torque_limit=500, p_coefficient=16, overload_torque=25)]
    with Emulator(parts, clock="steps") as bus:
        servo_bus = opened(bus, PAN)
        # The error has closed the bus; the servo parameters that it had read remain available.
        assert servo_bus.servos.max_torque[0] == pytest.approx(1.91 / 2, rel=0.01)
        assert servo_bus.servos.kp[0] == pytest.approx(5.1, rel=0.01)
        assert servo_bus.overload[0] == pytest.approx(0.5)
        assert "Max Torque is set to 50%" in servo_bus.found[0].notes[0]


@pytest.mark.parametrize(("gain", "kp"), [(None, 6.0), (32, 6.0), (16, 12.0), (64, 3.0)])
def test_an_identified_stiffness_follows_the_gain_register(gain, kp):
    with Emulator([Device("STS3215", id=1, p_coefficient=32)], clock="steps") as bus:
        servo_bus = opened(bus, {**PAN, "kp": 6.0, "gain": gain})
        assert servo_bus.servos.kp[0] == pytest.approx(kp)
        assert servo_bus.servos.stiffness_known


def test_notes_list_the_changes_of_setup():
    with Emulator([Device("XM430-W350", id=3, operating_mode=5)], clock="steps") as bus:
        servo_bus = opened(bus, ELBOW)
    notes = " ".join(servo_bus.found[0].notes)
    assert "clear bit 5 of Shutdown" in notes
    assert "500 µs" in notes


@pytest.mark.parametrize(
    ("model", "options"), [("XM430-W350", {"operating_mode": 5}), ("MX-64", {}), ("STS3215", {})]
)
def test_a_servo_that_was_set_up_has_no_notes(model, options):
    if model != "STS3215":
        options = {**options, "shutdown": 0b10100, "return_delay_time": 0}
    with Emulator([Device(model, id=1, **options)], clock="steps") as bus:
        name = "STS3215-7.4V" if model == "STS3215" else model
        assert opened(bus, {**PAN, "model": name}).found[0].notes == ()


#: Emulated model and its name in a spec.
XM, XL, STS = ("XM430-W350",) * 2, ("XL430-W250",) * 2, ("STS3215", "STS3215-7.4V")
EX, RX, MX = ("EX-106+",) * 2, ("RX-64",) * 2, ("MX-64",) * 2


@pytest.mark.parametrize(
    ("model", "registers", "expected"),
    [
        (XM, {"operating_mode": 4}, "operating mode 4, needed is 5"),
        (XM, {"operating_mode": 5, "drive_mode": 1}, None),  # reverse direction is allowed
        (XM, {"operating_mode": 5, "drive_mode": 2}, "(bit 1)"),
        (XM, {"operating_mode": 5, "drive_mode": 4}, "(bit 2)"),
        (XM, {"operating_mode": 5, "drive_mode": 8}, "(bit 3)"),
        (XM, {"operating_mode": 5, "secondary_id": 252}, "obeys id 252"),
        (XM, {"operating_mode": 5, "secondary_id": 253}, None),
        (XM, {"operating_mode": 5, "startup_configuration": 1}, "torque on after every restart"),
        (XL, {"startup_configuration": 3}, "torque on after every restart"),
        (XL, {"startup_configuration": 2}, None),
        (XL, {"operating_mode": 3}, None),
        (XL, {"operating_mode": 4}, None),
        (XL, {"operating_mode": 5}, "operating mode 5, needed is 3 or 4"),
        (STS, {"operating_mode": 1}, "operating mode 1, needed is 0"),
        (STS, {"i_coefficient": 3}, "its I gain is 3"),
        (STS, {"response_level": 1}, None),
        (STS, {"response_level": 0}, "Status Return Level"),
        (EX, {"drive_mode": 2}, "slave of a dual joint"),
        (EX, {"drive_mode": 1}, None),
        (RX, {"cw_angle_limit": 5, "ccw_angle_limit": 5}, "wheel or multi-turn mode"),
        (RX, {"cw_angle_limit": 5, "ccw_angle_limit": 900}, None),
        (MX, {"status_return_level": 1}, "Status Return Level"),
        (STS, {"p_coefficient": 0}, "its register gain is 0"),
        (STS, {"max_torque_limit": 0}, "its register max_torque is 0"),
        (MX, {"max_torque": 0}, "its register max_torque is 0"),
        (XL, {"pwm_limit": 0}, "its register pwm_limit is 0"),
        (XM, {"operating_mode": 5, "pwm_limit": 0}, "its register pwm_limit is 0"),
        (XM, {"operating_mode": 5, "current_limit": 0}, "its register current_limit is 0"),
        (STS, {"min_position_limit": 3000, "max_position_limit": 1000}, "limits are reversed"),
        (XM, {"operating_mode": 5, "min_position_limit": 3000, "max_position_limit": 9}, None),
    ],
)
def test_registers_that_do_not_allow_control_are_named(model, registers, expected):
    part, spec = Device(model[0], id=1, **registers), {**PAN, "model": model[1]}
    if expected is None:
        with Emulator([part], clock="steps") as bus:
            opened(bus, spec)
    else:
        assert expected in complaint([part], spec)


@pytest.mark.parametrize(
    ("limits", "volts", "fits"),
    [
        # The data sheet says 6.5 to 12 V; 0.5 V more or less is the tolerance of a measurement.
        ({}, 6.0, True),
        ({}, 5.9, False),
        ({}, 12.5, True),
        ({}, 12.6, False),
        ({"max_voltage_limit": 110}, 11.0, True),
        ({"max_voltage_limit": 110}, 11.1, False),
        ({"min_voltage_limit": 100}, 10.0, True),
        ({"min_voltage_limit": 100}, 9.9, False),
    ],
)
def test_a_supply_fits_both_data_sheet_and_eeprom(limits, volts, fits):
    with Emulator([Device("XL430-W250", id=1, **limits)], clock="steps") as bus:
        bus.supply(volts)
        spec = {**PAN, "model": "XL430-W250"}
        if fits:
            assert opened(bus, spec).found[0].voltage == pytest.approx(volts)
            return
        with pytest.raises(
            ServoError, match=rf"its supply is {volts} V.*voltage limits in the EEPROM"
        ):
            opened(bus, spec)


@pytest.mark.parametrize(
    ("model", "registers", "expected"),
    [
        (XM, {"pwm_limit": 443}, "PWM Limit is set to 50%"),
        (XM, {"pwm_limit": 885}, None),
        (XM, {"current_limit": 400}, "Current Limit is set to"),
        (XM, {"current_limit": 1193}, None),
        (XM, {"return_delay_time": 10}, None),
        (XM, {"return_delay_time": 11}, "22 µs before each answer"),
        (MX, {"return_delay_time": 250}, "500 µs before each answer"),
        (STS, {"return_delay_time": 250}, None),
        (MX, {"shutdown": 0b110100}, "it shuts off on overload"),
        (MX, {"max_torque": 512}, "Max Torque is set to 50%"),
        (XM, {"torque_enable": 1}, "torque is on already"),
    ],
)
def test_settings_that_weaken_or_delay_a_servo_are_noted(model, registers, expected):
    quiet = {} if model == STS else {"shutdown": 0b10100, "return_delay_time": 0}
    mode = {"operating_mode": 5} if model == XM else {}
    enabled = registers == {"torque_enable": 1}  # in RAM: a new servo has no torque
    eeprom = quiet | mode | ({} if enabled else registers)
    with Emulator([Device(model[0], id=1, **eeprom)], clock="steps") as bus:
        bus.servos[0].put("torque_enable", int(enabled))
        found = opened(bus, {**PAN, "model": model[1]}).found[0]
    assert [expected in note for note in found.notes] == [True] * (expected is not None)
    assert found.torque_on is enabled


@pytest.mark.parametrize(
    ("model", "registers", "low", "high"),
    [
        (STS, {"min_position_limit": 1000, "max_position_limit": 3000}, 1000, 3000),
        (STS, {"min_position_limit": 0, "max_position_limit": 0}, 0, 4095),
        (
            XL,
            {"operating_mode": 3, "min_position_limit": 100, "max_position_limit": 4000},
            100,
            4000,
        ),
        # In a mode with several turns, the range is one turn about the zero.
        (
            XL,
            {"operating_mode": 4, "min_position_limit": 1000, "max_position_limit": 3000},
            0,
            4095,
        ),
        (RX, {"cw_angle_limit": 100, "ccw_angle_limit": 900}, 100, 900),
    ],
)
def test_goals_stay_in_the_range_of_the_registers(model, registers, low, high):
    with (
        Emulator([Device(model[0], id=1, **registers)], clock="steps") as bus,
        ServoBus(
            [ServoSpec(name="pan", model=model[1], id=1, port=bus.port)], reply_timeout_min=0.1
        ) as servo_bus,
    ):
        goals = []
        servo_bus.enable(servo_bus.read().position, [0.3])
        for goal in (-3.3, 3.3):
            servo_bus.write([goal], [0.3])
            servo_bus.read()
            goals.append(bus.servos[0].get("goal_position"))
    assert goals == [low, high]


@pytest.mark.parametrize(
    ("held_back", "timer", "expected", "latency"),
    [
        (0.016, None, "comes 16 ms later", 0.016),
        (0.016, 0.001, "comes 16 ms later", 0.016),
        (0.009, 0.016, "latency timer of port is 16 ms", 0.016),
        (0.007, None, "", None),
        (0.007, 0.002, "latency timer of port is 2 ms", 0.002),
        (0.007, 0.001, "", 0.001),
    ],
)
def test_an_adapter_that_delays_replies_is_named(held_back, timer, expected, latency):
    guard = SimpleNamespace(held_back=held_back, latency=timer)
    port = SimpleNamespace(path="port", latency=timer, guard=guard)
    note = _adapter_note(port)
    assert expected in note
    assert bool(note) is bool(expected)
    assert port.latency == guard.latency == latency


@pytest.mark.parametrize("model", ["STS3215", "XM430-W350", "MX-64"])
def test_the_latency_of_an_adapter_is_measured_and_reported(model):
    parts = [
        Device(model, id=i, return_delay_time=0, **({"operating_mode": 5} if "XM" in model else {}))
        for i in range(1, 4)
    ]
    with Emulator(parts, timing=Timing(wire=True, usb_latency=0.016)) as bus:
        specs = [ServoSpec(name=f"joint{i}", model=model, id=i, port=bus.port) for i in range(1, 4)]
        with ServoBus(specs) as servo_bus:
            notes = servo_bus.found[0].notes
            assert any("ms later than the wire takes" in note for note in notes)
            assert any("reacts late and sinks" in note for note in notes)
            ok = [servo_bus.read().ok.all() for _ in range(20)]
    # With an unknown adapter latency, every reply would time out before it arrives.
    assert sum(ok) > 12
    with Emulator(parts, timing=Timing(wire=True)) as bus:
        servo_bus = opened(bus, *({"name": s.name, "model": model, "id": s.id} for s in specs))
        assert not any("later than the wire" in note for note in servo_bus.found[0].notes)


def test_an_unexpected_speed_unit_is_noted():
    with Emulator([Device("STS3215", id=1, phase=0b1000)], clock="steps") as bus:
        assert "speed caps are void" in opened(bus, PAN).found[0].notes[0]


def test_the_extra_is_named_where_it_is_missing(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "rustypot", None)
    servo_bus = ServoBus([ServoSpec(port="p", **PAN)])
    with pytest.raises(ImportError, match=r"pip install 'pliant\[servo\]'"):
        servo_bus.open()


def test_another_transport_can_be_passed_in(fake_bus):
    opened_with = []

    class Patient(fake_bus):
        def ping(self, id):
            # For a missing servo the driver waits for a timeout in real time.
            time.sleep(0.0 if id in self.memory else self.timeout)
            return super().ping(id)

    def fake(port, baudrate, protocol):
        opened_with.append((port, baudrate, protocol))
        return Patient([1])

    servo_bus = ServoBus([ServoSpec(port="p", **PAN)], transport=fake, baudrate=57_600)
    with pytest.raises(ServoError, match="model number 0"):
        servo_bus.open()
    assert opened_with == [("p", 57_600, "p1")]
