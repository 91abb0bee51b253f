"""One servo on the bus: what it was last told, what it last said, and how its numbers read."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pliant import ServoError
from pliant.servo import status as words
from pliant.servo.units import Units

if TYPE_CHECKING:
    from pliant.servo.guard import Reply
    from pliant.servo.models import Block, Family, ServoModel
    from pliant.servo.spec import ServoSpec

#: A supply may be too low for so long [s].
SAG = 0.5
#: Positions may run this much ahead of twice the no-load speed before a reading is disbelieved
#: [rad].
JUMP = 0.1
#: A limit that reads back wrong for so long [s], and after so many packets, is a fault: writing is
#: given as long as reading.
UNHEARD, MISMATCHES = 0.5, 3
#: Readings in a row that a joint cannot have reached and that are a fault, and a pause between
#: readings after which it may have moved meanwhile [s].
IMPOSSIBLE, PAUSE = 3, 0.1
#: What the bus watchdog reads once it has tripped.
TRIPPED = 255


@dataclass
class Echo:
    """How a register that was written reads back.

    Attributes:
        wrong: After so many packets in a row it read other than written.
        agreed: When it last read as written [s].
        write: Number of the packet after which it last read wrong.
    """

    wrong: int = 0
    agreed: float = 0.0
    write: int = -1


class Device:
    """State of one servo.

    Args:
        spec: Its joint.
        joint: Index of the joint.
        id: Id on the bus.
        sign: +1 or -1.

    Attributes:
        units: Conversions at the latest voltage.
        ceiling: Largest limit the servo takes.
        gain: Gain register as read.
        low, high: Counts that goals stay within.
        starved: Voltage below which it cannot be driven [V].
        alerts: How often its status began to say that something is wrong, also where that was gone
            again with the next answer.
        multi_turn: Whether goals may leave one turn.
        overload: Share of the full torque above which it protects itself, None where it does not.
        seam: Counts after which positions start again, None where they do not.
        enabled: Whether we have switched its torque on, or taken it over.
        torque_on: Whether torque was on when that was last read.
        goal, limit: Goal and limit register as last written; no goal yet: None.
        position: Unwrapped count of the last reading, None before the first.
        time: When that was asked for [s].
        speed, load, current: Registers of the last reading.
        voltage, temperature: As last read [V, °C].
        limit_read: Limit register as last read.
        conditions: What the last answer's status said.
        hardware: What the hardware error register said (Protocol 2.0).
        rota: Faults that the rota found, by what they concern.
        watchdog: Its bus watchdog as last read [units of 20 ms].
        tripped: Whether its bus watchdog has tripped, and it refuses goals.
        trips: How often that was found.
        found: Registers in RAM that we write, as they are handed back: as they were at open.
        standing: Goal and limit registers of a servo that had torque at open; None otherwise.
        unbound: Registers that bound torque or motion, and what they are while we drive.
        mismatches: How often a limit read back other than written.
    """

    def __init__(self, spec: ServoSpec, joint: int, id: int, sign: int) -> None:
        """A servo nothing is known of yet."""
        self.spec, self.joint, self.id = spec, joint, id
        self.row: ServoModel = spec.row
        self.family: Family = self.row.family
        self.units = replace(Units.of(spec), sign=sign)
        self.ceiling = self.units.full
        self.gain = self.row.gain_default
        self.low, self.high = 0, self.row.counts
        whole = self.row.resolution == self.row.counts + 1
        self.seam: int | None = self.row.counts + 1 if whole else None
        self.multi_turn = self.family.multi_turn
        self.overload: float | None = self.row.overload
        self.starved, self._fed = 0.0, 0.0
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
        self.rota: dict[str, str] = {}
        self.found: dict[str, int] = {}
        self.standing: tuple[int, int] | None = None
        self.unbound: dict[str, int] = {}
        self.mismatches = 0
        self._writes = 0
        self._echoes = {"goal": Echo(), "limit": Echo()}
        self.tripped, self.trips, self.watchdog = False, 0, 0
        self._refused, self._allowed, self._last = 0, 0.0, 0.0

    def set_range(self) -> None:
        """Narrow the limits of goals to those of the joint.

        Raises:
            ServoError: The joint's range crosses the seam of a single-turn encoder.
        """
        spec = self.spec
        given = [bound for bound in (spec.lower, spec.upper) if bound is not None]
        if len(given) < 2:
            return
        low, high = sorted(self.units.counts(bound) for bound in given)
        if self.multi_turn:
            self.low, self.high = low, high
            return
        if low < 0 or high > self.row.counts:
            raise ServoError(
                f"{self.name}: its range of {spec.lower:.2f} to {spec.upper:.2f} rad is counts "
                f"{low} to {high}, across the seam of an encoder that ends at 0 and "
                f"{self.row.counts}: check zero and sign, or mount the horn so that the middle of "
                "the range is near the middle of the counts"
            )
        self.low, self.high = max(low, self.low), min(high, self.high)

    @property
    def name(self) -> str:
        """The joint, with the id where it has two servos."""
        return self.spec.name if self.spec.secondary is None else f"{self.spec.name} (id {self.id})"

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong with it, in sentences that name it."""
        found = (self.hardware or self.conditions) + tuple(self.rota.values())
        return tuple(f"{self.name}: {text}" for text in found)

    def angle(self, position: float) -> float:
        """Joint angle of a count of this servo [rad]."""
        return self.units.angle(position)

    def goal_counts(self, angle: float) -> int:
        """Goal register of a joint angle, within the limits of the servo.

        A single-turn servo that was pushed past its seam would take the long way back round to any
        goal on the other side; it gets the edge on its own side and stays.
        """
        if self.turns and not self.multi_turn:
            return 0 if self.turns > 0 else self.row.counts
        return self.clamp(self.units.counts(angle)) - self.turns * (self.seam or 0)

    def clamp(self, counts: int) -> int:
        """A count within the software limits; where the servo is outside them, it may stay."""
        low, high = self.low, self.high
        if self.position is not None and self.multi_turn:
            low, high = min(low, round(self.position)), max(high, round(self.position))
        return max(low, min(counts, high))

    def limit_register(self, torque: float) -> int:
        """Limit register of a torque of the joint [N·m], at most what the servo can give."""
        return self.units.register(min(torque, self.units.usable(self.ceiling)), self.ceiling)

    def packet(self, names: tuple[str, ...], goal: int, limit: int, speed: int) -> bytes:
        """Bytes of a packet of these fields; what is not goal, limit or speed cap is 0."""
        values = {"goal": goal, "limit": limit, "speed_cap": speed}
        return b"".join(self.family.registers[n].encode(values.get(n, 0)) for n in names)

    def accept(self, reply: Reply) -> bool:
        """Take a reading in; False where it cannot be: the joint would have jumped."""
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
        """Take in what a block tells of voltage, temperature, limit and health."""
        family, block = self.family, reply.block
        before, self.conditions = self.conditions, words.conditions(family, reply.status)
        self.alerts += bool(set(self.conditions) - set(before))
        if self._spans(block, "voltage"):
            self.set_voltage(family.decode(block, reply.data, "voltage") / 10.0, reply.time)
        if self._spans(block, "temperature"):
            self.temperature = float(family.decode(block, reply.data, "temperature"))
        if self._spans(block, "limit"):
            self.limit_read = found = family.decode(block, reply.data, "limit")
            read, written = (f"{self.units.torque(n):.3g} N·m" for n in (found, self.limit))
            self._compare("limit", found, self.limit, reply.time, (read, written))
        if self._spans(block, "goal") and self.goal is not None:
            found = family.decode(block, reply.data, "goal")
            read, written = (f"{self.angle(n):.3g} rad" for n in (found, self.goal))
            self._compare("goal", found, self.goal, reply.time, (read, written))
        if self._spans(block, "torque_enable"):
            self.torque_on = bool(family.decode(block, reply.data, "torque_enable"))
            went_off = (self.enabled or "torque" in self.rota) and not self.torque_on
            self.fault("torque", went_off, "its torque went off by itself")
            if went_off:
                # No goals: on some servos they would switch it on, far from where it was.
                self.enabled = False
        if self._spans(block, "hardware_error"):
            self.hardware = words.hardware(family.decode(block, reply.data, "hardware_error"))
        if self._spans(block, "watchdog"):
            self.watchdog = family.decode(block, reply.data, "watchdog")
            tripped = self.watchdog == TRIPPED
            self.trips += tripped and not self.tripped
            self.tripped = tripped

    @property
    def is_refusing(self) -> bool:
        """Whether goals are known not to arrive, or not to be taken."""
        return self.enabled and (self.tripped or self._echoes["goal"].wrong >= MISMATCHES)

    @property
    def torque(self) -> float:
        """Torque on the joint by the servo's own reckoning, were all its servos like this [N·m]."""
        if self.row.kind == "current":
            return self.units.sign * self.units.torque(self.current or 0)
        return self.units.sign * self.units.load(self.load)

    def set_voltage(self, volts: float, time: float) -> None:
        """Follow the supply: a duty gives a torque in proportion to it.

        A sag of a moment is borne, one that lasts is a fault.
        """
        self.voltage = volts
        if volts >= self.starved:
            self._fed = time
        self.fault(
            "voltage",
            time - self._fed > SAG,
            f"its supply is {volts:.1f} V and it needs {self.starved:.1f} V: a supply that is too "
            "weak, or thin or long wires",
        )
        if volts != self.units.voltage and volts > 0.0:
            self.units = replace(self.units, voltage=volts)

    def _is_reachable(self, position: float, time: float) -> bool:
        """Whether the joint can have come here since its last good reading.

        The way it may have gone grows with the time, but not while readings come that it cannot
        have reached: several of them in a row are a fault, and are never believed.
        """
        if self.position is None or self._allowed == float("inf"):
            self._refused, self._allowed, self._last = 0, 0.0, time
            self.fault("jump", False, "")
            return True
        gap, self._last = time - self._last, time
        if not self._refused or gap > PAUSE:
            self._allowed += gap
        way = abs(position - self.position) * self.units.count
        if way <= 2.0 * self.units.no_load_speed * self._allowed + JUMP:
            self._refused, self._allowed = 0, 0.0
            return True
        self._refused += 1
        if self._refused >= IMPOSSIBLE:
            self.fault(
                "jump",
                True,
                f"its position jumped by {way:.2f} rad, which it cannot have moved: encoder fault, "
                "slipped horn or loose gear. Torque off, then check its zero",
            )
        return False

    def settle_dispute(self) -> None:
        """Believe the next reading wherever it is: without torque the joint may be moved."""
        self._allowed = float("inf")

    def _spans(self, block: Block, name: str) -> bool:
        register = self.family.registers.get(name)
        if register is None:
            return False
        end = block.address + block.size
        return block.address <= register.address and register.address + register.size <= end

    def fault(self, key: str, is_wrong: bool, text: str) -> None:
        """Note that something is wrong, or no longer."""
        if is_wrong:
            self.rota[key] = text
        else:
            self.rota.pop(key, None)

    @property
    def doubted(self) -> bool:
        """Whether goal or limit read other than written, and not for long enough to be sure."""
        return any(e.wrong > 0 and key not in self.rota for key, e in self._echoes.items())

    def sent(self, goal: int, limit: int) -> None:
        """A packet with this goal and limit is on its way."""
        self.goal, self.limit = goal, limit
        self._writes += 1

    def _compare(
        self, key: str, found: int, written: int, time: float, words: tuple[str, str]
    ) -> None:
        """Compare a register with what was written; silence is how a servo refuses a packet.

        Packets get lost too: a register that reads wrong is a fault once it has done so for as long
        as a silent servo is waited for, and after different packets.
        """
        echo = self._echoes[key]
        if not self.enabled or found == written:
            echo.wrong, echo.agreed = 0, time
        elif echo.write != self._writes:
            echo.wrong += 1
            echo.write = self._writes
            self.mismatches += 1
        name = "torque limit" if key == "limit" else "goal"
        self.fault(
            key,
            echo.wrong >= MISMATCHES and time - echo.agreed > UNHEARD,
            f"its {name} reads {found} ({words[0]}), written was {written} ({words[1]}): it does "
            "not hear, or refuses",
        )

    def _unwrap(self, raw: int) -> tuple[int, float]:
        """Turns and unwrapped count of a position register: nearest to the last, or in range."""
        if self.seam is None:
            return 0, float(raw)
        near = self.position if self.position is not None else (self.low + self.high) / 2
        turns = round((near - raw) / self.seam) if self.position is not None else 0
        if self.position is None and not self.low <= raw <= self.high:
            candidate = round((near - raw) / self.seam)
            turns = candidate if self.multi_turn else 0
        return turns, float(raw + turns * self.seam)
