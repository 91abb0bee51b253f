"""The class `Emulator`: ports, clock, faults."""

from __future__ import annotations

import os
import termios
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from emulator.helpers import Host, p1, two

from pliant import ConfigError, ServoError
from pliant.emulator import Device, Emulator, ManualClock, Timing
from pliant.emulator.serial_line import SerialLine


def sts(count=1, **options):
    options.setdefault("clock", "steps")
    return Emulator([Device("STS3215", id) for id in range(1, count + 1)], **options)


def test_answers_over_a_path_that_is_gone_afterwards():
    with sts() as emulator, Host(emulator.port) as host:
        path = emulator.port
        assert host.ask(p1(1, 1), 6) == p1(1, 0)
    assert not Path(path).exists()
    assert len(emulator.log) == 1, "the log stays"


def test_steps_wait_for_what_was_written_before():
    with sts() as emulator, Host(emulator.port) as host:
        for k in range(50):
            os.write(host.fd, p1(0xFE, 3, 42, *two(2100 + k)))
            emulator.advance(0.01)
            assert emulator.servo(1).get("goal_position") == 2100 + k
        times = [round(w.time, 6) for w in emulator.log.writes("goal_position")]
    assert times == [round(0.01 * k, 6) for k in range(50)]


def test_steps_stand_still_without_advance():
    with sts() as emulator, Host(emulator.port) as host:
        os.write(host.fd, p1(0xFE, 3, 42, *two(3000)))
        first = host.ask(p1(1, 2, 56, 2), 8)
        assert host.ask(p1(1, 2, 56, 2), 8) == first
        emulator.advance(0.2)
        assert host.ask(p1(1, 2, 56, 2), 8) != first


def test_runs_repeat_bit_for_bit():
    def run():
        with sts(2) as emulator, Host(emulator.port) as host:
            got = []
            for k in range(30):
                os.write(host.fd, p1(0xFE, 3, 42, *two(2048 + 10 * k)))
                emulator.advance(0.013)
                got.append(host.ask(p1(0xFE, 0x82, 56, 8, 1, 2), 28))
            return got

    assert run() == run()


def test_wire_time_passes_under_the_clock_of_steps():
    with sts(timing=Timing(wire=True)) as emulator, Host(emulator.port) as host:
        for _ in range(100):
            host.ask(p1(1, 2, 56, 15), 21)
        # A host that has received the reply must see the time after its transmission.
        spent = sum(transaction.duration for transaction in emulator.log)
        assert emulator.time == pytest.approx(spent, abs=0.0011)
        assert spent == pytest.approx(100 * (290e-6 + 30e-6), rel=0.01)


def test_the_clock_of_steps_includes_all_writes_and_stops_on_time():
    with sts(timing=Timing(wire=True)) as emulator, Host(emulator.port) as host:
        clock, packet = ManualClock(emulator), p1(0xFE, 3, 42, *two(2100), *[0] * 200)
        for k in range(1, 21):
            before = clock.now()
            os.write(host.fd, packet)
            assert clock.now() == pytest.approx(before + 10e-6 * len(packet), abs=0.0011)
            os.write(host.fd, packet)
            clock.wait_until(0.01 * k)
            assert emulator.time == pytest.approx(0.01 * k, abs=1e-9)


def test_threads_that_wait_at_once_leave_nothing_on_the_wires(monkeypatch):
    devices = [Device("STS3215", 1, port="left"), Device("STS3215", 1, port="right")]
    heard, feed = [], SerialLine.feed

    def listening(line, data, *rest):
        heard.append(data)
        return feed(line, data, *rest)

    monkeypatch.setattr(SerialLine, "feed", listening)
    with Emulator(devices, clock="steps") as emulator, ThreadPoolExecutor(4) as threads:
        paths = emulator.ports
        with Host(paths["left"]) as left, Host(paths["right"]) as right:

            def ask(host):
                for _ in range(50):
                    emulator.sync()
                    assert host.ask(p1(1, 1), 6) == p1(1, 0)

            for done in [threads.submit(ask, host) for host in (left, right)]:
                done.result()
            for done in [threads.submit(emulator.sync) for _ in range(100)]:
                done.result()
    assert b"".join(heard) == p1(1, 1) * 100


def test_real_time_moves_servos_by_itself():
    with sts(clock="real") as emulator, Host(emulator.port) as host:
        host.ask(p1(1, 3, 42, *two(2200)), 6)
        end = time.monotonic() + 5.0
        while emulator.servo(1).position < 2190 and time.monotonic() < end:
            time.sleep(0.01)
        assert emulator.servo(1).position >= 2190
        with pytest.raises(ConfigError, match="steps"):
            emulator.advance(0.1)


def test_wrong_speed_is_silence():
    with sts() as emulator, Host(emulator.port, termios.B115200) as host:
        assert host.ask(p1(1, 1), 6, patience=0.05) == b""
        settings = termios.tcgetattr(host.fd)
        settings[4] = settings[5] = termios.B1000000
        termios.tcsetattr(host.fd, termios.TCSANOW, settings)
        assert host.ask(p1(1, 1), 6) == p1(1, 0)


