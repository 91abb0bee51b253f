"""State of one servo on the bus: the values last written and read, and their unit conversion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pliant._core import ServoError
from pliant.servo import _status as status
from pliant.servo.spec import Units

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pliant.servo._transactions import Reply
    from pliant.servo.models import Family, ServoModel
    from pliant.servo.spec import ServoSpec

#: Longest undervoltage that is not reported as a fault [s].
UNDERVOLTAGE_GRACE = 0.5
#: Tolerance of the check for implausible positions [rad]: a position may change by this, plus the
#: distance at twice the no-load speed since the last accepted position.
JUMP_MARGIN = 0.1
#: A goal or limit register that does not read back as written is a fault after `MISMATCH_TIME` [s]
#: and `MISMATCHES` packets.
MISMATCH_TIME, MISMATCHES = 0.5, 3
#: Number of consecutive implausible positions that is reported as a fault; and time between two
#: readings [s] above which the accepted change of position grows even after an implausible one,
#: because the joint may have moved in that time.
MAX_JUMPS, READING_GAP = 3, 0.1
#: Value of the register Bus Watchdog after it has tripped.
TRIPPED = 255
SEAM_TEXT = (
    "it stands past the seam of its encoder, where goals would send it the long way round: "
    "move it back by hand"
)


@dataclass
class ReadBack:
    """Result of reading a register back and comparing it with the value written.

    Attributes:
        wrong: Number of write packets in a row after which the register had another value.
        matched: Time at which the register last had the value written [s].
        write: Sequence number of the last write packet after which it had another value.
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

    Attributes:
        units: Unit conversions at the latest supply voltage.
        ceiling: Largest value of the limit register that the servo accepts.
        gain: Gain register of the position loop as read.
        low, high: Smallest and largest goal [counts].
        min_voltage: Lowest supply voltage at which the servo can be driven [V].
        alerts: Number of replies with a new error in the status byte, even if brief.
        multi_turn: True if goals may exceed one turn.
        overload: Share of the full torque above which overload protection acts; None: never.
        wraparound: Counts per turn after which positions wrap around; None if they do not.
        enabled: True if this program switched the torque on, or took over a servo with torque on.
        torque_on: True if torque was on at the last reading of Torque Enable.
        goal, limit: Goal and limit register as last written; goal is None before the first write.
        position: Unwrapped count of the last reading; None before the first reading.
        time: Time of the request of the last reading [s].
        speed, load, current: Register values of the last reading; current is None without sensor.
        voltage, temperature: Supply voltage [V] and temperature [°C] as last read.
        limit_read: Limit register as last read.
        conditions: Errors in the status of the last reply.
        hardware: Errors in the hardware error register (Protocol 2.0).
        other_faults: Other faults, by topic.
        watchdog: Bus watchdog as last read [units of 20 ms].
        tripped: True if the bus watchdog has tripped, so that the servo rejects goals.
        trips: Number of trips of the bus watchdog.
        initial_values: Values at open of the RAM registers that this program writes.
        stored_command: Goal and limit registers of a servo whose torque was on at open; None
            otherwise.
        drive_values: Registers that bound torque or motion, and the values that `enable` writes.
        mismatches: Number of times a register did not read back as written.
    """

    def __init__(self, spec: ServoSpec, joint: int, id: int, sign: int) -> None:
        """Store joint, id and sign; the other values are defaults until the servo is read."""
        self.spec, self.joint, self.id = spec, joint, id
        self.row: ServoModel = spec.row
        self.family: Family = self.row.family
        self.units = replace(Units.of(spec), sign=sign)
        self.ceiling = self.units.full
        self.gain = self.row.gain_default
        self.low, self.high = 0, self.row.max_position
        is_full_turn = self.row.counts_per_turn == self.row.max_position + 1
        self.wraparound: int | None = self.row.max_position + 1 if is_full_turn else None
        self.multi_turn = self.family.multi_turn
        self.overload: float | None = self.row.overload
        self.min_voltage, self._last_good_voltage = 0.0, 0.0
        self.alerts = 0
        self.turns = 0
        self.enabled = self.torque_on = False
        self.goal: int | None = None
        self.limit = 0
        self.position: float | None = None
        self.time = 0.0
        self.speed = self.load = 0
        self.current: int | None = None
        self.voltage: float | None = None
        self.temperature: float | None = None
        self.limit_read: int | None = None
        self.conditions: tuple[str, ...] = ()
        self.hardware: tuple[str, ...] = ()
        self.other_faults: dict[str, str] = {}
        self.initial_values: dict[str, int] = {}
        self.stored_command: tuple[int, int] | None = None
        self.drive_values: dict[str, int] = {}
        self.mismatches = 0
        self._writes = 0
        self._read_backs = {"goal": ReadBack(), "limit": ReadBack()}
        self._has_mismatch = False
        self.tripped, self.trips, self.watchdog = False, 0, 0
        self._rejected, self._allowed, self._last = 0, 0.0, 0.0

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
                f"{self.row.max_position}: check zero and sign, or mount the horn so that the "
                "middle of the range is near the middle of the counts"
            )
        self.low, self.high = max(low, self.low), min(high, self.high)

    @property
    def name(self) -> str:
        """Joint name, with the servo id if the joint has two servos."""
        return self.spec.name if self.spec.secondary is None else f"{self.spec.name} (id {self.id})"

    @property
    def faults(self) -> tuple[str, ...]:
        """Present faults, one sentence each, with the joint name."""
        found = (self.hardware or self.conditions) + tuple(self.other_faults.values())
        return tuple(f"{self.name}: {text}" for text in found)

    def angle(self, position: float) -> float:
        """Return the joint angle [rad] at which this servo's position is `position` [counts]."""
        return self.units.angle(position)

    def goal_counts(self, angle: float) -> int:
        """Return the value of the goal register for a joint angle [rad], within the goal range.

        A single-turn servo that was pushed past the seam of its encoder, where the count jumps,
        would move to such a goal the long way round. Its goal is the end of the encoder at which
        it stands instead.
        """
        counts = self.units.counts(angle)
        if self.multi_turn:
            return self.clamp(counts) - self.turns * (self.wraparound or 0)
        if self.turns:
            return 0 if self.turns > 0 else self.row.max_position
        return max(self.low, min(counts, self.high))

    def clamp(self, counts: int) -> int:
        """Return `counts` clamped to the goal range [counts].

        For a multi-turn servo that stands outside, the range extends to its present position.
        """
        low, high = self.low, self.high
        if self.position is not None and self.multi_turn:
            low, high = min(low, round(self.position)), max(high, round(self.position))
        return max(low, min(counts, high))

    def limit_register(self, torque: float) -> int:
        """Return the value of the limit register for a joint torque [N·m], at most `ceiling`."""
        return self.units.register(min(torque, self.units.usable(self.ceiling)), self.ceiling)

    def packet(self, names: tuple[str, ...], goal: int, limit: int, speed: int) -> bytes:
        """Return the bytes to write to the contiguous registers `names`.

        `goal`, `limit` and `speed` are the values of goal, limit and speed cap register; other
        registers are 0.
        """
        block = self.family.write_blocks[self.family.write.index(names)]
        values = {"goal": goal, "limit": limit, "speed_cap": speed}
        return self.family.layout(block).encode(values)

    def accept(self, reply: Reply) -> bool:
        """Store the values of a reading and return True, unless its position is implausible."""
        values = self.family.layout(reply.block).decode(reply.data)
        turns, position = self._unwrap(values["position"])
        if not self._is_reachable(position, reply.time):
            return False
        self.turns, self.position, self.time = turns, position, reply.time
        if turns or self.other_faults:
            self.fault("seam", turns != 0 and not self.multi_turn, SEAM_TEXT)
        self.speed = values["speed"]
        self.load = values.get("load", self.load)
        self.current = values.get("current", self.current)
        self._note(values, reply.status, reply.time)
        return True

    def note(self, reply: Reply) -> None:
        """Store the values of status registers that a reply contains, and the faults they show."""
        values = self.family.layout(reply.block).decode(reply.data)
        self._note(values, reply.status, reply.time)

    def _note(self, values: Mapping[str, int], status_byte: int, time: float) -> None:
        """Store the values of the status registers among `values`, read at `time` [s].

        `status_byte` is the status of the reply.
        """
        if status_byte or self.conditions:
            before, self.conditions = self.conditions, status.conditions(self.family, status_byte)
            self.alerts += bool(set(self.conditions) - set(before))
        if "voltage" in values:
            self.set_voltage(values["voltage"] / 10.0, time)
        if "temperature" in values:
            self.temperature = float(values["temperature"])
        if "limit" in values:
            self.limit_read = values["limit"]
            self._compare("limit", values["limit"], self.limit, time)
        if "goal" in values and self.goal is not None:
            self._compare("goal", values["goal"], self.goal, time)
        if "torque_enable" in values:
            self.torque_on = bool(values["torque_enable"])
            went_off = (self.enabled or "torque" in self.other_faults) and not self.torque_on
            self.fault("torque", went_off, "its torque went off by itself")
            if went_off:
                # Send no more goals: on some servos a goal switches torque on, and the joint may be
                # far from it now.
                self.enabled = False
        if "hardware_error" in values:
            self.hardware = status.hardware(values["hardware_error"])
        if "watchdog" in values:
            self.watchdog = values["watchdog"]
            tripped = self.watchdog == TRIPPED
            self.trips += tripped and not self.tripped
            self.tripped = tripped

    @property
    def is_refusing(self) -> bool:
        """True if the servo is known not to receive goals, or to reject them."""
        return self.enabled and (self.tripped or self._read_backs["goal"].wrong >= MISMATCHES)

    @property
    def torque(self) -> float:
        """Joint torque [N·m] from this servo's current or load register.

        Two servos on one joint are assumed to exert equal torques.
        """
        if self.row.limit_type == "current":
            return self.units.sign * self.units.torque(self.current or 0)
        return self.units.sign * self.units.load(self.load)

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

    def _is_reachable(self, position: float, time: float) -> bool:
        """Return True if the joint can have reached `position` [counts] at `time` [s].

        The accepted distance from the last accepted position grows with time, but not while
        implausible positions arrive. `MAX_JUMPS` implausible positions in a row are a fault.
        """
        if self.position is None or self._allowed == float("inf"):
            self._rejected, self._allowed, self._last = 0, 0.0, time
            self.fault("jump", False, "")
            return True
        gap, self._last = time - self._last, time
        if not self._rejected or gap > READING_GAP:
            self._allowed += gap
        jump = abs(position - self.position) * self.units.count
        if jump <= 2.0 * self.units.no_load_speed * self._allowed + JUMP_MARGIN:
            self._rejected, self._allowed = 0, 0.0
            return True
        self._rejected += 1
        if self._rejected >= MAX_JUMPS:
            self.fault(
                "jump",
                True,
                f"its position jumped by {jump:.2f} rad, which it cannot have moved: encoder "
                "fault, slipped horn or loose gear. Torque off, then check its zero",
            )
        return False

    def accept_any_position(self) -> None:
        """Accept any position at the next reading, because a joint without torque can be moved."""
        self._allowed = float("inf")

    def fault(self, key: str, is_wrong: bool, text: str) -> None:
        """Set the fault of the topic `key` with this text if `is_wrong`, else clear it."""
        if is_wrong:
            self.other_faults[key] = text
        else:
            self.other_faults.pop(key, None)

    @property
    def is_inconspicuous(self) -> bool:
        """True if the servo has no fault, and all its registers read back as written so far."""
        return not (self.conditions or self.other_faults or self._has_mismatch)

    @property
    def has_suspect_register(self) -> bool:
        """True if goal or limit do not read back as written, but not long enough for a fault."""
        for key, read_back in self._read_backs.items():
            if read_back.wrong > 0 and key not in self.other_faults:
                return True
        return False

    def record_sent(self, goal: int, limit: int) -> None:
        """Record the values of goal and limit register in a packet that was sent."""
        self.goal, self.limit = goal, limit
        self._writes += 1

    def _compare(self, key: str, found: int, written: int, time: float) -> None:
        """Compare a register with the value written, because a servo may reject packets silently.

        Single packets also get lost. A mismatch is therefore a fault only after `MISMATCHES`
        packets and `MISMATCH_TIME`.

        Args:
            key: Register: `goal` or `limit`.
            found: Value read.
            written: Value written.
            time: Time of the reading [s].
        """
        read_back = self._read_backs[key]
        if not self.enabled or found == written:
            read_back.wrong, read_back.matched = 0, time
        elif read_back.write != self._writes:
            read_back.wrong += 1
            read_back.write = self._writes
            self.mismatches += 1
        self._has_mismatch = any(entry.wrong for entry in self._read_backs.values())
        is_wrong = read_back.wrong >= MISMATCHES and time - read_back.matched > MISMATCH_TIME
        self.fault(key, is_wrong, self._mismatch(key, found, written) if is_wrong else "")

    def _mismatch(self, key: str, found: int, written: int) -> str:
        """Return the fault text for a register `goal` or `limit` that differs from that written."""
        if key == "limit":
            name, values = (
                "torque limit",
                [f"{self.units.torque(n):.3g} N·m" for n in (found, written)],
            )
        else:
            name, values = "goal", [f"{self.angle(n):.3g} rad" for n in (found, written)]
        return (
            f"its {name} reads {found} ({values[0]}), written was {written} ({values[1]}): it does "
            "not hear, or refuses"
        )

    def _unwrap(self, raw: int) -> tuple[int, float]:
        """Return whole turns and unwrapped count of the position register value `raw`.

        The turns are those with which the count is nearest to the last position.
        """
        if self.wraparound is None:
            return 0, float(raw)
        reference = self.position if self.position is not None else (self.low + self.high) / 2
        turns = round((reference - raw) / self.wraparound) if self.position is not None else 0
        if self.position is None and not self.low <= raw <= self.high:
            candidate = round((reference - raw) / self.wraparound)
            turns = candidate if self.multi_turn else 0
        return turns, float(raw + turns * self.wraparound)
