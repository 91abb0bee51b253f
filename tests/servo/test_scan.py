"""`scan` over slow, late or broken lines finds the existing ids and no others."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rustypot", reason="the tests of servo buses need the extra servo")

from pliant import ServoError
from pliant.emulator import Device, Emulator, Timing
from pliant.servo import BusError
from pliant.servo.scan import _IdScan, scan

MODELS = {"xl": "XL430-W250", "sts": "STS3215", "mx": "MX-64"}


def scan_ids(bus, baud):
    return [(servo.id, servo.note) for servo in scan(bus.port, baudrates=(baud,), ids=range(12))]


def answers(kind, ids, delay=250):
    return [Device(MODELS[kind], id=i, return_delay_time=delay) for i in ids]


@pytest.mark.parametrize("latency", [0.0, 0.016])
@pytest.mark.parametrize(
    ("kind", "baud"), [("xl", 57_600), ("xl", 1_000_000), ("sts", 1_000_000), ("mx", 57_600)]
)
def test_the_ids_that_are_there_are_seen_and_no_others(kind, baud, latency):
    ids, timing = [1, 2, 3, 4, 6, 11], Timing(wire=True, usb_latency=latency)
    with Emulator(answers(kind, ids), timing=timing, baud=baud) as bus:
        assert scan_ids(bus, baud) == [(i, "") for i in ids]


@pytest.mark.parametrize("kind", MODELS)
def test_answers_that_are_late_once_are_not_booked_on_other_ids(kind):
    with Emulator(answers(kind, range(1, 7))) as bus:
        for id, seconds in ((2, 0.012), (4, 0.03), (6, None)):
            bus.faults.inject("late", id, seconds=seconds)
        bus.faults.inject("lose", 5)
        assert scan_ids(bus, 1_000_000) == [(i, "") for i in range(1, 7)]


def test_two_servos_on_one_id_are_distinguished_from_a_line_that_corrupts_replies():
    parts = [*answers("sts", [1, 2]), Device("STS3215", id=2, angle=1.0)]
    with Emulator(parts) as bus:
        first, second = scan_ids(bus, 1_000_000)
        assert first == (1, "")
        assert second[0] == 2
        assert "two servos on this id?" in second[1]
    with Emulator(answers("sts", [1, 2, 3])) as bus:
        bus.faults.by_chance(noise=1.0)
        notes = [note for _, note in scan_ids(bus, 1_000_000)]
        assert notes
        assert all("two servos" not in note for note in notes)
        assert all("adapter" in note for note in notes)


@pytest.mark.parametrize("disturbance", ["hum", "echo"])
@pytest.mark.parametrize("kind", ["sts", "xl"])
def test_a_line_that_is_never_silent_is_reported(kind, disturbance):
    with Emulator(answers(kind, [1, 2])) as bus:
        getattr(bus, disturbance)()
        with pytest.raises(ServoError, match="never silent"):
            scan(bus.port, baudrates=(1_000_000,), ids=range(3))


def test_a_scan_opens_closes_and_announces_every_rate_and_protocol(monkeypatch):
    events = []

    def transport(*arguments):
        events.append(arguments)
        return SimpleNamespace(close=lambda: events.append("closed"))

    def scanner(io, port, baudrate, protocol, latency):
        return SimpleNamespace(run=lambda ids: [(baudrate, protocol, ids)])

    monkeypatch.setattr("pliant.servo.scan._IdScan", scanner)
    rates = (57_600, 1_000_000)
    options = {"transport": transport, "progress": events.append}
    found = scan("port", baudrates=rates, ids=range(2), **options)
    steps = [(rate, protocol) for rate in rates for protocol in ("p1", "p2")]
    assert found == tuple((*step, (0, 1)) for step in steps)
    assert events == [
        event
        for rate, protocol in steps
        for event in (
            f"port, {rate} bit/s, Protocol {protocol[1]}.0",
            ("port", rate, protocol),
            "closed",
        )
    ]


class Line:
    """Line in simulated time, of servos with Feetech's address of the model number.

    Attributes:
        models: Model number by id.
        lost: Ids whose next reply is lost, once for each entry.
        corrupt: Ids whose replies are always corrupt.
        noisy: Number of pings during which data arrive.
    """

    def __init__(self, monkeypatch, models, *, lost=(), corrupt=(), noisy=0, reason="timeout"):
        self.models, self.lost, self.corrupt, self.noisy = models, list(lost), corrupt, noisy
        self.time, self.timeout, self.reads, self.reason = 0.0, 0.0, [], reason
        monkeypatch.setattr("pliant.servo.scan.time", self)

    def perf_counter(self):
        return self.time

    def set_timeout(self, seconds):
        self.timeout = seconds

    def ping(self, id):
        assert id not in self.models
        self.time += 0.001 if self.noisy > 0 else self.timeout + 1e-6
        self.noisy -= 1
        raise BusError("no answer", self.reason)

    def read(self, id, address, size):
        self.reads.append(id)
        if id in self.corrupt:
            self.noisy = 2
            raise BusError("broken answer", "corrupt")
        if id in self.lost or id not in self.models:
            if id in self.lost:
                self.lost.remove(id)
            self.time += self.timeout
            raise BusError("no answer", self.reason)
        number = self.models[id] if address == 3 else 0x1234
        return number.to_bytes(size, "little"), 0


def test_models_and_anomalies_of_a_scan(monkeypatch):
    line = Line(monkeypatch, {1: 777, 2: 9999, 4: 777, 5: 777, 6: 777}, corrupt=[4], lost=[5, 6, 6])
    found = _IdScan(line, "port", 1_000_000, "p1", 0.001).run(range(7))
    unknown = (0x1234, 0, "not in the servo table")
    servos = {s.id: (s.number, len(s.models), s.note.partition(":")[0]) for s in found}
    assert servos == {
        1: (777, 4, ""),
        2: unknown,
        4: (None, 0, "broken answer"),
        5: (777, 4, ""),  # asked a second time
    }
    assert {(s.port, s.baudrate, s.protocol) for s in found} == {("port", 1_000_000, "p1")}


def test_silent_ids_are_asked_again_only_if_a_servo_answers(monkeypatch):
    line = Line(monkeypatch, {})
    assert not _IdScan(line, "port", 1_000_000, "p1", 0.001).run(range(5))
    assert line.reads == [*range(5)]


@pytest.mark.parametrize(("count", "note"), [(1, "broken answer"), (2, "broken answers")])
def test_a_line_with_only_corrupt_replies_is_bad(monkeypatch, count, note):
    line = Line(monkeypatch, {}, corrupt=[*range(count)])
    servos = _IdScan(line, "port", 1_000_000, "p1", 0.001).run(range(4))
    assert [servo.note.partition(":")[0].partition(" from")[0] for servo in servos] == [
        note
    ] * count


def test_a_device_that_answers_nonsense_to_every_id_is_no_list_of_servos(monkeypatch):
    line = Line(monkeypatch, {}, corrupt=[*range(4)])
    with pytest.raises(ServoError, match=r"port: broken answers from every id.*no servo adapter"):
        _IdScan(line, "port", 1_000_000, "p1", 0.001).run(range(4))


@pytest.mark.parametrize(("noisy", "is_silent"), [(0, True), (19, True), (20, False)])
def test_a_line_has_twenty_pings_to_become_silent(monkeypatch, noisy, is_silent):
    line = Line(monkeypatch, {1: 777}, noisy=noisy)
    scanner = _IdScan(line, "port", 1_000_000, "p1", 0.001)
    if is_silent:
        assert [servo.id for servo in scanner.run(range(3))] == [1]
        return
    with pytest.raises(ServoError, match=r"port: .*never silent"):
        scanner.run(range(3))


def test_a_port_that_is_gone_ends_a_scan(monkeypatch):
    for models, noisy in (({}, 0), ({1: 777}, 99)):
        line = Line(monkeypatch, models, noisy=noisy, reason="gone")
        with pytest.raises(BusError, match="no answer"):
            _IdScan(line, "port", 1_000_000, "p1", 0.001).run(range(3))
