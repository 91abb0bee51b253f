"""Requests and results of a bus in a session with failures, compared with recorded ones.

The recordings are in `tests/data/transcripts`. After an intended change, run this file as a program
to record again, and review the differences.
"""

import math
import pickle
from collections import Counter
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace
from zlib import crc32

import numpy as np
import pytest

pytest.importorskip("rustypot", reason="the tests of servo buses need the extra servo")

from pliant import ConfigError, ServoError
from pliant.drive import ServoStatus
from pliant.emulator import MODELS as EMULATED
from pliant.servo import BusError, ServoBus, ServoSpec, _enable, _port
from pliant.servo import scan as scanning
from pliant.servo._transactions import TransactionGuard
from pliant.servo.eeprom import RegisterChange, plan_restore, plan_setup, set_id, write_changes

#: Number of requests per call that are recorded in full. Of the others, count and checksum are
#: recorded.
MOST = 12
FOLDER = Path(__file__).parents[1] / "data" / "transcripts"
RANGE = {"lower": -1.2, "upper": 1.1}
#: Joints of each session: model, id, and further attributes of `ServoSpec`.
SESSIONS = {
    "feetech": [
        ("STS3215-7.4V", 1, RANGE),
        ("STS3215-7.4V-191", 2, {"sign": -1, "zero": 2000.5, "gear_ratio": 1.5, "kp": 6.0}),
        ("STS3215-7.4V", 3, {"secondary": (4, -1), **RANGE}),
        ("MX-28", 253, {"torque_offset": 0.05}),
    ],
    "protocol2": [
        ("XM430-W350", 1, RANGE),
        ("XM430-W350", 2, {"sign": -1, "kp": 12.0, "gear_ratio": 2.0}),
        ("XL430-W250", 3, RANGE),
        ("XM430-W350", 4, {"secondary": (252, -1)}),
    ],
    "protocol1": [
        ("MX-64", 1, RANGE),
        ("MX-64", 2, {"secondary": (3, -1)}),
        ("RX-64", 4, {"sign": -1, "lower": -1.0, "upper": 1.0}),
        ("EX-106+", 5, {}),
    ],
    "ports": [
        ("STS3215-7.4V", 1, RANGE),
        ("STS3215-7.4V", 2, {"port": "right"}),
        ("STS3215-7.4V", 3, {"port": "right", "secondary": (4, 1)}),
    ],
}


