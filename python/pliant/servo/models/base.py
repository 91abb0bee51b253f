"""What a servo table consists of: registers, a family of servos that share them, one row a model.

Data only. Numbers on the wire are little-endian; a register knows its sign and nothing else, units
stand in the row.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import nan
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping

Sign = Literal["unsigned", "twos", "bit10", "bit11", "bit15"]
Protocol = Literal["p1", "p2"]
Kind = Literal["pwm", "current"]


@dataclass(frozen=True, slots=True)
class Register:
    """One entry of a control table.

    Attributes:
        address: Address of the first byte.
        size: Bytes: 1, 2 or 4.
        sign: `unsigned`; `twos` complement; `bit10` to `bit15`: magnitude with that sign bit.
    """

    address: int
    size: int
    sign: Sign = "unsigned"

    def encode(self, value: int) -> bytes:
        """Bytes of a value, which must fit."""
        if self.sign == "twos":
            return value.to_bytes(self.size, "little", signed=True)
        if value < 0 and self.sign != "unsigned":
            value = -value | 1 << int(self.sign[3:])
        return value.to_bytes(self.size, "little")

    def decode(self, data: bytes) -> int:
        """Value of as many bytes as the register has."""
        value = int.from_bytes(data, "little", signed=self.sign == "twos")
        if self.sign in {"unsigned", "twos"}:
            return value
        bit = 1 << int(self.sign[3:])
        size = value & (bit - 1)
        return -size if value & bit else size


@dataclass(frozen=True, slots=True)
class Block:
    """Bytes that one transaction reads.

    Attributes:
        address: Of the first byte.
        size: Bytes.
    """

    address: int
    size: int


def nested_blocks(inner: Block, outer: Block) -> tuple[Block, ...]:
    """Blocks of every length from `inner` to `outer`, each around the one before."""
    end = outer.address + outer.size
    sizes = range(inner.size, outer.size + 1)
    return tuple(Block(min(inner.address, end - size), size) for size in sizes)


@dataclass(frozen=True, kw_only=True)
class Family:
    """Servos with one control table and one way of speaking.

    Attributes:
        name: As in the documentation.
        protocol: `p1` (Dynamixel 1.0, Feetech STS) or `p2` (Dynamixel 2.0).
        status: Which reading of the status byte holds, see `pliant.servo._status`.
        registers: Control table by field name.
        read: Blocks with position, speed and load, from short to long: the shortest is read, a
            longer one while an answer as long as that is missing.
        write: Packets that carry limit, speed cap and goal, each of contiguous fields; one where
            the control table has no gap between them, else the limit goes first.
        sync_read: Whether one request reads many servos.
        full_duty: Value of the duty limit at 100 %.
        full_load: Value of the load register at 100 %.
        speed_max: Largest value of the speed cap.
        ceiling: EEPROM field that bounds the limit from above.
        multi_turn: Whether goals may leave one turn, so that software keeps the position limits.
        drive_values: Further registers in RAM that limit torque or motion, and their values while
            the servo is driven: a number, or the field that holds it.
    """

    name: str
    protocol: Protocol
    status: Literal["p1", "p2", "feetech"]
    registers: Mapping[str, Register]
    read: tuple[Block, ...]
    write: tuple[tuple[str, ...], ...]
    sync_read: bool
    full_duty: int
    full_load: int
    speed_max: int
    ceiling: str
    multi_turn: bool = False
    drive_values: Mapping[str, int | str] = field(default_factory=dict)

    @property
    def restored_registers(self) -> tuple[str, ...]:
        """Registers that are written while we drive, the goal aside: to be handed back."""
        cyclic = [name for names in self.write for name in names if name != "goal"]
        watchdog = ["watchdog"] if "watchdog" in self.registers else []
        return (*cyclic, *self.drive_values, *watchdog)

    def block(self, *names: str) -> Block:
        """The block that spans some fields."""
        found = [self.registers[name] for name in names]
        first = min(r.address for r in found)
        return Block(first, max(r.address + r.size for r in found) - first)

    def blocks(self, *names: str) -> tuple[Block, ...]:
        """Blocks that hold some fields, all by default, and no address beside them.

        Protocol 2.0 may refuse to read what the control table does not define.
        """
        chosen = [self.registers[name] for name in names or self.registers]
        found: list[Block] = []
        for register in sorted(set(chosen), key=lambda r: r.address):
            last = found[-1] if found else Block(-1, 0)
            if register.address == last.address + last.size:
                found[-1] = Block(last.address, last.size + register.size)
            else:
                found.append(Block(register.address, register.size))
        return tuple(found)

    def decode(self, block: Block, data: bytes, name: str) -> int:
        """A field out of the bytes of a block."""
        register = self.registers[name]
        start = register.address - block.address
        return register.decode(data[start : start + register.size])


@dataclass(frozen=True, slots=True, kw_only=True)
class Mechanics:
    """Gears and rotor, seen at the horn.

    Attributes:
        friction: Dry friction [N·m].
        damping: Viscous friction, without back-EMF [N·m·s/rad].
        armature: Rotor inertia [kg·m²].
    """

    friction: float
    damping: float
    armature: float


def estimated_mechanics(stall: float) -> Mechanics:
    """Gears of a servo that was not identified, from its stall torque at rated voltage [N·m].

    Shares that the identified servos (MX-64, MX-106, XL330, STS3215) have, to a factor of two.
    """
    return Mechanics(friction=0.02 * stall, damping=0.005 * stall, armature=0.003 * stall)


@dataclass(frozen=True, kw_only=True)
class ServoModel:
    """One servo model.

    Attributes:
        name: As printed on the servo.
        model_number: Model number in the servo.
        family: Its registers.
        limit_type: What the torque limit limits.
        counts_per_turn: Encoder counts per turn of the horn.
        max_position: Positions run from 0 to this.
        stall: Stall torque by supply voltage, ((V, N·m), ...), rising.
        no_load: Speed without load by voltage, ((V, rpm), ...), rising.
        gain: Duty per radian of error and per unit of the gain register; for slopes (EX, RX) the
            register is the error in counts at which the duty is full, and this is 0.
        gain_default: The gain register as the maker sets it.
        speed_unit: One unit of the speed registers [rpm].
        current_unit: One unit of the current registers [A]; 0 without such registers.
        current_max: Largest Current Limit.
        stall_current: Current at the stall torque of the rated voltage [A], NaN where not used.
        rated: Voltage that the maker recommends [V].
        voltage: Lowest and highest supply voltage [V].
        overload: Share of full torque above which the servo's own overload protection counts; None
            where the maker gives none.
        mechanics: Friction and inertia of the gears.
        aliases: Other names.
    """

    name: str
    model_number: int
    family: Family
    limit_type: Kind
    counts_per_turn: float
    max_position: int
    stall: tuple[tuple[float, float], ...]
    no_load: tuple[tuple[float, float], ...]
    gain: float
    gain_default: int
    speed_unit: float
    rated: float
    voltage: tuple[float, float]
    current_unit: float = 0.0
    current_max: int = 0
    stall_current: float = nan
    overload: float | None = None
    mechanics: Mechanics
    aliases: tuple[str, ...] = ()
