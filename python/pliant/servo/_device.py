"""State of one servo on the bus: last values written and read, and their conversion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pliant._core import ServoError
from pliant.servo import _status as status
from pliant.servo.spec import Units

if TYPE_CHECKING:
    from pliant.servo._transactions import Reply
    from pliant.servo.models import Block, Family, ServoModel
    from pliant.servo.spec import ServoSpec

#: Longest undervoltage without a fault [s].
UNDERVOLTAGE_GRACE = 0.5
#: A reading is plausible up to this far [rad] beyond the distance at twice the no-load speed.
JUMP = 0.1
#: A register that reads back wrong is a fault after `MISMATCH_TIME` [s] and `MISMATCHES` packets.
MISMATCH_TIME, MISMATCHES = 0.5, 3
#: `IMPOSSIBLE`: number of implausible readings in a row that is reported as a fault. `PAUSE`: gap
#: between readings above which the joint may have moved unseen even after a jump [s].
IMPOSSIBLE, PAUSE = 3, 0.1
#: Value of the register Bus Watchdog after it has tripped.
TRIPPED = 255


@dataclass
class ReadBack:
    """Comparison of a register with the value written.

    Attributes:
        wrong: Number of packets in a row after which it read a wrong value.
        matched: Time at which it last read as written [s].
        write: Number of the last packet after which it read wrong.
    """

    wrong: int = 0
    matched: float = 0.0
    write: int = -1


class Device:
    """State of one servo.

    Args:
        spec: Joint and servo.
        joint: Index of the joint.
        id: Id on the bus.
        sign: +1 or -1.

    Attributes:
        units: Conversions at the latest voltage.
        ceiling: Largest limit register that the servo accepts.
        gain: Gain register as read.
        low, high: Range of goals [counts].
        min_voltage: Lowest voltage at which it can be driven [V].
        alerts: Number of errors that appeared in its status, even if the next answer cleared them.
        multi_turn: Whether goals may exceed one turn.
        overload: Share of the full torque above which overload protection acts; None: never.
        wraparound: Counts per turn after which positions wrap around; None: they do not.
        enabled: Whether this program switched its torque on, or took it over.
        torque_on: Whether torque was on at the last reading of that register.
        goal, limit: Goal and limit register as last written; goal is None before the first.
        position: Unwrapped count of the last reading; None before the first.
        time: Time of the request of that reading [s].
        speed, load, current: Registers of the last reading.
        voltage, temperature: As last read [V, °C].
        limit_read: Limit register as last read.
        conditions: Errors in the status of the last answer.
        hardware: Errors in the hardware error register (Protocol 2.0).
        other_faults: Other faults, by topic.
        watchdog: Bus watchdog as last read [units of 20 ms].
        tripped: Whether its bus watchdog has tripped, so that it refuses goals.
        trips: Number of trips found.
        initial_values: Values at open of the RAM registers that are written, to restore them.
        stored_command: Goal and limit registers of a servo whose torque was on at open; None
            otherwise.
        drive_values: Registers that bound torque or motion, and their values while driven.
        mismatches: Number of times a register did not read back as written.
    """

    def __init__(self, spec: ServoSpec, joint: int, id: int, sign: int) -> None:
        """Store joint, id and sign; all values of the servo are unknown until they are read."""
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
        self.tripped, self.trips, self.watchdog = False, 0, 0
        self._rejected, self._allowed, self._last = 0, 0.0, 0.0

    def set_range(self) -> None:
        """Narrow the goal range to that of the joint.

        Raises:
            ServoError: The joint's range crosses the seam of a single-turn encoder.
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
        """Return the joint angle of a count of this servo [rad]."""
        return self.units.angle(position)

    def goal_counts(self, angle: float) -> int:
        """Return the goal register of a joint angle, within the goal range.

        If a single-turn servo was pushed past its encoder seam, a goal on the other side would turn
        it the long way round. It gets the range end on its own side instead.
        """
        if self.turns and not self.multi_turn:
            return 0 if self.turns > 0 else self.row.max_position
        return self.clamp(self.units.counts(angle)) - self.turns * (self.wraparound or 0)

    def clamp(self, counts: int) -> int:
        """Clamp a count to the goal range; a multi-turn servo outside the range may stay there."""
        low, high = self.low, self.high
        if self.position is not None and self.multi_turn:
            low, high = min(low, round(self.position)), max(high, round(self.position))
        return max(low, min(counts, high))

    def limit_register(self, torque: float) -> int:
        """Return the limit register of a joint torque [N·m], at most the servo's ceiling."""
        return self.units.register(min(torque, self.units.usable(self.ceiling)), self.ceiling)

    def packet(self, names: tuple[str, ...], goal: int, limit: int, speed: int) -> bytes:
        """Return the bytes of a packet; fields other than goal, limit and speed cap are 0."""
        values = {"goal": goal, "limit": limit, "speed_cap": speed}
        return b"".join(self.family.registers[n].encode(values.get(n, 0)) for n in names)

    def accept(self, reply: Reply) -> bool:
        """Store a reading; return False if it is implausible, as the joint would have jumped."""
        family = self.family
        raw = family.decode(reply.block, reply.data, "position")
        turns, position = self._unwrap(raw)
        if not self._is_reachable(position, reply.time):
            return False
        self.turns, self.position, self.time = turns, position, reply.time
        self.fault(
            "seam",
            turns != 0 and not self.multi_turn,
            "it stands past the seam of its encoder, where goals would send it the long way round: "
            "move it back by hand",
        )
        self.speed = family.decode(reply.block, reply.data, "speed")
        for name in ("load", "current"):
            if name in family.registers:
                setattr(self, name, family.decode(reply.block, reply.data, name))
        self.note(reply)
        return True

    def note(self, reply: Reply) -> None:
        """Store voltage, temperature, limit and health from a block that was read."""
        family, block = self.family, reply.block
        before, self.conditions = self.conditions, status.conditions(family, reply.status)
        self.alerts += bool(set(self.conditions) - set(before))
        if self._contains(block, "voltage"):
            self.set_voltage(family.decode(block, reply.data, "voltage") / 10.0, reply.time)
        if self._contains(block, "temperature"):
            self.temperature = float(family.decode(block, reply.data, "temperature"))
        if self._contains(block, "limit"):
            self.limit_read = found = family.decode(block, reply.data, "limit")
            read, written = (f"{self.units.torque(n):.3g} N·m" for n in (found, self.limit))
            self._compare("limit", found, self.limit, reply.time, (read, written))
        if self._contains(block, "goal") and self.goal is not None:
            found = family.decode(block, reply.data, "goal")
            read, written = (f"{self.angle(n):.3g} rad" for n in (found, self.goal))
            self._compare("goal", found, self.goal, reply.time, (read, written))
        if self._contains(block, "torque_enable"):
            self.torque_on = bool(family.decode(block, reply.data, "torque_enable"))
            went_off = (self.enabled or "torque" in self.other_faults) and not self.torque_on
            self.fault("torque", went_off, "its torque went off by itself")
            if went_off:
                # Send no more goals: some servos would switch torque on at a goal far from the
                # position.
                self.enabled = False
        if self._contains(block, "hardware_error"):
            self.hardware = status.hardware(family.decode(block, reply.data, "hardware_error"))
        if self._contains(block, "watchdog"):
            self.watchdog = family.decode(block, reply.data, "watchdog")
            tripped = self.watchdog == TRIPPED
            self.trips += tripped and not self.tripped
            self.tripped = tripped

    @property
    def is_refusing(self) -> bool:
        """True if goals are known not to arrive or to be rejected."""
        return self.enabled and (self.tripped or self._read_backs["goal"].wrong >= MISMATCHES)

    @property
    def torque(self) -> float:
        """Joint torque as the servo estimates it, if all its servos exert the same [N·m]."""
        if self.row.limit_type == "current":
            return self.units.sign * self.units.torque(self.current or 0)
        return self.units.sign * self.units.load(self.load)

    def set_voltage(self, volts: float, time: float) -> None:
        """Update the conversions to the supply voltage: the torque of a duty is proportional to it.

        A brief undervoltage is tolerated, a longer one is a fault.
        """
        self.voltage = volts
        if volts >= self.min_voltage:
            self._last_good_voltage = time
        self.fault(
            "voltage",
            time - self._last_good_voltage > UNDERVOLTAGE_GRACE,
            f"its supply is {volts:.1f} V and it needs {self.min_voltage:.1f} V: a supply that is "
            "too weak, or thin or long wires",
        )
        if volts != self.units.voltage and volts > 0.0:
            self.units = replace(self.units, voltage=volts)

    def _is_reachable(self, position: float, time: float) -> bool:
        """Return True if the joint can have reached a position since its last good reading.

        The allowed distance grows with time, but not while implausible readings arrive. Several of
        these in a row are a fault and are never accepted.
        """
        if self.position is None or self._allowed == float("inf"):
            self._rejected, self._allowed, self._last = 0, 0.0, time
            self.fault("jump", False, "")
            return True
        gap, self._last = time - self._last, time
        if not self._rejected or gap > PAUSE:
            self._allowed += gap
        jump = abs(position - self.position) * self.units.count
        if jump <= 2.0 * self.units.no_load_speed * self._allowed + JUMP:
            self._rejected, self._allowed = 0, 0.0
            return True
        self._rejected += 1
        if self._rejected >= IMPOSSIBLE:
            self.fault(
                "jump",
                True,
                f"its position jumped by {jump:.2f} rad, which it cannot have moved: encoder "
                "fault, slipped horn or loose gear. Torque off, then check its zero",
            )
        return False

    def accept_any_position(self) -> None:
        """Accept any position next: without torque the joint may be moved by hand."""
        self._allowed = float("inf")

    def _contains(self, block: Block, name: str) -> bool:
        register = self.family.registers.get(name)
        if register is None:
            return False
        end = block.address + block.size
        return block.address <= register.address and register.address + register.size <= end

    def fault(self, key: str, is_wrong: bool, text: str) -> None:
        """Set or clear a fault."""
        if is_wrong:
            self.other_faults[key] = text
        else:
            self.other_faults.pop(key, None)

    @property
    def has_suspect_register(self) -> bool:
        """True if goal or limit read back wrong, but not long enough for a fault."""
        return any(
            e.wrong > 0 and key not in self.other_faults for key, e in self._read_backs.items()
        )

    def record_sent(self, goal: int, limit: int) -> None:
        """Record a packet that is sent with this goal and limit."""
        self.goal, self.limit = goal, limit
        self._writes += 1

    def _compare(
        self, key: str, found: int, written: int, time: float, status: tuple[str, str]
    ) -> None:
        """Compare a register with the value written, since a servo rejects a packet silently.

        Packets also get lost, so a mismatch is a fault only after several packets and a minimum
        time.
        """
        read_back = self._read_backs[key]
        if not self.enabled or found == written:
            read_back.wrong, read_back.matched = 0, time
        elif read_back.write != self._writes:
            read_back.wrong += 1
            read_back.write = self._writes
            self.mismatches += 1
        name = "torque limit" if key == "limit" else "goal"
        self.fault(
            key,
            read_back.wrong >= MISMATCHES and time - read_back.matched > MISMATCH_TIME,
            f"its {name} reads {found} ({status[0]}), written was {written} ({status[1]}): it does "
            "not hear, or refuses",
        )

    def _unwrap(self, raw: int) -> tuple[int, float]:
        """Return turns and unwrapped count of a position register, nearest to the last position."""
        if self.wraparound is None:
            return 0, float(raw)
        reference = self.position if self.position is not None else (self.low + self.high) / 2
        turns = round((reference - raw) / self.wraparound) if self.position is not None else 0
        if self.position is None and not self.low <= raw <= self.high:
            candidate = round((reference - raw) / self.wraparound)
            turns = candidate if self.multi_turn else 0
        return turns, float(raw + turns * self.wraparound)