class Line:
    """Port in memory, whose servos move to their goals by at most 9 counts per reading.

    Attributes:
        memory: Registers by id.
        silent: Ids of servos that do not answer.
        stuck: Registers that keep their values, as pairs of id and name.
        broken: Ids of servos whose replies are corrupt.
        deaf: Blocks that are not answered, as pairs of id and register at their beginning.
        drift: Counts per reading by which servos without torque move, by id.
        status: Status byte by id.
        errors: Reasons of errors of the next requests, or exceptions; None: no error.
        late: Number of drains that find bytes on the line.
        last: Time of the last request [s]; each is recorded with the time since the one before it.
    """

    def __init__(self, specs, time):
        self.rows = {id: spec.row for spec in specs for id, _ in spec.servos}
        self.memory = {id: bytearray(200) for id in self.rows}
        self.silent, self.stuck, self.deaf, self.broken = set(), set(), set(), set()
        self.drift, self.status = {}, {}
        self.errors, self.late, self.timeout = [], 0, 0.0
        self.time, self.last, self.requests = time, 0.0, []
        for id, row in self.rows.items():
            table = EMULATED[row.name if row.name in EMULATED else "STS3215-C044"].table
            initial = {register.address: register.initial for register in table}
            for name, register in row.family.registers.items():
                self.put(id, **{name: initial.get(register.address) or 0})
            middle = row.max_position // 2 + 10 * id % 70
            self.put(id, id=id, model=row.model_number, position=middle, speed=id % 3)
            volts = round(10 * row.rated)
            self.put(id, voltage=volts, temperature=31, return_level=2, return_delay=3 * id % 40)
            self.put(id, phase=4, voltage_min=volts - 15, voltage_max=volts + 15, shadow_id=255)
            current = row.limit_type == "current"
            self.put(id, mode={"p2": 5 if current else 3}.get(row.family.status, 0))

    def put(self, id, /, **values):
        for name, value in values.items():
            if (register := self.rows[id].family.registers.get(name)) is not None:
                data = register.encode(value)
                self.memory[id][register.address : register.address + len(data)] = data

    def get(self, id, name):
        register = self.rows[id].family.registers[name]
        return register.decode(self.memory[id][register.address :][: register.size])

    def request(self, name, ids, text):
        what = f"{name} {' '.join(map(str, ids))} {text}".rstrip()
        passed, self.last = self.time[0] - self.last, self.time[0]
        self.requests.append(f"  {1e3 * passed:.2f} {1e3 * self.timeout:.2f} {what}")
        self.time[0] += 0.0005
        if self.errors and (error := self.errors.pop(0)) is not None:
            if isinstance(error, BaseException):
                raise error
            self.time[0] += self.timeout * (error == "timeout")
            raise BusError("scripted", error, ids[-1])
        if broken := self.broken.intersection(ids):
            raise BusError("broken", "corrupt", min(broken))
        deaf = {
            id
            for id, register in self.deaf
            if text.startswith(f"@{self.rows[id].family.registers[register].address}+")
        }
        silent = (self.silent | deaf).intersection(ids)
        silent |= set(ids).difference(self.memory)
        if silent and name not in {"sync_write", "ping"}:
            self.time[0] += self.timeout
            raise BusError("no answer", "timeout", min(silent))

    def registers(self, id, address, size):
        if self.get(id, "torque_enable"):
            goal, position = self.get(id, "goal"), self.get(id, "position")
            self.put(id, position=position + min(max(goal - position, -9), 9))
        else:
            self.put(id, position=self.get(id, "position") + self.drift.get(id, 0))
        return bytes(self.memory[id][address : address + size]), self.status.get(id, 0)

    def store(self, id, address, data):
        kept = [(name, self.get(id, name)) for stuck, name in self.stuck if stuck == id]
        self.memory[id][address : address + len(data)] = data
        self.put(id, **dict(kept))
        if (new := self.get(id, "id")) != id:
            self.memory[new], self.rows[new] = self.memory.pop(id), self.rows.pop(id)

    # Methods of `pliant.servo.transport.Transport`.

    def read(self, id, address, size):
        self.request("read", [id], f"@{address}+{size}")
        return self.registers(id, address, size)

    def sync_read(self, ids, address, size):
        self.request("sync_read", ids, f"@{address}+{size}")
        return [self.registers(id, address, size) for id in ids]

    def write(self, id, address, data):
        self.request("write", [id], f"@{address} {bytes(data).hex()}")
        self.store(id, address, data)
        return self.status.get(id, 0)

    def sync_write(self, ids, address, data):
        packets = [bytes(item) for item in data]
        self.request("sync_write", ids, f"@{address} {' '.join(p.hex() for p in packets)}")
        for id, packet in zip(ids, packets, strict=True):
            self.store(id, address, packet)

    def ping(self, id):
        self.request("ping", [id], "")
        if id in self.memory and id not in self.silent:
            return True
        is_late, self.late = self.late > 0, max(self.late - 1, 0)
        self.time[0] += self.timeout / 4 if is_late else self.timeout
        return False

    def reboot(self, id):
        self.request("reboot", [id], "")
        self.put(id, torque_enable=0, hardware_error=0)

    def set_timeout(self, seconds):
        self.timeout = seconds

    def close(self):
        self.requests.append("  close")


