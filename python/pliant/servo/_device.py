"""State of one servo on the bus: the values last written and read, and their unit conversion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isnan, nan, pi, radians
from typing import TYPE_CHECKING, Any

from pliant._core import BusStatus, ServoError
from pliant.servo import _status as status
from pliant.servo.spec import Units

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pliant._core import ServoCodec
    from pliant.servo._transactions import Reply
    from pliant.servo.models import Family, ServoModel
    from pliant.servo.spec import ServoSpec

    #: Result of `ServoCodec.sent`.
    Sent = tuple[int | None, int, int, bytes]

#: Difference between the temperature limit of a servo and the temperature above which its torque is
#: not switched on [°C].
HEAT_MARGIN = 2.0
#: Lowest plausible temperature limit of a servo [°C].
MIN_TEMPERATURE_LIMIT = 50.0
#: Longest undervoltage that is not reported as a fault [s].
UNDERVOLTAGE_GRACE = 0.5
#: Time [s] and number of write packets for which the goal or limit register must differ from the
#: value written before the difference is a fault.
MISMATCH_TIME, MISMATCHES = 0.5, 3
#: Number of consecutive implausible positions that is reported as a fault.
MAX_JUMPS = 3
#: Angle of a turn [rad].
TURN = 2.0 * pi
#: Value of the register Bus Watchdog after it has tripped.
TRIPPED = 255
SEAM_TEXT = (
    "it stands past the end of its encoder's range, and a goal would turn it the long way round: "
    "move it back by hand"
)


@dataclass
class ReadBack:
    """Result of reading a register back and comparing it with the value written.

    Attributes:
        wrong: Number of consecutive write packets after which the register had another value.
        matched: Time at which the register last had the written value [s].
        write: Sequence number of the last write packet that the register did not match.
    """

    wrong: int = 0
    matched: float = 0.0
    write: int = -1


class Device:
    """State of one servo.

    Args:
        spec: Joint and servo.
        joint: Index of the joint in all vectors of the bus.
        id: Id of the servo on the bus.
        sign: +1 if counts rise with the joint angle, else -1.
        bus_status: Record of the status readings, shared by all servos of the bus; None:
            the servo is alone.

    Attributes:
        units: Unit conversions at the latest supply voltage.
        ceiling: Largest value of the limit register that the servo accepts.
        gain: Gain register of the position loop, as read.
        low, high: Range of goals [counts].
        min_voltage: Lowest supply voltage at which the servo can be driven [V].
        temperature_limit: Temperature at which the servo switches off [°C].
        alerts: Number of replies in which an error bit of the status byte appeared.
        multi_turn: True if goals may exceed one turn.
        caps_speed: True if the speed cap register bounds the speed.
        overload: Share of the full torque above which overload protection acts; None: never.
        wraparound: Counts per turn, if positions wrap around after a turn; else None.
        torque_on: True if torque was on at the last reading of Torque Enable.
        torque_unknown: True if torque may be on, because the servo has not answered since a program
            ended, or has not confirmed that torque is off.
        is_unrestored: True if registers may still differ from `initial_values` after torque off.
        is_off_requested: True if torque off was the last request, and `ServoBus.close` may repeat
            it.
        voltage, temperature: Supply voltage [V] and temperature [°C] as last read.
        conditions: Errors in the status of the last reply.
        hardware: Errors in the hardware error register (Protocol 2.0).
        harmless: Error bits of conditions that leave the torque on: an overload, unless the
            register Shutdown enables protection from it.
        has_harmless_error: True if the hardware error register has bits, and only harmless ones.
        other_faults: Texts of faults that this program detected, not the servo itself, by topic.
        watchdog: Bus watchdog as last read [units of 20 ms].
        tripped: True if the bus watchdog has tripped, so that the servo rejects goals.
        trips: Number of trips of the bus watchdog.
        initial_values: Values at open of the RAM registers that this program writes.
        stored_command: Goal and limit registers of a servo whose torque was on at open; None
            otherwise.
        drive_values: Registers that bound torque or motion, with the values that `enable` writes.
        mismatches: Number of times a register did not read back as written.
        has_mismatch: True if goal or limit did not read back as written the last time.
    """

    def __init__(
        self, spec: ServoSpec, joint: int, id: int, sign: int, bus_status: BusStatus | None = None
    ) -> None:
        """Store joint, id and sign; the other values are defaults until the servo is read."""
        self.bus_status = BusStatus([0.0]) if bus_status is None else bus_status
        self.spec, self.joint, self.id = spec, joint, id
        self.row: ServoModel = spec.row
        self.family: Family = self.row.family
        self.units = replace(Units.of(spec), sign=sign)
        self.ceiling = self.units.full
        self.gain = self.row.gain_default
        self.low, self.high = 0, self.row.max_position
        is_full_turn = self.row.counts_per_turn == self.row.max_position + 1
        self.wraparound: int | None = self.row.max_position + 1 if is_full_turn else None
        self.multi_turn, self.caps_speed = self.family.multi_turn, True
        self.overload: float | None = self.row.overload
        self.min_voltage, self._last_good_voltage = 0.0, 0.0
        self.temperature_limit = inf
        self.alerts = 0
        # Status bits that were set since torque on.
        self._status_bits = 0
        self._enabled = self.torque_on = self.torque_unknown = False
        self.is_unrestored = self.is_off_requested = False
        self.voltage: float | None = None
        self.temperature: float | None = None
        self.conditions: tuple[str, ...] = ()
        self.hardware: tuple[str, ...] = ()
        self.harmless = 0
        self.has_harmless_error = False
        self.other_faults: dict[str, str] = {}
        self.initial_values: dict[str, int] = {}
        self.stored_command: tuple[int, int] | None = None
        self.drive_values: dict[str, int] = {}
        self.mismatches = 0
        self._read_backs = {"goal": ReadBack(), "limit": ReadBack()}
        self.has_mismatch = False
        self.tripped, self.trips, self.watchdog = False, 0, 0
        self.index = 0
        self._codec: ServoCodec | None = None
        self._last_reading = [nan, nan, nan]
        self._last_sent: Sent = (None, 0, 0, b"")

    def attach(self, codec: ServoCodec, index: int) -> None:
        """Use `codec` from now on, as its servo `index`; keep last reading and last command."""
        last = self._reading()[:3]
        goal, limit, _, packet = self._sent
        self._codec, self.index = codec, index
        self.configure()
        codec.accept_any(index, *last)
        codec.record_sent(index, goal, limit, packet)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle: last reading and last command, without the codec."""
        last = {"_last_reading": self._reading(), "_last_sent": self._sent}
        return {**self.__dict__, "_codec": None, **last}

    @property
    def codec(self) -> ServoCodec:
        """Codec of all servos of the bus."""
        assert self._codec is not None, "attach comes first"
        return self._codec

    @property
    def enabled(self) -> bool:
        """True if this program switched the torque on, or took over a servo with torque on."""
        return self._enabled

    @enabled.setter
    def enabled(self, enabled: bool) -> None:
        if enabled and not self._enabled:
            self._status_bits = 0
        self._enabled = enabled
        self.bus_status.torque_changes += 1
        self.bus_status.changes += 1

    def configure(self) -> None:
        """Pass changed registers, units and bounds to the codec."""
        self.bus_status.changes += 1
        row, units, torque_offset = self.row, self.units, self.spec.torque_offset
        uses_current = row.limit_type == "current"
        scale = (units.torque_per_unit, torque_offset) if uses_current else (units.load(1), 0.0)
        numbers = (
            *self.family.codec_registers,
            *(units.zero, units.sign, units.count, abs(units.velocity(1))),
            *(*scale, uses_current, row.current_unit or nan),
            *(units.torque_per_unit, torque_offset),
            *(min(self.ceiling, units.full), units.usable(self.ceiling)),
            *(self.family.speed_max, units.no_load_speed),
            *(self.low, self.high, row.max_position, self.wraparound or 0, self.multi_turn),
            # Voltage registers have units of 0.1 V; the margin is for rounding.
            10.0 * self.min_voltage - 1e-6,
        )
        self.codec.configure(self.index, self.joint, [float(number) for number in numbers])

    def set_range(self) -> None:
        """Narrow the range of goals to the position limits of the joint, if both are given.

        Raises:
            ServoError: These limits lie on both sides of the seam of a single-turn encoder, where
                its count jumps from the largest value to 0.
        """
        spec = self.spec
        bounds = [bound for bound in (spec.lower, spec.upper) if bound is not None]
        if len(bounds) < 2:
            return
        low, high = sorted(self.units.counts(bound) for bound in bounds)
        if self.multi_turn:
            self.low, self.high = low, high
            return
        if low < 0 or high > self.row.max_position:
            raise ServoError(
                f"{self.name}: its range of {spec.lower:.2f} to {spec.upper:.2f} rad is counts "
                f"{low} to {high}, across the seam of an encoder that ends at 0 and "
                f"{self.row.max_position}: {self._range_remedy(low, high)}"
            )
        self.low, self.high = max(low, self.low), min(high, self.high)

    def _range_remedy(self, low: int, high: int) -> str:
        """Return the remedy for a range of `low` to `high` [counts] that the encoder lacks.

        Values that are implausible in their unit, and plausible in another, are named.
        """
        spec, zero = self.spec, self.spec.zero
        bounds = [bound for bound in (spec.lower, spec.upper) if bound is not None]
        largest = max(map(abs, bounds))
        if largest > 360.0:
            return "lower and upper are in rad, and these look like counts"
        if largest > TURN:
            values = " and ".join(f"{radians(bound):.3g}" for bound in bounds)
            return f"lower and upper are in rad, and these look like degrees: write {values}"
        remedy = (
            "check zero and sign, or mount the horn so that the middle of the range is near the "
            "middle of the counts"
        )
        for unit, turn in (("rad", TURN), ("degrees", 360.0)):
            if zero and abs(zero) <= turn:
                count = zero / turn * self.row.counts_per_turn
                if low + count - zero >= 0.0 and high + count - zero <= self.row.max_position:
                    given = f"zero is in counts: if {zero:g} is in {unit}, write {count:.0f}"
                    return f"{given}; else {remedy}"
        return remedy

    @property
    def name(self) -> str:
        """Joint name, with the servo id if the joint has two servos."""
        return self.spec.name if self.spec.secondary is None else f"{self.spec.name} (id {self.id})"

    @property
    def faults(self) -> tuple[str, ...]:
        """Present faults, one sentence each, with the joint name."""
        texts = (self.hardware or self.conditions) + tuple(self.other_faults.values())
        if not texts:
            return ()
        return tuple(f"{self.name}: {text}" for text in texts)

    @property
    def protections(self) -> tuple[str, ...]:
        """Protections that have tripped since torque on, one text each: joint, id, cause."""
        if not self._status_bits:
            return ()
        causes = status.protections(self.family, self._status_bits)
        return tuple(f"{self.spec.name} (id {self.id}): {cause}" for cause in causes)

    @property
    def position(self) -> float | None:
        """Unwrapped count of the last reading; None before the first reading."""
        position = self._reading()[0]
        return None if isnan(position) else position

    @property
    def goal(self) -> int | None:
        """Goal register as last written; None before the first write."""
        return self._sent[0]

    @property
    def limit(self) -> int:
        """Limit register as last written; 0 before the first write."""
        return self._sent[1]

    @property
    def _sent(self) -> Sent:
        """Last command that was sent, see `ServoCodec.sent`."""
        return self._last_sent if self._codec is None else self._codec.sent(self.index)

    def angle(self, position: float) -> float:
        """Return the joint angle [rad] at which this servo's position is `position` [counts]."""
        return self.units.angle(position)

    def packet(self, names: tuple[str, ...], goal: int, limit: int, speed: int) -> bytes:
        """Return the bytes to write to the contiguous registers `names`.

        `goal`, `limit` and `speed` are the values of goal, limit and speed cap register; other
        registers are 0.
        """
        block = self.family.write_blocks[self.family.write.index(names)]
        values = {"goal": goal, "limit": limit, "speed_cap": speed}
        return self.family.layout(block).encode(values)

    def accept(self, reply: Reply) -> bool:
        """Store the values of a reading; return False if its position is implausible."""
        block, data, status_byte, time = reply
        notable = self.codec.decode([self.index], [(data, status_byte)], block.address, time, inf)
        is_accepted = not notable or self.check_reading(bool(notable[0][1]), status_byte, time)
        if is_accepted and self.family.layout(block).has_status:
            self.note_status(reply)
        return is_accepted

    @property
    def time(self) -> float:
        """Time of the request of the last reading [s]."""
        return self._reading()[2]

    def _reading(self) -> list[float]:
        """Return the last accepted reading, see `ServoCodec.reading`; 3 numbers without codec."""
        if self._codec is None:
            return self._last_reading
        reading: list[float] = self._codec.reading(self.index).tolist()
        return reading

    def check_reading(self, is_accepted: bool, status_byte: int, time: float) -> bool:
        """Check a reading for faults, and return `is_accepted`.

        Only readings in which the codec has found an anomaly need this check. `MAX_JUMPS`
        implausible positions in a row are a fault.

        Args:
            is_accepted: Result of `ServoCodec.decode`: False if the position is implausible.
            status_byte: Status byte of the reply.
            time: Time of the request [s].
        """
        _, turns, _, voltage, temperature, supplied, rejected, jump = self._reading()
        if not is_accepted:
            if rejected >= MAX_JUMPS:
                self.fault(
                    "jump",
                    True,
                    f"its position jumped by {jump:.2f} rad, which it cannot have moved: encoder "
                    "fault, slipped horn or loose gear. Torque off, then check its zero",
                )
            return False
        self.fault("seam", turns != 0.0 and not self.multi_turn, SEAM_TEXT)
        readings = {"voltage": voltage, "temperature": temperature}
        values = {name: int(value) for name, value in readings.items() if not isnan(value)}
        if "voltage" in values:
            self._last_good_voltage = max(self._last_good_voltage, supplied)
        self._note(values, status_byte, time)
        return True

    def note_status(self, reply: Reply) -> None:
        """Store the values of status registers in a reading, as `note` does.

        In most cycles they equal the written values, which is tested first because it is fast.
        """
        block, data, _, time = reply
        is_new = block in self.family.read_with_status[:1]
        self.bus_status.set_new(self.index, is_new)
        if is_new and self.is_driven and self.codec.has_command(self.index, data, block.address):
            self._note_match(time)
        else:
            self.note(reply)

    @property
    def is_driven(self) -> bool:
        """True if torque is on, goal and limit read back as written, and `other_faults` is empty.

        Faults that the servo itself reports are not considered.
        """
        return self._enabled and not (self.has_mismatch or self.other_faults)

    def note_command(self, time: float) -> None:
        """Note that at `time` [s] a reading showed all status registers as written."""
        self.bus_status.set_new(self.index, True)
        self._note_match(time)

    def _note_match(self, time: float) -> None:
        """Note that at `time` [s] torque was on, and goal and limit were as written."""
        self.torque_on = True
        for read_back in self._read_backs.values():
            read_back.wrong, read_back.matched = 0, time

    def note(self, reply: Reply) -> None:
        """Store the values of status registers in a reply, and update the faults that they show."""
        values = self.family.layout(reply.block).decode(reply.data)
        self._note(values, reply.status, reply.time)

    def _note(self, values: Mapping[str, int], status_byte: int, time: float) -> None:
        """Store the values of the status registers among `values`, read at `time` [s].

        `status_byte` is the status of the reply.
        """
        self.bus_status.changes += 1
        if "hardware_error" in values:
            self.note_hardware_error(values["hardware_error"])
        if status_byte or self.conditions:
            # With Protocol 2.0, the status only says that a bit of the error register is set.
            ignored = status.ALERT if self.has_harmless_error else self.harmless
            conditions = status.conditions(self.family, status_byte & ~ignored)
            if self._enabled:
                self._status_bits |= status_byte & ~ignored
            self.alerts += bool(set(conditions) - set(self.conditions))
            self.conditions = conditions
        if "voltage" in values:
            self.set_voltage(values["voltage"] / 10.0, time)
        if "temperature" in values:
            self.temperature = float(values["temperature"])
        if "limit" in values:
            self._compare("limit", values["limit"], self.limit, time)
        if "goal" in values and (goal := self.goal) is not None:
            self._compare("goal", values["goal"], goal, time)
        if "torque_enable" in values:
            self.torque_on, self.torque_unknown = bool(values["torque_enable"]), False
            went_off = (self._enabled or "torque" in self.other_faults) and not self.torque_on
            if went_off or self.other_faults:
                self.fault(
                    "torque",
                    went_off,
                    "its torque went off by itself: look at plug and power supply",
                )
            if went_off:
                # Send no more goals: on some servos a goal switches torque on, and the joint may
                # have moved far.
                self.enabled = False
        if "watchdog" in values:
            self.watchdog = values["watchdog"]
            tripped = self.watchdog == TRIPPED
            self.trips += tripped and not self.tripped
            self.tripped = tripped

    def note_hardware_error(self, value: int) -> None:
        """Store the value of the hardware error register (Protocol 2.0)."""
        self.hardware = status.hardware(value & ~self.harmless)
        self.has_harmless_error = bool(value) and not self.hardware

    def heat(self) -> str:
        """Return a text if the servo is about to switch off or has done so, else an empty one."""
        temperature = self.temperature
        if temperature is None or temperature < self.temperature_limit - HEAT_MARGIN:
            return ""
        limit, remedy = self.temperature_limit, "let it cool before its torque comes on"
        if limit < MIN_TEMPERATURE_LIMIT:
            remedy = "its Temperature Limit is wrong, 70 is usual: set it with the maker's tool"
        return f"it is at {temperature:.0f} °C and switches off at {limit:.0f}: {remedy}"

    @property
    def is_refusing(self) -> bool:
        """True if goals are known not to reach the servo, or to be rejected."""
        return self._enabled and (self.tripped or self._read_backs["goal"].wrong >= MISMATCHES)

    def set_voltage(self, volts: float, time: float) -> None:
        """Store the supply voltage [V], read at `time` [s], and update the unit conversions.

        An undervoltage is a fault if it lasts longer than `UNDERVOLTAGE_GRACE`.
        """
        self.voltage = volts
        if volts >= self.min_voltage:
            self._last_good_voltage = time
        is_low = time - self._last_good_voltage > UNDERVOLTAGE_GRACE
        if is_low or self.other_faults:
            self.fault(
                "voltage",
                is_low,
                f"its supply is {volts:.1f} V and it needs {self.min_voltage:.1f} V: a supply that "
                "is too weak, or thin or long wires",
            )
        if volts != self.units.voltage and volts > 0.0:
            self.units = replace(self.units, voltage=volts)
            if self._codec is not None:
                self.configure()

    def accept_any_position(self) -> None:
        """Accept any position at the next reading, because a joint without torque can be moved."""
        self.codec.accept_any(self.index, nan, nan, nan)
        self.fault("jump", False, "")

    def fault(self, key: str, is_wrong: bool, text: str) -> None:
        """Set the fault of the topic `key` with this text if `is_wrong`, else clear it."""
        if is_wrong:
            self.other_faults[key] = text
            self.bus_status.changes += 1
        elif self.other_faults.pop(key, None) is not None:
            self.bus_status.changes += 1

    @property
    def has_suspect_register(self) -> bool:
        """True if goal or limit do not read back as written, but not long enough for a fault."""
        for key, read_back in self._read_backs.items():
            if read_back.wrong > 0 and key not in self.other_faults:
                return True
        return False

    def record_sent(self, goal: int | None, limit: int, packet: bytes = b"") -> None:
        """Record the values of goal and limit register in a packet that was sent.

        `packet` contains the bytes written to the first block of registers; empty if unknown.
        """
        self.codec.record_sent(self.index, goal, limit, packet)

    def _compare(self, key: str, value: int, written: int, time: float) -> None:
        """Compare a register with the written value, because a servo may reject packets silently.

        Single packets also get lost, so a mismatch is a fault only after `MISMATCHES` packets and
        `MISMATCH_TIME`.

        Args:
            key: Register: `goal` or `limit`.
            value: Value read.
            written: Value written.
            time: Time of the reading [s].
        """
        read_back = self._read_backs[key]
        if not self._enabled or value == written:
            read_back.wrong, read_back.matched = 0, time
        elif read_back.write != (write := self._sent[2]):
            read_back.wrong += 1
            read_back.write = write
            self.mismatches += 1
        self.has_mismatch = bool(self._read_backs["goal"].wrong or self._read_backs["limit"].wrong)
        matched = max(read_back.matched, self.bus_status.matched(self.index))
        is_wrong = read_back.wrong >= MISMATCHES and time - matched > MISMATCH_TIME
        if is_wrong or self.other_faults:
            self.fault(key, is_wrong, self._mismatch(key, value, written) if is_wrong else "")

    def _mismatch(self, key: str, value: int, written: int) -> str:
        """Return the fault text for a register `goal` or `limit` that did not take its value."""
        if key == "limit":
            name, values = (
                "torque limit",
                [f"{self.units.torque(n):.3g} N·m" for n in (value, written)],
            )
        else:
            name, values = "goal", [f"{self.angle(n):.3g} rad" for n in (value, written)]
        return (
            f"its {name} reads {value} ({values[0]}), written was {written} ({values[1]}): "
            "writes do not arrive, or it rejects them"
        )