def test_pulled_adapter_fails_the_host_and_comes_back_under_its_path():
    with sts() as emulator:
        with Host(emulator.port) as host:
            host.ask(p1(1, 3, 42, *two(2200)), 6)
            emulator.pull()
            with pytest.raises(OSError, match="Input/output"):
                os.write(host.fd, p1(1, 1))
            with pytest.raises(FileNotFoundError):
                os.open(emulator.port, os.O_RDWR)
        emulator.put_back()
        with Host(emulator.port) as host:
            assert host.ask(p1(1, 1), 6) == p1(1, 0)
        assert emulator.servo(1).enabled, "servos keep power, goal and limit"


def test_unplugged_servo_is_silent_and_forgets():
    with sts(2) as emulator, Host(emulator.port) as host:
        host.ask(p1(1, 3, 42, *two(2200)), 6)
        emulator.unplug(1)
        assert len(host.ask(p1(0xFE, 0x82, 56, 2, 1, 2), 16, patience=0.05)) == 8
        emulator.plug(1)
        assert host.ask(p1(1, 1), 6, patience=0.05) == b"", "it boots"
        emulator.advance(0.4)
        assert host.ask(p1(1, 2, 40, 1), 7)[5] == 0


def test_brown_out_and_reboot_lose_torque():
    with sts(2) as emulator, Host(emulator.port) as host:
        for id in (1, 2):
            host.ask(p1(id, 3, 42, *two(2200)), 6)
        emulator.reboot(2)
        assert [servo.enabled for servo in emulator.servos] == [True, False]
        emulator.brown_out()
        assert not any(servo.enabled for servo in emulator.servos)


def test_trip_supply_stick_and_short():
    with sts() as emulator, Host(emulator.port) as host:
        host.ask(p1(1, 3, 42, *two(2200)), 6)
        emulator.trip(1, "overload")
        assert host.ask(p1(1, 1), 6)[4] == 0x20
        emulator.supply(12.0)
        assert host.ask(p1(1, 1), 6)[4] == 0x21
        emulator.supply(7.4)
        emulator.stick(1, "present_position", 1234)
        assert host.ask(p1(1, 2, 56, 2), 8)[5:7] == bytes(two(1234))
        emulator.stick(1, "present_position", None)
        emulator.short()
        assert host.ask(p1(1, 1), 6, patience=0.05) == b""
        emulator.short(False)
        assert host.ask(p1(1, 1), 6)


def test_two_ports_share_a_clock():
    devices = [Device("STS3215", 1, port="left"), Device("XL430-W250", 1, port="right")]
    with Emulator(devices, clock="steps") as emulator:
        assert list(emulator.ports) == ["left", "right"]
        with Host(emulator.ports["left"]) as left, Host(emulator.ports["right"]) as right:
            assert left.ask(p1(1, 1), 6) == p1(1, 0)
            assert right.ask(p1(1, 1), 6, patience=0.05) == b""
            emulator.pull("left")
            assert right.ask(bytes.fromhex("FFFFFD0001030001194E"), 14)


def test_log_is_bounded_and_decodes():
    with sts(log=10) as emulator, Host(emulator.port) as host:
        seen = []
        emulator.log.watch = seen.append
        for _ in range(30):
            host.ask(p1(1, 1), 6)
        assert (len(emulator.log), emulator.log.count, len(seen)) == (10, 30, 30)
        host.ask(p1(1, 3, 48, *two(300)), 6)
        host.ask(p1(1, 3, 42, *two(2048)), 6)
        host.ask(p1(1, 3, 40, 1), 6)
        host.ask(p1(1, 3, 16, *two(900)), 6)
        log = emulator.log
        assert log.order(1) == ["limit", "goal", "torque on"]
        assert [w.values for w in log.eeprom_writes()] == [{"max_torque_limit": 900}]
        assert [w.values for w in log.goals_while_disabled()] == [{"goal_position": 2048}]
        assert log[-1].instruction == "write"
        assert log[-1].request == p1(1, 3, 16, *two(900))
        assert log[-1].replies == (p1(1, 0),)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Emulator([]), "at least one"),
        (lambda: sts(clock="none"), "clock"),
        (lambda: Device("STS3251"), "STS3215"),
        (lambda: Device("STS3215", goal_positions=1), "no register 'goal_positions'"),
        (lambda: Device("STS3215", torque_enable=1), "ram"),
        (lambda: Device("STS3215", id=254), "0 to 253"),
        (lambda: Device("XM430-W350", id=253), "0 to 252"),
        (lambda: sts(baud=2_000_000), "cannot do 2000000"),
        (lambda: sts().servo(9), "no servo with id 9"),
        (lambda: sts().trip(1, "boredom"), "overload, heat, voltage"),
    ],
)
def test_errors(make, words):
    with pytest.raises(ConfigError, match=words):
        make()


def test_errors_of_life():
    emulator = sts()
    with pytest.raises(ServoError, match="not running"):
        _ = emulator.port
    with emulator, pytest.raises(ServoError, match="already"):
        emulator.start()
    emulator.stop()


def test_an_answer_that_waits_for_the_computer_is_noticed():
    with sts(clock="real") as emulator, Host(emulator.port) as host:
        with ThreadPoolExecutor() as pool:
            with emulator._server.lock:
                answer = pool.submit(host.ask, p1(1, 1), 6)
                time.sleep(0.2)
            assert answer.result() == p1(1, 0)
        assert emulator.max_latency > 0.15
