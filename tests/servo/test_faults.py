"""Faults of bus and servos: stale data, missing readings, error messages, jumps of the goal."""

from types import SimpleNamespace

import numpy as np
import pytest

from pliant import ServoError, ServoFaultError
from pliant._core import BusStatus, ServoCodec
from pliant.emulator import Emulator, ManualClock
from pliant.servo import BusError, ServoBus, ServoSpec, get_model
from pliant.servo._device import TRIPPED, Device
from pliant.servo._port import Port, StatusPoller
from tests.servo.conftest import JOINTS, devices

PROTOCOLS = ["sts", "xm", "mx"]


def sweep(bus, servo_bus, limit, ticks, *, speed=1.0):
    """Move all joints; yield each sample with the shaft positions at that time."""
    for k in range(ticks):
        truth = np.array([servo.shaft.angle for servo in bus.servos])
        sample = servo_bus.read()
        angle = truth - 2048 * bus.servos[0].model.count
        yield sample, angle
        goal = 0.8 * np.sin(0.01 * k * speed * np.arange(1, servo_bus.n + 1))
        servo_bus.write(goal, limit)
        servo_bus.poll_status()
        bus.advance(0.01)


@pytest.mark.parametrize("fault", ["lose", "corrupt", "truncate", "wrong_id", "noise", "deaf"])
@pytest.mark.parametrize("kind", PROTOCOLS)
def test_one_fault_costs_a_retry_and_no_sample(emulated, enabled, kind, fault):
    with emulated(kind, 3, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        for _ in sweep(bus, servo_bus, limit, 20):
            pass
        bus.faults.inject(fault, 2)
        truth = np.array([servo.shaft.angle for servo in bus.servos])
        sample = servo_bus.read()
        assert sample.ok.all()
        angle = truth - 2048 * bus.servos[0].model.count
        assert sample.position == pytest.approx(angle, abs=0.003)
        counters = servo_bus.counters
        assert counters["retries"] >= 1
        assert counters["drains"] >= 1
        assert counters["timeouts"] + counters["corrupt"] >= 1


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_a_servo_whose_replies_were_lost_is_read_again_within_a_time(emulated, enabled, rate):
    """Eight skipped cycles (0.4 s at 20 Hz) after the misses would exceed the wait of a loop."""
    with emulated("xl430", 3, clock="steps", rate=rate) as (bus, servo_bus):
        enabled(servo_bus)
        for _ in range(5):
            servo_bus.read()
            bus.advance(1.0 / rate)
        bus.faults.inject("lose", 2, count=6)
        answered = [bus.time]
        while bus.time < answered[0] + 1.5:
            if servo_bus.read().ok.all():
                answered.append(bus.time)
            bus.advance(1.0 / rate)
        assert max(np.diff(answered)) < 0.4


@pytest.mark.parametrize("kind", PROTOCOLS)
def test_late_answers_are_never_taken_for_new_ones(emulated, enabled, kind):
    with emulated(kind, 3, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        worst, valid = 0.0, 0
        for k, (sample, truth) in enumerate(sweep(bus, servo_bus, limit, 60)):
            if sample.ok.any():
                worst = max(worst, np.abs(sample.position - truth)[sample.ok].max())
                valid += 1
            if k % 4 == 1:
                bus.faults.inject("late", 1 + k % 3, count=1 + k % 2)
        # A sample that is one tick old would be wrong by up to 0.8 * 3 * 0.01 = 0.024 rad.
        assert worst < 0.003
        assert valid > 40
        assert servo_bus.counters["timeouts"] > 5


@pytest.mark.parametrize("kind", PROTOCOLS)
def test_a_dead_servo_does_not_silence_the_others(emulated, enabled, kind):
    with emulated(kind, 4, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        for _ in sweep(bus, servo_bus, limit, 5):
            pass
        bus.unplug(2)
        others = np.array([True, False, True, True])
        ok_by_tick = [sample.ok for sample, _ in sweep(bus, servo_bus, limit, 12)]
        assert all((ok == others).all() for ok in ok_by_tick)
        bus.plug(2)
        bus.advance(0.5)
        ok_by_tick = [sample.ok for sample, _ in sweep(bus, servo_bus, limit, 12)]
        assert ok_by_tick[-1].all()


def test_a_dead_servo_is_not_asked_in_every_cycle(emulated, enabled):
    with emulated("sts", 3, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        bus.unplug(3)
        for _ in range(3):
            servo_bus.read()
        before = servo_bus.counters["timeouts"]
        for _ in range(16):
            servo_bus.read()
        assert servo_bus.counters["timeouts"] - before <= 3


def test_a_servo_that_lost_its_torque_is_noticed(emulated, enabled):
    for kind in PROTOCOLS:
        with emulated(kind, 2, clock="steps") as (bus, servo_bus):
            enabled(servo_bus)
            bus.reboot(1)
            bus.advance(0.5)
            faults = []
            for _ in range(30):
                servo_bus.read()
                faults += getattr(servo_bus.poll_status(), "faults", ())
            assert any("joint0: its torque went off by itself" in text for text in faults)
            assert not any("joint1" in text for text in faults)


@pytest.mark.parametrize("kind", PROTOCOLS)
def test_torque_that_went_off_is_noticed_within_a_few_ticks(emulated, enabled, kind):
    with emulated(kind, 6, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        for index in (6, 3):
            for k in range(12 + index):
                servo_bus.read()
                servo_bus.write(np.full(6, 0.001 * k), limit)
                servo_bus.poll_status()
                bus.advance(0.01)
            bus.servo(index).put("torque_enable", 0)
            bus.log.clear()
            message = ""
            # Protocol 1.0 and Feetech poll all servos within six ticks.
            for _ in range(4 if kind == "xm" else 6):
                servo_bus.read()
                message += str(servo_bus.poll_status())
                bus.advance(0.01)
            assert f"joint{index - 1}: its torque went off" in message
            bus.servo(index).put("torque_enable", 1)
            enabled(servo_bus)


def test_one_port_unplugged_leaves_the_other_to_be_brought_down(enabled):
    parts = [*devices("sts", 1), *devices("sts", 3, port="b")[1:]]
    with Emulator(parts, clock="steps") as bus:
        ports = [bus.ports["main"], bus.ports["b"], bus.ports["b"]]
        specs = [
            ServoSpec(
                name=f"joint{i}", model="STS3215-7.4V", id=i + 1, port=port, lower=-1.0, upper=1.0
            )
            for i, port in enumerate(ports)
        ]
        with ServoBus(specs, reply_timeout_min=0.1, clock=ManualClock(bus)) as servo_bus:
            limit = enabled(servo_bus)
            bus.pull("b")
            faults = []
            for k in range(20):
                sample = servo_bus.read()
                assert sample.ok.tolist() == [True, False, False]
                servo_bus.write(np.full(3, 0.01 * k), limit)
                faults += getattr(servo_bus.poll_status(), "faults", ())
                bus.advance(0.01)
            assert "joint1: its port" in str(faults[:2])
            motion = bus.servo(1).get("goal_position") - 2048
            assert motion == round(0.19 / bus.servo(1).model.count)
            with pytest.raises(ServoError, match=r"torque may still be on: .*is gone"):
                servo_bus.disable()
            assert not bus.servo(1).enabled
            bus.pull("main")
            for call in (servo_bus.read, servo_bus.poll_status):
                with pytest.raises(BusError, match="is gone"):
                    call()


def test_overload_is_reported_as_a_sentence(emulated, enabled):
    for kind in PROTOCOLS:
        with emulated(kind, 2, clock="steps") as (bus, servo_bus):
            limit = enabled(servo_bus)
            bus.trip(2, "overload")
            faults = []
            for _ in range(4):
                servo_bus.read()
                faults += getattr(servo_bus.poll_status(), "faults", ())
            assert any("joint1: overload" in text for text in faults), kind
            servo_bus.write([0.0, 0.0], limit)


def test_a_latched_servo_is_not_enabled_and_reboot_clears_it(emulated, enabled):
    with emulated("xm", 1, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        bus.trip(1, "overload")
        servo_bus.read()
        with pytest.raises(ServoFaultError, match=r"off and on, .*ServoBus\.reboot\('joint0'\)"):
            enabled(servo_bus)
    with emulated("xm", 1) as (bus, servo_bus):  # a servo takes real time to boot
        enabled(servo_bus)
        bus.trip(1, "overload")
        servo_bus.reboot("joint0")
        assert not servo_bus.enabled.any()
        enabled(servo_bus)
        assert servo_bus.enabled.all()


@pytest.mark.parametrize("kind", PROTOCOLS)
def test_a_servo_that_is_about_to_switch_off_gets_no_torque(emulated, enabled, kind):
    with emulated(kind, 2, clock="steps") as (bus, servo_bus):
        servo = bus.servo(2)
        limit = servo.get("temperature_limit")
        assert servo_bus.temperature_limit.tolist() == [limit] * 2
        servo.temperature = limit - 2.0
        message = f"joint1: it is at {limit - 2} °C and switches off at {limit}: let it cool"
        with pytest.raises(ServoFaultError, match=message):
            enabled(servo_bus)
        assert not bus.log.goals_while_disabled()
        servo_bus.identify()
        assert servo_bus.enable_errors == {"joint1": f"{message[8:]} before its torque comes on"}
        servo.temperature = limit - 3.0
        enabled(servo_bus)
        servo.temperature = limit - 1.0
        enabled(servo_bus)  # accepted, because the servo already has torque


@pytest.mark.parametrize("kind", PROTOCOLS)
def test_a_temperature_limit_that_no_servo_stays_below_is_named(emulated, enabled, kind):
    with emulated(kind, 1, clock="steps", is_open=False) as (bus, servo_bus):
        bus.servo(1).put("temperature_limit", 0)
        servo_bus.open()
        message = "it is at 25 °C and switches off at 0: its Temperature Limit is wrong"
        with pytest.raises(ServoFaultError, match=message):
            enabled(servo_bus)


@pytest.mark.parametrize("kind", ["xm", "xl430", "mx", "ex"])
def test_an_overload_that_leaves_the_torque_on_is_no_fault(emulated, enabled, kind):
    # `pliant servos setup` clears bit 5 of Shutdown; the servo still reports the overload.
    with emulated(kind, 2, clock="steps", is_open=False) as (bus, servo_bus):
        for id in (1, 2):
            servo = bus.servo(id)
            servo.put("shutdown", servo.get("shutdown") & ~0x20)
        servo_bus.open()
        limit = enabled(servo_bus)

        def faults():
            found = []
            for _ in range(40):
                servo_bus.read()
                servo_bus.write([0.0, 0.0], limit)
                found += getattr(servo_bus.poll_status(), "faults", ())
                bus.advance(0.01)
            return found

        bus.trip(1, "overload")
        assert not faults()
        assert bus.servo(1).get("torque_enable") == 1
        servo_bus.disable()
        notes = [note for servo in servo_bus.identify() for note in servo.notes]
        assert ("it was overloaded after its last reboot, and kept its torque" in notes) == (
            kind in {"xm", "xl430"}
        )
        enabled(servo_bus)
        assert servo_bus.enabled.all()
        bus.servo(1).temperature = 100.0
        assert any("joint0: too hot" in text for text in faults())


@pytest.mark.parametrize("trips", [(1, 2), (2, 1), (1,), (2,)])
@pytest.mark.parametrize("kind", ["xm", "mx"])
def test_overloads_of_both_servos_of_a_joint_are_no_fault(emulated, enabled, kind, trips):
    """The servos share the load: both report an overload before the first cause is read."""
    with Emulator(devices(kind, 2), clock="steps") as bus:
        for id in (1, 2):
            bus.servo(id).put("shutdown", bus.servo(id).get("shutdown") & ~0x20)
        spec = ServoSpec(
            name="lift",
            model=JOINTS[kind][1],
            id=1,
            port=bus.port,
            secondary=(2, 1),
            lower=-1.0,
            upper=1.0,
        )
        with ServoBus([spec], reply_timeout_min=0.1, clock=ManualClock(bus)) as servo_bus:
            limit, found = enabled(servo_bus), []
            for tick in range(40):
                servo_bus.read()
                servo_bus.write([0.0], limit)
                found += getattr(servo_bus.poll_status(), "faults", ())
                bus.advance(0.01)
                if tick == 10:
                    for id in trips:
                        bus.trip(id, "overload")
                if tick == 30:
                    assert not found
                    bus.servo(trips[0]).temperature = 100.0
            assert any("lift" in text and "too hot" in text for text in found)


def test_protocol_1_has_no_reboot(emulated):
    refusal = pytest.raises(ServoError, match="MX-64 has no reboot")
    with emulated("mx", 1, clock="steps") as (_, servo_bus), refusal:
        servo_bus.reboot("joint0")


def test_a_limit_that_the_servo_does_not_take_is_reported(emulated, enabled):
    with emulated("sts", 2, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        bus.stick(1, "torque_limit", 1000)
        faults = []
        for _ in range(70):
            servo_bus.read()
            servo_bus.write([0.0, 0.0], limit / 2)
            faults += getattr(servo_bus.poll_status(), "faults", ())
            bus.advance(0.01)
        message = "torque limit reads 1000 (1.91 N·m), written was 250 (0.478 N·m)"
        assert any(message in text for text in faults)
        assert servo_bus.counters["mismatches"] >= 2
        # The servo accepts its goals, so it does not count as refusing.
        assert not servo_bus.refusing.any()
        with pytest.raises(ServoError, match="did not take the torque limit"):
            enabled(servo_bus)


@pytest.mark.parametrize("kind", ["sts", "xm", "xl430", "mx"])
def test_lost_writes_are_waited_for_as_long_as_lost_answers(emulated, enabled, kind):
    with emulated(kind, 2, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        is_deaf = False
        for servo in bus.servos:
            servo.write = lambda *packet, write=servo.write: 0 if is_deaf else write(*packet)

        def run(ticks):
            faults = []
            for k in range(ticks):
                servo_bus.read()
                servo_bus.write([0.003 * k, 0.003 * k], limit * (1.0 - 0.004 * k))
                faults = getattr(servo_bus.poll_status(), "faults", faults)
                bus.advance(0.01)
                yield faults

        assert not any(run(30))
        is_deaf = True
        assert not any(run(30)), "300 ms of silence in this direction too"
        is_deaf = False
        assert not any(run(60))
        assert not servo_bus.refusing.any()
        is_deaf = True
        text = str(list(run(140)))
        assert "goal reads" in text
        assert "limit reads" in text
        assert servo_bus.refusing.all()
        is_deaf = False
        assert not list(run(60))[-1]
        assert not servo_bus.refusing.any()


def test_a_lost_packet_does_not_count_as_a_refused_limit(emulated, enabled):
    with emulated("xm", 2, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        faults = []
        for k in range(40):
            servo_bus.read()
            # No servo receives these two consecutive packets, which have different limits.
            if k in {20, 21}:
                bus.faults.inject("deaf", 1)
            servo_bus.write([0.0, 0.0], limit * (1.0 - 0.01 * k))
            faults += getattr(servo_bus.poll_status(), "faults", ())
        assert not faults
        assert servo_bus.counters["mismatches"] <= 2


def test_a_short_overload_is_counted(emulated, enabled):
    for kind in ["sts", "mx"]:
        with emulated(kind, 2, clock="steps") as (bus, servo_bus):
            limit = enabled(servo_bus)
            assert servo_bus.counters["alerts"] == 0
            bus.trip(1, "overload")
            for _ in range(4):
                servo_bus.read()
                servo_bus.write([0.0, 0.0], limit)
                bus.advance(0.01)
            assert servo_bus.counters["alerts"] == 1, kind


def test_a_supply_that_stays_too_low_is_a_fault(emulated, enabled):
    with emulated("ex", 2, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)

        def faults(seconds):
            messages = []
            for _ in range(round(seconds / 0.01)):
                servo_bus.read()
                servo_bus.write([0.0, 0.0], limit)
                messages += getattr(servo_bus.poll_status(), "faults", ())
                bus.advance(0.01)
            return messages

        bus.supply(11.0)
        assert not faults(0.4)
        bus.supply(14.8)
        assert not faults(0.4)
        bus.supply(11.0)
        texts = faults(0.8)
        assert any("its supply is 11.0 V and it needs 11.5 V" in text for text in texts)


def test_a_pulled_adapter_ends_reading_and_writing_at_once(emulated, enabled):
    with emulated("sts", 2) as (bus, servo_bus):
        limit = enabled(servo_bus)
        bus.pull()
        with pytest.raises(BusError, match="is gone"):
            servo_bus.read()
        with pytest.raises(BusError, match="is gone"):
            servo_bus.write([0.0, 0.0], limit)
        servo_bus.close()
        with pytest.raises(ServoError, match="there is no port"):
            servo_bus.open()
        bus.put_back()
        servo_bus.open()
        assert servo_bus.read().ok.all()


def test_a_reading_that_jumps_is_rejected(emulated, enabled):
    with emulated("sts", 1, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        bus.advance(0.01)
        before = servo_bus.read().position[0]
        bus.stick(1, "present_position", 3000)
        bus.advance(0.01)
        sample = servo_bus.read()
        assert not sample.ok[0]
        assert sample.position[0] == before
        assert servo_bus.counters["stale"] == 1
        # After a long gap without readings, the joint may really have moved that far.
        bus.advance(2.0)
        assert servo_bus.read().ok[0]


@pytest.mark.parametrize("step", [0.35, 0.6, 1.5])
@pytest.mark.parametrize("kind", ["sts", "xm", "mx"])
def test_an_encoder_that_steps_is_a_fault_and_always_rejected(emulated, enabled, kind, step):
    with emulated(kind, 2, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        for _ in sweep(bus, servo_bus, limit, 5, speed=0.0):
            pass
        before = servo_bus.read().position[0]
        position = bus.servos[0].position + round(step / bus.servos[0].model.count)
        bus.stick(1, "present_position", position)
        messages = []
        for _ in range(300):
            sample = servo_bus.read()
            assert not sample.ok[0]
            assert sample.position[0] == before
            servo_bus.write([0.0, 0.0], limit)
            messages.append(getattr(servo_bus.poll_status(), "faults", ()))
            bus.advance(0.01)
        assert "joint0: its position jumped by" in str(messages[:10])
        # Without torque, the joint may be moved to any position.
        servo_bus.disable()
        assert servo_bus.read().ok.all()


@pytest.mark.parametrize("turns", [-1, 1])
def test_a_single_turn_servo_that_reports_another_turn_gets_no_goal_at_the_end_of_its_encoder(
    emulated, enabled, turns
):
    with emulated("sts", 1, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        bus.advance(0.01)
        before = servo_bus.read().position[0]
        position = bus.servos[0].get("present_position")
        bus.stick(1, "present_position", position + 4096 * turns)
        messages = []
        # After a gap, the joint may have moved far, but not by a turn.
        for seconds in [*[0.01] * 10, 2.0, 0.01, 0.01]:
            bus.advance(seconds)
            sample = servo_bus.read()
            assert not sample.ok[0]
            assert sample.position[0] == before
            servo_bus.write([0.0], limit)
            messages.append(getattr(servo_bus.poll_status(), "faults", ()))
            assert abs(bus.servos[0].get("goal_position") - position) < 100
        assert "joint0: its position jumped by 6.28 rad" in str(messages)


@pytest.mark.parametrize("dead", [False, True])
def test_a_watchdog_that_trips_is_cleared_as_soon_as_it_is_seen(emulated, enabled, dead):
    with emulated("xm", 2, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        servo_bus.watchdog(0.1)
        for _ in sweep(bus, servo_bus, limit, 5):
            pass
        bus.short(dead)  # no data pass in either direction
        for _ in range(5 if dead else 1):
            servo_bus.read()
            servo_bus.write([0.0, 0.0], limit)
            bus.advance(0.1 if dead else 0.3)
        assert [servo.get("bus_watchdog") for servo in bus.servos] == [-1, -1]
        bus.short(False)
        for _ in range(15):
            servo_bus.read()
            servo_bus.write([0.1, 0.1], limit)
            assert not getattr(servo_bus.poll_status(), "faults", ())
            bus.advance(0.01)
        assert [servo.get("bus_watchdog") for servo in bus.servos] == [5, 5]
        assert bus.servos[0].get("goal_position") > 2048
        assert servo_bus.counters["trips"] == 2
        assert not servo_bus.refusing.any()


def test_a_tripped_watchdog_is_cleared_before_torque_comes_on(emulated, enabled):
    with emulated("xm", 2, clock="steps", is_open=False) as (bus, servo_bus):
        bus.servos[1].put("bus_watchdog", -1)
        servo_bus.open()
        limit = enabled(servo_bus)
        servo_bus.write([0.1, 0.1], limit)
        servo_bus.read()
        bus.sync()
        assert [servo.get("bus_watchdog") for servo in bus.servos] == [0, 0]
        assert all(servo.get("goal_position") > 2100 for servo in bus.servos)
        # No packet writes a watchdog that has not tripped.
        assert {write.id for write in bus.log.writes("bus_watchdog")} == {2}


def test_a_port_that_is_gone_delays_no_watchdog_of_another(enabled):
    parts = [*devices("xm", 1), *devices("xm", 2, port="b")[1:]]
    with Emulator(parts, clock="steps") as bus:
        specs = [
            ServoSpec(name=port, model="XM430-W350", id=i, port=bus.ports[port])
            for i, port in enumerate(("main", "b"), 1)
        ]
        with ServoBus(specs, reply_timeout_min=0.1, clock=ManualClock(bus)) as servo_bus:
            enabled(servo_bus)
            servo_bus.watchdog(0.1)
            bus.advance(0.3)
            for device in servo_bus._devices:
                device.tripped = True
            bus.pull("main")
            servo_bus.poll_status()
            bus.sync()
            assert bus.servo(2).get("bus_watchdog") == 5


def test_disable_reaches_all_although_one_is_silent(emulated, enabled):
    with emulated("sts", 3, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        bus.faults.inject("deaf", 1, count=99)
        with pytest.raises(ServoError, match="torque may still be on: joint0"):
            servo_bus.disable()
        assert [s.get("torque_enable") for s in bus.servos] == [1, 0, 0]


def test_servos_whose_torque_may_be_on_are_named_first_and_their_cause_once(emulated, enabled):
    with emulated("sts", 4, clock="steps", patience=0.03) as (bus, servo_bus):
        enabled(servo_bus)
        for number in (1, 2, 4):
            bus.faults.inject("deaf", number, count=99)
        with pytest.raises(ServoError) as error:
            servo_bus.disable()
        text = str(error.value)
        assert text.startswith("torque may still be on: joint0, joint1, joint3 did not confirm")
        assert text.count("did not confirm") == 1
    with emulated("sts", 2, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        bus.pull("main")
        with pytest.raises(ServoError, match="may still be on: joint0, joint1: the port is gone"):
            servo_bus.disable()


def test_enable_undoes_itself_when_one_servo_does_not_obey(emulated, enabled):
    with emulated("sts", 3, clock="steps") as (bus, servo_bus):
        bus.stick(3, "torque_enable", 0)
        with pytest.raises(ServoError, match="did not switch its torque on"):
            enabled(servo_bus)
        assert [s.get("torque_enable") for s in bus.servos[:2]] == [0, 0]
        assert not servo_bus.enabled.any()


def test_enable_wants_to_know_where_the_joint_is(emulated):
    with emulated("sts", 1, clock="steps") as (bus, servo_bus):
        servo_bus.read()
        with pytest.raises(ServoError, match=r"is at 0\.00 rad and not at 0\.70"):
            servo_bus.enable([0.7], [1.0])
        assert not bus.log.writes()


def test_a_servo_outside_its_range_is_not_switched_on(emulated):
    spec = {"lower": 0.3, "upper": 0.9}
    with emulated("sts", 1, clock="steps", spec=spec) as (bus, servo_bus):
        with pytest.raises(ServoError, match="would jump there: move it by hand"):
            servo_bus.enable(servo_bus.read().position, [1.0])
        assert not bus.log.writes()


@pytest.mark.parametrize("kind", ["sts", "ex"])
def test_a_servo_on_its_stop_moves_back_into_its_range(emulated, kind):
    with emulated(kind, 1, clock="steps", spec={"lower": 0.04, "upper": 0.9}) as (bus, servo_bus):
        start = servo_bus.read().position
        assert start[0] == pytest.approx(0.0, abs=0.002)
        servo_bus.enable(start, [1.0])
        for _ in range(30):
            bus.advance(0.02)
            end = servo_bus.read().position
        assert end[0] == pytest.approx(0.04, abs=0.02)


def test_a_servo_that_holds_outside_its_range_is_taken_over(emulated):
    spec = {"lower": 0.3, "upper": 0.9}
    with emulated("sts", 1, clock="steps", spec=spec) as (bus, servo_bus):
        bus.servo(1).put("torque_enable", 1)
        servo_bus.enable(servo_bus.read().position, [1.0])
        assert servo_bus.enabled.all()


def test_positions_go_on_across_the_seam(emulated, enabled):
    # A multi-turn servo with its zero near the seam, 96 counts before the end of the turn.
    spec = {"zero": 4000.0, "lower": -1.0, "upper": 1.0}
    with emulated("xm", 1, clock="steps", spec=spec) as (bus, servo_bus):
        bus.servos[0].shaft.angle = 3900 * bus.servos[0].model.count
        servo_bus.close()
        servo_bus.open()
        limit = enabled(servo_bus)
        for _ in range(30):
            servo_bus.read()
            servo_bus.write([0.5], limit)
            bus.advance(0.05)
        sample = servo_bus.read()
        assert sample.position[0] == pytest.approx(0.5, abs=0.05)
        assert bus.servos[0].shaft.angle / bus.servos[0].model.count > 4200
        # After a reboot the servo counts from within one turn again; the joint has not moved.
        bus.reboot(1)
        bus.advance(0.5)
        servo_bus.read()
        assert servo_bus.read().position[0] == pytest.approx(sample.position[0], abs=0.01)
        assert "encoder's range" not in str(polled(servo_bus))


@pytest.mark.parametrize(
    ("change", "is_cheap"),
    [
        ({}, True),
        ({"_baudrate": 57_600}, False),
        ({"_cycle": 0.001}, False),
        ({"latency": 0.001}, True),
        ({"latency": 0.002}, False),
        ({"guard": SimpleNamespace(is_gone=False, response_delay=0.0005)}, False),
        ({"guard": SimpleNamespace(is_gone=True, response_delay=0.0)}, False),
        ({"model": "STS3215-7.4V"}, False),
        ({"model": "MX-64"}, False),
    ],
)
def test_the_torque_of_all_servos_is_read_only_if_it_takes_little_of_a_cycle(change, is_cheap):
    guard = SimpleNamespace(is_gone=False, response_delay=0.0)
    port = SimpleNamespace(_baudrate=1_000_000, _cycle=0.01, latency=None, guard=guard)
    vars(port).update(change)
    family = get_model(change.get("model", "XM430-W350")).family
    port.devices = [SimpleNamespace(family=family)] * 5
    assert Port.can_read_all(port) is is_cheap


def test_a_register_is_wrong_after_three_packets_and_half_a_second():
    """A row has write packet number, value read, time [s]; counts of mismatches; True: a fault."""
    device = Device(ServoSpec(name="pan", model="STS3215-7.4V", id=1, port=""), 0, 1, 1)
    device.enabled, written = True, 2000
    assert not device.has_suspect_register
    for packet, value, now, wrong, mismatches, is_fault in (
        (1, 2000, 10.0, 0, 0, False),
        (2, 1900, 10.1, 1, 1, False),
        (2, 1900, 10.2, 1, 1, False),
        (3, 1900, 10.3, 2, 2, False),
        (4, 1900, 10.4, 3, 3, False),
        (5, 1900, 10.6, 4, 4, True),
        (6, 2000, 10.7, 0, 4, False),
        (7, 1900, 11.3, 1, 5, False),
    ):
        device._last_sent = (written, 500, packet, b"")
        device._compare("goal", value, written, now)
        assert device._read_backs["goal"].wrong == wrong
        assert device.mismatches == mismatches
        assert device.has_mismatch is (wrong > 0)
        assert device.has_suspect_register is (wrong > 0 and not is_fault)
        assert ("goal" in device.other_faults) is is_fault


def reported(device, time, status=0, **values):
    """Pass values of status registers to a device, like a reply read at `time` [s]."""
    before = device.bus_status.changes
    device._note(values, status, time)
    assert device.bus_status.changes > before  # the next status is read again, not the cached one
    return device.faults


def attached(model):
    device = Device(ServoSpec(name="pan", model=model, id=1, port=""), 0, 1, 1)
    device.attach(ServoCodec(1, 1), 0)
    return device


def test_a_low_supply_is_a_fault_after_half_a_second():
    device = attached("STS3215-7.4V")
    device.min_voltage = 6.0
    torque = device.units.torque_per_unit
    for time, tenths, is_fault in (
        (100.0, 60, False),
        (100.4, 59, False),
        (100.5, 60, False),
        (101.0, 59, False),
        (101.1, 59, True),
        (101.2, 50, True),
        (101.3, 74, False),
    ):
        faults = reported(device, time, voltage=tenths)
        assert [f"is {tenths / 10} V and it needs 6.0 V" in text for text in faults] == (
            [True] * is_fault
        )
        assert device.voltage == device.units.voltage == tenths / 10
    assert device.units.torque_per_unit == torque  # back at 7.4 V


def test_torque_that_went_off_stays_off_until_it_is_enabled():
    device = attached("STS3215-7.4V")
    assert not reported(device, 1.0, torque_enable=0)
    device.enabled, torque_changes = True, device.bus_status.torque_changes
    assert not reported(device, 1.1, torque_enable=1)
    assert device.torque_on
    for time in (1.2, 1.3):
        assert "its torque went off by itself" in reported(device, time, torque_enable=0)[0]
        assert not device.enabled
        assert not device.torque_on
    assert device.bus_status.torque_changes > torque_changes
    device.enabled = True
    assert not reported(device, 1.4, torque_enable=1)


def test_trips_and_alerts_are_counted_once_each():
    device = attached("XM430-W350")
    for value in (5, TRIPPED, TRIPPED, 5, TRIPPED):
        reported(device, 1.0, watchdog=value)
        assert device.watchdog == value
        assert device.tripped is (value == TRIPPED)
    assert device.trips == 2
    device = attached("STS3215-7.4V")
    for byte, alerts in ((0, 0), (1 << 2, 1), (1 << 2, 1), (0, 1), (1 << 2 | 1, 2), (1, 2)):
        assert len(reported(device, 1.0, status=byte)) == byte.bit_count()
        assert device.alerts == alerts


@pytest.mark.parametrize(
    ("model", "bits", "harmless", "causes"),
    [
        ("STS3215-7.4V", 1 << 2 | 1 << 5, 0, ["overheating", "overload"]),
        ("STS3215-7.4V", 1 << 3, 0, ["current too high"]),
        ("STS3215-7.4V", 1, 0, []),
        ("MX-64", 1 << 5, 0, ["overload"]),
        ("MX-64", 1 << 5, 1 << 5, []),  # overload does not reduce its torque
        ("XM430-W350", 0x80, 0, []),  # latched until a reboot, and thus a fault
    ],
)
def test_protections_that_tripped_since_torque_on_are_known(model, bits, harmless, causes):
    device = attached(model)
    device.harmless = harmless
    reported(device, 1.0, status=bits)  # before torque on
    device.enabled = False
    device.enabled = True
    assert not device.protections
    reported(device, 1.1, status=bits)
    reported(device, 1.2, status=0)
    texts = [f"{device.spec.name} (id {device.id}): {cause}" for cause in causes]
    assert list(device.protections) == texts
    device.enabled = True  # is on already
    assert list(device.protections) == texts


def test_overloads_that_leave_the_torque_on_are_no_fault():
    device = attached("XM430-W350")
    overload, heat = 1 << 5, 1 << 2
    device.harmless = overload
    for value, is_harmless in ((overload, True), (overload | heat, False), (0, False)):
        faults = reported(device, 1.0, status=0x80 if value else 0, hardware_error=value)
        assert device.has_harmless_error is is_harmless
        assert len(faults) == bool(value & heat)


@pytest.mark.parametrize(
    ("volts", "temperatures", "expected"),
    [
        ([12.0, 11.5], [30.0, 40.0], (11.5, 40.0)),
        ([11.5, 12.0], [40.0, 30.0], (11.5, 40.0)),
        ([None, 12.0], [None, 30.0], (12.0, 30.0)),
        ([None, None], [None, None], (None, None)),
        ([12.0], [30.0], (12.0, 30.0)),
    ],
)
def test_the_status_of_a_joint_is_that_of_its_worst_servo(volts, temperatures, expected):
    family, bus_status = SimpleNamespace(status="feetech", status_blocks=[]), BusStatus([0.0])
    joint = [
        SimpleNamespace(
            spec=SimpleNamespace(name="lift"),
            family=family,
            bus_status=bus_status,
            voltage=voltage,
            temperature=temperature,
            conditions=(),
            other_faults={},
            has_mismatch=False,
            faults=(f"fault {number}",),
            protections=(),
        )
        for number, (voltage, temperature) in enumerate(zip(volts, temperatures, strict=True))
    ]
    status = StatusPoller([joint])._status_of(0)
    assert (status.name, status.voltage, status.temperature) == ("lift", *expected)
    assert status.faults == tuple(f"fault {number}" for number in range(len(joint)))


def test_every_register_that_may_be_wrong_is_read_again_in_turn():
    family = SimpleNamespace(
        status="feetech", status_blocks=["all"], stored_command_blocks=["limit", "goal"]
    )
    blocks = []
    device = SimpleNamespace(
        spec=SimpleNamespace(name="lift"),
        id=1,
        joint=0,
        family=family,
        bus_status=BusStatus([0.0]),
        voltage=12.0,
        temperature=30.0,
        faults=(),
        protections=(),
        conditions=(),
        other_faults={},
        has_mismatch=True,
        has_suspect_register=True,
        index=0,
        note=lambda _: None,
    )
    guard = SimpleNamespace(is_gone=False, read=lambda _, block: blocks.append(block))
    poller = StatusPoller([[device]])
    for _ in range(8):
        poller.step({id(device): SimpleNamespace(guard=guard)})
    assert blocks[::2] == ["goal", "limit", "goal", "limit"]
    assert blocks[1::2] == ["all"] * 4


def polled(servo_bus):
    """Return the faults that ten readings of status registers report."""
    return [getattr(servo_bus.poll_status(), "faults", ()) for _ in range(10)]


def test_a_single_turn_servo_that_was_moved_across_the_seam_is_reported(emulated):
    spec = {"zero": 4000.0, "lower": None, "upper": None}
    with emulated("sts", 1, clock="steps", spec=spec, is_open=False) as (bus, servo_bus):
        shaft, count, found = bus.servos[0].shaft, bus.servos[0].model.count, {}
        shaft.angle = 3950 * count
        servo_bus.open()
        for position in (3950, 4050, 4150, 4050, 3950):
            shaft.angle = position * count
            bus.advance(0.2)
            sample = servo_bus.read()
            assert sample.position[0] == pytest.approx((position - 4000) * count, abs=1.5 * count)
            found[position] = "past the end of its encoder's range" in str(polled(servo_bus))
        assert found == {3950: False, 4050: False, 4150: True}


def test_chance_faults_never_give_a_stale_sample(emulated, enabled):
    from pliant.emulator import Faults

    faults = Faults(seed=3)
    with emulated("sts", 6, clock="steps", faults=faults) as (bus, servo_bus):
        limit = enabled(servo_bus)
        noisy = Faults(seed=3, lose=0.01, corrupt=0.02, late=0.03, noise=0.01, truncate=0.01)
        faults._shares = noisy._shares
        replies = 0
        for sample, truth in sweep(bus, servo_bus, limit, 150):
            error = np.abs(sample.position - truth)[sample.ok]
            replies += sample.ok.sum()
            assert error.size == 0 or error.max() < 0.003
        assert replies > 0.98 * 150 * 6
        assert servo_bus.counters["retries"] > 5


@pytest.mark.parametrize("kind", PROTOCOLS)
@pytest.mark.parametrize("skip", [0, 1])
def test_a_short_silence_of_a_servo_neither_leaves_torque_on_nor_registers_changed(
    emulated, enabled, kind, skip
):
    """The requests to switch torque off are lost, or those that restore the registers."""
    with emulated(kind, 3, clock="steps") as (bus, servo_bus):
        enabled(servo_bus)
        bus.faults.inject("deaf", 2, count=6, skip=skip)
        servo_bus.disable()
        assert not any(servo.enabled for servo in bus.servos)
        assert not servo_bus.unrestored.any()