class Session:
    """A bus on lines in memory; `lines` are its requests, and what its methods return."""

    def __init__(self, name, monkeypatch):
        rows = SESSIONS[name]
        specs = [
            ServoSpec(**{"name": f"j{i}", "model": model, "id": id, "port": "left", **further})
            for i, (model, id, further) in enumerate(rows)
        ]
        self.lines, self.count, self.time = [], 0, [0.0]
        names = dict.fromkeys(spec.port for spec in specs)
        # The threads of two ports share no clock.
        self.ports = {
            port: Line(
                [spec for spec in specs if spec.port == port],
                self.time if len(names) == 1 else [0.0],
            )
            for port in names
        }
        self.line = self.ports["left"]
        clock = SimpleNamespace(now=lambda: self.time[0], real_time=True)
        times = [line.time for line in self.ports.values()]
        total = SimpleNamespace(monotonic=lambda: sum(time[0] for time in times))
        monkeypatch.setattr(_enable, "time", total)
        monkeypatch.setattr(scanning, "time", SimpleNamespace(perf_counter=clock.now))
        monkeypatch.setattr(
            _port,
            "TransactionGuard",
            lambda io, *rest, **options: TransactionGuard(
                io, *rest, clock=lambda: io.time[0], **options
            ),
        )
        self.latency = 0.004 if name == "protocol2" else None
        monkeypatch.setattr(_port, "latency_timer", lambda path: self.latency)
        self.options = {
            "baudrate": {"left": 1_000_000, "right": 500_000},
            "reply_timeout_min": 0.012,
            "transport": lambda path, *_: self.ports[path],
            "clock": clock,
        }
        speed = 2.0 if name == "protocol2" else None
        self.bus = ServoBus(specs, rate=80.0, speed=speed, **self.options)

    def call(self, name, *arguments):
        """Call a method of the bus, and record what it returns or raises."""
        method = getattr(self.bus, name) if isinstance(name, str) else name
        plain = [value for value in arguments if isinstance(value, str | float | int | list)]
        plain += [value for value in arguments if isinstance(value, np.ndarray)]
        self.lines.append(" ".join([method.__name__, *map(shown, plain)]))
        try:
            value = method(*arguments)
        except (ServoError, ConfigError, KeyboardInterrupt) as error:
            value = f"{type(error).__name__}: {error}"
        for port, line in self.ports.items():
            if requests := line.requests:
                self.lines += [f" {port}"] if len(self.ports) > 1 else []
                rest = requests[MOST:]
                self.lines += requests[:MOST]
                if rest:
                    checksum = crc32("\n".join(rest).encode())
                    self.lines.append(f"  and {len(rest)} more, {checksum:08x}")
                self.count += len(requests)
                requests.clear()
        if value is not None:
            self.lines.append(f"= {shown(value)}")
        return value

    def note(self):
        """Record the properties of the bus that requests change."""
        bus = self.bus
        values = {name: getattr(bus, name) for name in ("enabled", "torque_unknown", "refusing")}
        values |= {"unrestored": bus.unrestored, "orders": bus.orders, "counters": bus.counters}
        self.lines += [f"{name}: {shown(value)}" for name, value in values.items()]

    def cycles(self, count, goal=0.1, velocity=None, period=0.0125):
        """Run control cycles, which last for `period` and their requests [s]."""
        n = self.bus.n
        for i in range(count):
            self.call("read")
            more = [] if velocity is None else [[velocity] * n]
            self.call("write", [goal + 0.01 * i] * n, [0.3] * n, *more)
            self.call("poll_status")
            self.time[0] += period

    def play(self):
        """Run a session with all kinds of failures; return the record."""
        self.identification()
        self.cycles_with_failures()
        self.faults()
        self.torque()
        self.second_program()
        return self.lines

    def identification(self):
        bus, line = self.bus, self.line
        first, last = bus.specs[0], bus.specs[-1]
        self.call("read")
        for attribute, value in (
            ("silent", {first.id}),
            ("silent", set(line.memory)),
            ("broken", set(line.memory)),
            ("broken", {*list(line.memory)[:2]}),
            ("errors", [None] * 3 + ["corrupt"] * 20),
            ("errors", [None, None, "timeout", None, "corrupt"]),
        ):
            setattr(line, attribute, value)
            self.call("open")
            self.call("close")
            setattr(line, attribute, type(value)())
        port = self.ports[last.port]
        for names, text in ((("return_level", "mode"), 0), (("shadow_id", "drive_mode"), 12)):
            kept = bytes(port.memory[last.id])
            port.put(last.id, **dict.fromkeys(names, text))
            self.call("open")
            port.memory[last.id][:] = kept
        self.call("open")
        self.lines += [shown(info) for info in bus.found]
        for name in ("kp", "max_torque", "no_load_speed", "stiffness_known"):
            self.lines.append(f"{name}: {shown(getattr(bus.servos, name))}")
        for name in ("stiffness_known", "gains", "overload", "stall_current"):
            self.lines.append(f"{name}: {shown(getattr(bus, name))}")

    def cycles_with_failures(self):
        bus, line, n = self.bus, self.line, self.bus.n
        first, found = bus.specs[0], bus.read().position
        self.call("enable", found + 0.2, [0.3] * n)
        self.call("enable", found, [0.3] * n, [0.02] * n)
        self.call("watchdog", 0.5)
        self.cycles(6)
        self.cycles(2, velocity=1.0)
        line.errors = ["timeout", None, "corrupt", None, None, "timeout", "timeout"]
        line.late = 2
        self.cycles(3)
        line.silent = {first.id}
        self.cycles(7)
        line.silent = set()
        self.cycles(9)
        self.note()
        line.deaf = {(first.id, "torque_enable"), (first.id, "watchdog")} - {
            (first.id, name) for name in ("watchdog",) if name not in first.row.family.registers
        }
        self.time[0] += 0.3
        self.cycles(3)
        line.deaf = set()
        self.note()

    def faults(self):
        line, first = self.line, self.bus.specs[0]
        line.stuck = {(first.id, "goal"), (first.id, "limit")}
        self.time[0] += 0.3
        self.cycles(12, 0.2, period=0.07)
        self.note()
        line.stuck = set()
        volts = round(10 * first.row.rated)
        line.put(first.id, voltage=volts - 15)
        self.cycles(9, period=0.07)
        line.put(first.id, voltage=volts - 16)
        self.cycles(9, period=0.07)
        line.status = dict.fromkeys(line.memory, 4)
        line.put(first.id, voltage=volts, hardware_error=4, watchdog=255)
        self.cycles(8)
        line.status = {}
        line.put(first.id, position=line.get(first.id, "position") - 1500)
        self.cycles(6)
        self.note()
        doubled = [spec for spec in self.bus.specs if spec.secondary is not None]
        self.call("disable", ["j0", *(spec.name for spec in doubled)])
        for spec in doubled:
            port = self.ports[spec.port]
            position = port.get(spec.secondary[0], "position")
            port.put(spec.secondary[0], position=position + 120)
        # Move the joint across the end of the encoder's range and back.
        top = line.rows[first.id].max_position
        for position in (top - 5, 4, top - 5, top // 2):
            line.put(first.id, position=position)
            self.cycles(2)
        self.call("disable", ["j0"])
        for spec in doubled:
            port = self.ports[spec.port]
            port.put(spec.secondary[0], position=port.get(spec.secondary[0], "position") - 120)
        self.cycles(1)
        line.put(first.id, hardware_error=0, watchdog=0)

    def torque(self):
        bus, line, n = self.bus, self.line, self.bus.n
        first = bus.specs[0]
        line.silent = {first.id}
        self.call("reboot", "j0")
        line.silent = set()
        self.call("reboot", "j0")
        self.cycles(3)
        for drift in (-3, 20):
            line.drift = {first.id: drift}
            self.call("enable", bus.read().position, [0.25] * n)
        line.drift = {}
        # A servo refuses all packets.
        line.status = {first.id: 4 if first.row.family.status == "p2" else 8}
        self.call("enable", bus.read().position, [0.25] * n)
        line.status = {}
        line.errors = [None] * 60 + [KeyboardInterrupt("signal")]
        self.call("enable", bus.read().position, [0.25] * n)
        line.errors = []
        self.note()
        self.call("enable", bus.read().position, [0.25] * n)
        self.cycles(2)
        # A program that opens an arm with torque on, whose first servo has an alert.
        self.call("close")
        line.status = {first.id: 32} if first.row.family.status != "feetech" else {}
        self.call("open")
        self.note()
        line.status = {}
        self.call("enable", bus.read().position, [0.25] * n)
        self.cycles(2)

    def second_program(self):
        last = self.bus.specs[-1]
        port = self.ports[last.port]
        port.put(last.id, torque_enable=0)
        self.time[0] += 0.3
        self.cycles(4)
        self.note()
        copy = pickle.loads(pickle.dumps(self.bus.closed_copy()))
        self.call("close")
        copy._transport, copy.clock = self.options["transport"], self.options["clock"]
        self.bus, self.latency = copy, 0.016
        others = list(port.memory)
        port.silent = {last.id, others[0]}
        self.call("reopen")
        self.note()
        self.call("reopen")
        port.silent = {others[0]}
        self.call("reopen")
        port.silent = set()
        self.call("reopen")
        self.cycles(2)
        port.silent = {last.id}
        self.call("disable")
        self.note()
        port.silent = set()
        self.call("disable")
        self.note()
        self.call("close")
        port.silent = set(others)
        self.call("reopen")

    def short(self, request, reason):
        """Run a session in which one request fails; return a text of its results."""
        bus, n = self.bus, self.bus.n
        for line in self.ports.values():
            for id, row in line.rows.items():
                line.put(id, return_delay=0, position=row.max_position // 2)
        self.line.errors = [None] * request + [reason]
        self.call("open")
        self.call("enable", [0.1] * n, [0.3] * n)
        self.call("watchdog", 0.1)
        self.cycles(5)
        self.call("disable")
        self.call("close")
        results = [
            line.partition("\n")[0][2:90] for line in self.lines if line.startswith("= Servo")
        ]
        errors = [result for result in results if "Error" in result]
        states = [int(x) for name in ("enabled", "unrestored") for x in getattr(bus, name)]
        counts = {name: count for name, count in bus.counters.items() if count}
        counts.pop("transactions", None)
        after = self.count - (request if reason == "gone" else 0)
        return f"{after} {states} {shown(counts)} {' / '.join(dict.fromkeys(errors))}"

    def services(self, request=0, reason=None):
        """Scan the port and change EEPROM registers, with a failure at one request."""
        line, (spec, other) = self.line, self.bus.specs[:2]
        id, row, protocol = spec.id, spec.row, spec.row.family.protocol
        guard = TransactionGuard(line, protocol, baudrate=57_600, clock=lambda: line.time[0])
        line.errors = [None] * request + [reason]
        line.late = 2
        self.call(self.scan, range(6))
        for values in ({}, {"mode": 7, "drive_mode": 15, "position_min": 4095}):
            line.put(id, return_level=0, shadow_id=9, **values)
            line.put(id, position_max=4095)
            plan = self.call(plan_setup, guard, "j0", id, row)
            if isinstance(plan, list):
                self.call(write_changes, guard, row.family, plan)
                undo = self.call(plan_restore, guard, "j0", id, row, plan)
                self.call(plan_restore, guard, "j1", id, row, plan)
                line.stuck = {(id, "return_level")}
                if isinstance(undo, list):
                    self.call(write_changes, guard, row.family, undo)
                line.stuck = set()
        self.call(plan_setup, guard, "j1", other.id, row)
        for old, new in ((id, other.id), (78, id), (id, 77), (77, id)):
            self.call(set_id, guard, "j0", row, old, new)
        line.put(id if id in line.memory else 77, torque_enable=1)
        self.call(set_id, guard, "j0", row, id, 77)
        self.call(write_changes, guard, row.family, [RegisterChange("j0", id, "id", 1, 2, "")])
        results = [text for text in self.lines if text.startswith("= ")]
        errors = [text[2:50] for text in results if "Error: " in text[:20]]
        checksum = crc32("\n".join(results).encode())
        return f"{self.count} {checksum:08x} {' / '.join(dict.fromkeys(errors))}"

    def scan(self, ids):
        line = self.line

        def transport(_, baudrate, protocol):
            is_ours = (baudrate, protocol) == (57_600, self.bus.specs[0].row.family.protocol)
            line.silent = set() if is_ours else set(ids)
            return line

        rates = (1_000_000, 57_600)
        try:
            return scanning.scan("left", baudrates=rates, ids=ids, transport=transport)
        finally:
            line.silent = set()


def shown(value):
    """Return a value as text, rounded so that its last digits do not matter."""
    if isinstance(value, float | np.floating):
        return "nan" if math.isnan(value) else f"{value + 0.0:.6g}"
    if isinstance(value, np.ndarray | list | tuple) and not hasattr(value, "_fields"):
        texts = [*map(shown, value)]
        return f"{texts[0]}.." if len({*texts}) == 1 < len(texts) else f"[{', '.join(texts)}]"
    if isinstance(value, dict):
        return ", ".join(f"{k} {shown(v)}" for k, v in value.items())
    if hasattr(value, "position"):
        ages = value.time.max() - value.time
        return f"{shown(value.position)}; {shown(value.ok)}; {shown(ages)}"
    if isinstance(value, ServoStatus):
        return f"{value.name} {value.voltage} {value.temperature} {' | '.join(value.faults)}"
    if isinstance(value, RegisterChange):
        return f"{value.joint} {value.register} {value.old} {value.new} {value.why} {value.model}"
    if isinstance(value, scanning.ScannedServo):
        return f"{value.baudrate} {value.protocol} {value.id} {value.number} {value.note}"
    if isinstance(value, bool | np.bool_):
        return str(int(value))
    return str(value)


def make(name):
    """Return the lines of a recording: a session, or short ones with a failure at each request."""
    kind, *rest = name.split("-")
    with pytest.MonkeyPatch.context() as patch:
        if not rest:
            return "\n".join(Session(kind, patch).play()).splitlines()
        if rest == ["services"]:
            session = Session(kind, patch)
            session.services()
            return session.lines
        method = "services" if "services" in rest else "short"
        count = getattr(Session(kind, patch), method)(0, None)
        requests = range(int(count.split()[0]))
        results = [getattr(Session(kind, patch), method)(k, rest[-1]) for k in requests]
        # Equal results of successive requests make one line.
        runs = [[*run] for _, run in groupby(requests, results.__getitem__)]
        return [f"{run[0]} to {run[-1]}: {results[run[0]]}" for run in runs]


RECORDINGS = [
    *SESSIONS,
    *(f"{name}-services" for name in ("feetech", "protocol1", "protocol2")),
    *(f"{name}-{reason}" for name in ("feetech", "protocol2") for reason in ("gone", "timeout")),
    *(f"protocol1-services-{reason}" for reason in ("gone", "corrupt")),
    "feetech-services-timeout",
]


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_session_makes_the_recorded_requests(name):
    expected = (FOLDER / f"{name}.txt").read_text("utf-8").splitlines()
    lines = make(name)
    for i, (line, recorded) in enumerate(zip(lines, expected, strict=False)):
        assert line == recorded, f"line {i + 1}, after {lines[max(i - 4, 0) : i]}"
    assert len(lines) == len(expected)


#: Numbers of requests in a session over bytes: read, sync read, write, sync write; and the counter
#: `transactions`.
COUNTS = {
    "sts": (54, 20, 15, 14, 104),
    "xm": (86, 24, 21, 13, 145),
    "xl430": (95, 24, 21, 26, 167),
    "ex": (109, 0, 24, 14, 148),
    "rx": (112, 0, 24, 14, 151),
    "mx": (109, 0, 18, 14, 142),
}


@pytest.mark.pty
@pytest.mark.parametrize("kind", COUNTS)
def test_a_session_over_bytes_makes_the_recorded_number_of_requests(emulated, enabled, kind):
    with emulated(kind, 3, clock="steps") as (bus, servo_bus):
        limit = enabled(servo_bus)
        for i in range(12):
            servo_bus.read()
            servo_bus.write(np.full(3, 0.01 * i), limit)
            servo_bus.poll_status()
        servo_bus.disable()
        bus.sync()
        found = Counter(transaction.instruction for transaction in bus.log)
        kinds = ("read", "sync_read", "write", "sync_write")
        counts = (*(found[name] for name in kinds), servo_bus.counters["transactions"])
        assert counts == COUNTS[kind]


if __name__ == "__main__":
    for recording in RECORDINGS:
        (FOLDER / f"{recording}.txt").write_text("\n".join(make(recording)) + "\n", "utf-8")
