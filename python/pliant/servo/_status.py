"""Decoding of servos' status and error bytes into sentences; detection of rejected requests."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pliant.servo.models import Family

_VOLTAGE = "supply voltage outside its limits: check the supply and its wiring"
_HOT = "too hot: let it cool down and lower the load"
_OVERLOAD = "overload: it has been pushing at its limit for too long"

_P1 = {
    0: _VOLTAGE,
    1: "goal outside its angle limits",
    2: _HOT,
    3: "a value out of range",
    4: "a request with a wrong checksum: noise on the line",
    5: f"{_OVERLOAD}; its torque limit is now 0. Take the load off and enable again, and clear "
    "bit 5 of Shutdown with `pliant servos setup`: a compliant arm often pushes at its limit",
    6: "an instruction it does not know",
}
_FEETECH = {
    0: _VOLTAGE,
    1: "encoder fault: have it repaired",
    2: _HOT,
    3: "current too high: something jams, or the protection current is set too low",
    5: f"{_OVERLOAD}; it now gives its protective torque only, until the next goal",
}
#: Causes for which Feetech and Protocol 1.0 servos reduce or switch off their torque.
_PROTECTIONS = {2: "overheating", 3: "current too high", 5: "overload"}
_HARDWARE = {
    0: f"{_VOLTAGE}; reboot it to go on",
    2: f"{_HOT}; then reboot it",
    3: "encoder fault: have it repaired",
    4: "electrical shock or a motor without enough power; check the supply, then reboot it",
    5: f"{_OVERLOAD}; its torque is off until a reboot. Clear bit 5 of Shutdown with `pliant "
    "servos setup`: a compliant arm often pushes at its limit",
}
_P2 = {
    1: "it could not execute the request",
    2: "an instruction that it does not know or accept now",
    3: "a request with a wrong CRC: noise on the line",
    4: "a value out of range",
    5: "too few bytes for the register",
    6: "a value above the servo's own limit",
    7: "a register that is read-only, or locked while torque is on",
}
#: Bits of the Protocol 1.0 status byte that report a rejected request.
_P1_REFUSALS = 1 << 1 | 1 << 3 | 1 << 4 | 1 << 6
ALERT = 0x80


def _bits(value: int, texts: dict[int, str]) -> tuple[str, ...]:
    return tuple(text for bit, text in texts.items() if value & 1 << bit)


def conditions(family: Family, status: int) -> tuple[str, ...]:
    """Return a sentence for each condition (overheating, ...) in the status byte of a reply."""
    if family.status == "feetech":
        return _bits(status, _FEETECH)
    if family.status == "p1":
        return _bits(status & ~_P1_REFUSALS, _P1)
    if status & ALERT:
        return ("a hardware fault is latched (register 70 says which)",)
    return ()


def protections(family: Family, status: int) -> tuple[str, ...]:
    """Return the cause of each protection that has tripped according to a status byte.

    A status of Protocol 2.0 does not name a cause: its register Hardware Error Status does.
    """
    return () if family.status == "p2" else _bits(status, _PROTECTIONS)


def hardware(value: int) -> tuple[str, ...]:
    """Return a sentence for each error in the register Hardware Error Status of Protocol 2.0."""
    return _bits(value, _HARDWARE)


def refusal(family: Family, status: int) -> str | None:
    """Return the reason for the rejection of a request; None if the servo executed it.

    `status` is the status byte of the reply. Some bits report conditions and not a rejection: all
    bits of Feetech, and the bits for voltage, temperature and overload in Protocol 1.0.
    """
    if family.status == "feetech":
        return None
    if family.status == "p1":
        return "; ".join(_bits(status & _P1_REFUSALS, _P1)) or None
    number = status & ~ALERT
    return _P2.get(number, f"error {number}") if number else None
