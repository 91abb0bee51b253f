"""Control tables: registers with address, size, area, access, initial value, range and coding."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

Area = Literal["eeprom", "ram"]


@dataclass(frozen=True, slots=True)
class Register:
    """One entry of a control table.

    Attributes:
        name: Snake-case name; common registers have the same name in every family.
        address: First byte.
        size: Bytes, little-endian.
        area: `eeprom` or `ram`.
        writable: True if the host may write it.
        initial: Value of a new servo.
        low, high: Values the servo accepts.
        sign: None for unsigned, 0 for two's complement, else the sign bit of sign and magnitude.
    """

    name: str
    address: int
    size: int
    area: Area
    writable: bool
    initial: int
    low: int
    high: int
    sign: int | None

    def decode(self, data: bytes | bytearray) -> int:
        """Return the number encoded by these bytes."""
        raw = int.from_bytes(data[: self.size], "little")
        if self.sign is None:
            return raw
        if self.sign == 0:
            return raw - (1 << 8 * self.size) if raw >> (8 * self.size - 1) else raw
        bit = 1 << self.sign
        return -(raw & (bit - 1)) if raw & bit else raw & (bit - 1)

    def encode(self, value: int) -> bytes:
        """Return the bytes of a number, clipped to the register's range."""
        if self.sign is None:
            raw = max(0, min(value, (1 << 8 * self.size) - 1))
        elif self.sign == 0:
            half = 1 << (8 * self.size - 1)
            raw = max(-half, min(value, half - 1)) % (2 * half)
        else:
            bit = 1 << self.sign
            raw = min(abs(value), bit - 1) | (bit if value < 0 else 0)
        return raw.to_bytes(self.size, "little")


class Table:
    """The control table of one servo model.

    Attributes:
        size: Bytes from address 0 to the end of the last register.
    """

    def __init__(self, registers: Iterable[Register]) -> None:
        """Index the registers; a later one replaces an earlier one of the same name."""
        self._by_name = {register.name: register for register in registers}
        self._at = {
            register.address + k: register
            for register in self._by_name.values()
            for k in range(register.size)
        }
        self.size = max(self._at) + 1

    def __iter__(self) -> Iterator[Register]:
        return iter(self._by_name.values())

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __getitem__(self, name: str) -> Register:
        """Return a register by name.

        Raises:
            ConfigError: The name is unknown; the message lists the known ones.
        """
        try:
            return self._by_name[name]
        except KeyError:
            known = ", ".join(self._by_name)
            raise ConfigError(f"no register {name!r} in this table; there are {known}") from None

    def at(self, address: int) -> Register | None:
        """Return the register that holds this byte."""
        return self._at.get(address)

    def span(self, address: int, length: int) -> list[Register]:
        """Return the registers that these bytes touch, by address."""
        found: list[Register] = []
        for byte in range(address, address + length):
            register = self._at.get(byte)
            if register is not None and (not found or found[-1] is not register):
                found.append(register)
        return found

    def changed(self, text: str = "", **initial: int) -> Table:
        """Return a table with rows added or replaced, and other initial values."""
        rows = {**self._by_name, **{register.name: register for register in parse(text)}}
        for name, value in initial.items():
            rows[name] = replace(rows[name], initial=value)
        return Table(rows.values())

    def without(self, *names: str) -> Table:
        """Return a table that lacks these registers."""
        return Table(register for register in self if register.name not in names)


def parse(text: str) -> list[Register]:
    """Read rows of `address size area access initial range coding name`.

    Area is E or R, access r or rw, range `low..high` or `-` for all that the coding can hold,
    coding `u` (unsigned), `t` (two's complement) or `sN` (sign and magnitude, sign in bit N).
    """
    return [_row(line.split()) for line in text.strip().splitlines() if line.strip()]


def _row(cells: list[str]) -> Register:
    address, size, area, access, initial, span, coding, name = cells
    bits = 8 * int(size)
    sign = {"u": None, "t": 0}[coding] if coding in {"u", "t"} else int(coding[1:])
    if span == "-":
        high = (1 << (bits if sign is None else bits - 1 if sign == 0 else sign)) - 1
        low = 0 if sign is None else -high - (1 if sign == 0 else 0)
    else:
        low, high = (int(end) for end in span.split(".."))
    return Register(
        name,
        int(address),
        int(size),
        "eeprom" if area == "E" else "ram",
        access == "rw",
        int(initial),
        low,
        high,
        sign,
    )
