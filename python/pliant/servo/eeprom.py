"""Setup of a servo's EEPROM: find the registers to change, write them, and restore them.

Only this module writes EEPROM. It requires that torque is off, and reads every register back. Every
change contains the former value, with which it can be undone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pliant._core import ServoError
from pliant.servo.models import by_number
from pliant.servo.transport import BusError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from pliant.servo._transactions import TransactionGuard
    from pliant.servo.models import Family, ServoModel

#: Names of the registers that a setup may write.
SETUP_REGISTERS = (
    "return_level", "return_delay", "shutdown", "mode", "drive_mode", "shadow_id",
    "position_min", "position_max", "integral_gain",
)  # fmt: skip
#: Number of the bit of the register Shutdown that enables overload protection.
OVERLOAD_BIT = 5
#: Values of the register Operating Mode (Protocol 2.0) for current-based position control and for
#: position control.
CURRENT_POSITION, POSITION = 5, 3
#: Value of the register Secondary ID that disables the secondary id.
NO_SECONDARY = 255
#: Mask of the bits of the register Drive Mode (Protocol 2.0) that a setup clears: slave of another
#: servo (bit 1), time-based profile (bit 2), and torque on by a goal (bit 3).
DRIVE_MODE_BITS_TO_CLEAR = 0b1110
#: Mask of the bit of the register Drive Mode (Protocol 1.0) for a slave of another servo.
SLAVE_BIT = 0b10
#: Cause and remedy of a corrupt reply of one servo, for error messages.
SAME_ID = (
    "Two servos on one id look like this: connect them one by one and give each its own id "
    "(`pliant servos setup ARM --set-id OLD:NEW`); or the cable is bad"
)


@dataclass(frozen=True)
class RegisterChange:
    """Change of one register.

    Attributes:
        joint: Joint name.
        id: Servo id.
        register: Register name.
        old, new: Present value of the register, and value to write.
        why: Reason for the change, one sentence.
        model: Servo model; empty if unknown.
    """

    joint: str
    id: int
    register: str
    old: int
    new: int
    why: str
    model: str = ""


def plan_setup(
    io: TransactionGuard, joint: str, id: int, row: ServoModel, *, overload: bool = True
) -> list[RegisterChange]:
    """Return the changes that a setup needs on one servo.

    Args:
        io: Access to the port of the servo.
        joint: Joint name, for messages.
        id: Servo id.
        row: Servo model in the configuration.
        overload: True: clear the bit of the register Shutdown that enables overload protection.

    Raises:
        ServoError: The servo does not answer, or is another model.
    """
    _check_model(io, joint, id, row)
    required = _required_values(io, id, row, overload)
    return _differences(io, joint, id, row, required)


def plan_restore(
    io: TransactionGuard, joint: str, id: int, row: ServoModel, former: Iterable[RegisterChange]
) -> list[RegisterChange]:
    """Return the register changes that undo the earlier changes `former` on servo `id`.

    Changes of other servos in `former` are ignored. `row` is the servo model in the configuration.

    Raises:
        ServoError: The servo does not answer, or is another model.
    """
    changes = [change for change in former if (change.joint, change.id) == (joint, id)]
    if not changes:
        return []
    _check_model(io, joint, id, row)
    required = {change.register: (change.old, "is as it was before") for change in changes}
    return _differences(io, joint, id, row, required)


def _check_model(io: TransactionGuard, joint: str, id: int, row: ServoModel) -> None:
    """Check that servo `id` is of the model `row`.

    Raises:
        ServoError: The servo does not answer, or is another model.
    """
    number = read(io, id, row.family, "model")
    if number != row.model_number:
        known = " or ".join(r.name for r in by_number(number)) or f"model number {number}"
        raise ServoError(f"{joint} (id {id}) is {known}, the configuration says {row.name}")


def _differences(
    io: TransactionGuard,
    joint: str,
    id: int,
    row: ServoModel,
    required: Mapping[str, tuple[int, str]],
) -> list[RegisterChange]:
    """Return a `RegisterChange` for each register whose value is not the required one.

    `required` contains the required value and its reason, by register name.
    """
    out = []
    for register, (new, why) in required.items():
        old = read(io, id, row.family, register)
        if old != new:
            out.append(RegisterChange(joint, id, register, old, new, why, row.name))
    if out:
        _check_torque(io, joint, id, row.family)
    return out


def _check_torque(io: TransactionGuard, joint: str, id: int, family: Family) -> None:
    """Check that the torque of a servo is off.

    Raises:
        ServoError: Torque is on, or the servo does not answer.
    """
    if read(io, id, family, "torque_enable"):
        raise ServoError(
            f"the torque of {joint} (id {id}) is on: EEPROM is locked, and the arm may be holding "
            "itself up. Lower it first (`pliant run … ` and Ctrl-C), then try again"
        )


def _required_values(
    io: TransactionGuard, id: int, row: ServoModel, overload: bool
) -> dict[str, tuple[int, str]]:
    """Return the value that each register must have, and the reason for it, by register name.

    If `overload` is True, the value of the register Shutdown disables overload protection.
    """
    family = row.family
    out: dict[str, tuple[int, str]] = {}
    # Set the return level first, so that the servo acknowledges the following writes.
    out["return_level"] = (1 if family.status == "feetech" else 2, "acknowledges writes")
    if family.status != "feetech":
        out["return_delay"] = (0, "answers at once: the loop is up to four times as fast")
        if overload:
            shutdown = read(io, id, family, "shutdown") & ~(1 << OVERLOAD_BIT)
            why = "a compliant arm often pushes at its limit; with this bit the servo then drops it"
            out["shutdown"] = (shutdown, why)
    if family.status == "p2":
        mode = CURRENT_POSITION if row.limit_type == "current" else POSITION
        out["mode"] = (mode, "position control whose torque the limit bounds")
        drive = read(io, id, family, "drive_mode") & ~DRIVE_MODE_BITS_TO_CLEAR
        out["drive_mode"] = (drive, "executes its own goals at once, with separate torque on")
        out["shadow_id"] = (NO_SECONDARY, "obeys its own id only")
    elif family.status == "feetech":
        out["mode"] = (0, "position control")
        out["integral_gain"] = (0, "does not push harder and harder against a hand")
    else:
        if read(io, id, family, "position_min") == read(io, id, family, "position_max"):
            why = "position control, not wheel or multi-turn mode"
            out["position_min"], out["position_max"] = (0, why), (row.max_position, why)
        if "drive_mode" in family.registers:
            drive = read(io, id, family, "drive_mode") & ~SLAVE_BIT
            out["drive_mode"] = (drive, "follows its own goals, not those of another servo")
    return out


def write_changes(io: TransactionGuard, family: Family, required: Sequence[RegisterChange]) -> None:
    """Write the changes `required` of one servo, and read each register back.

    Raises:
        ServoError: Torque is on, the servo does not answer, or registers did not read back as
            written; the other changes stay written.
    """
    if not required:
        return
    first, failed = required[0], []
    _check_torque(io, first.joint, first.id, family)
    try:
        # Inside `try`: the servo may unlock its EEPROM although its reply is lost or interrupted.
        _lock(io, first.id, family, locked=False)
        for change in required:
            _write(io, change.id, family, change.register, change.new)
            if (value := read(io, change.id, family, change.register)) != change.new:
                failed.append(
                    f"{change.joint} (id {change.id}): {change.register} reads {value} after "
                    f"{change.new} was written"
                )
        if "lock" in family.registers and read(io, first.id, family, "lock"):
            failed.append(f"{first.joint} (id {first.id}) restarted: switch the supply off and on")
    finally:
        _lock(io, first.id, family, locked=True)
    if failed:
        raise ServoError("\n".join(failed))


def set_id(io: TransactionGuard, joint: str, row: ServoModel, old: int, new: int) -> None:
    """Change the id of the servo of `joint` from `old` to `new`.

    No other servo on the port may have the id `old`. `row` is the configured servo model.

    Raises:
        ServoError: The servo does not answer, is another model, or has torque on; the new id is
            taken; or the servo did not accept it.
    """
    check_set_id(io, joint, row, old, new)
    family, is_known = row.family, False
    try:
        _lock(io, old, family, locked=False)
        _write(io, old, family, "id", new)
        try:
            _check_model(io, joint, new, row)
        except ServoError as error:
            raise ServoError(f"id {old} may not have become id {new}: {error}") from error
        is_known = True
    finally:
        # After an error or an interruption, the servo has one of the two ids.
        for number in (new,) if is_known else (new, old):
            _lock(io, number, family, locked=True)


def check_set_id(io: TransactionGuard, joint: str, row: ServoModel, old: int, new: int) -> None:
    """Check the preconditions of `set_id`, without writing registers.

    Raises:
        ServoError: A precondition is not met, see `set_id`.
    """
    if io.ping(new):
        raise ServoError(
            f"a servo on this port answers to id {new} already: connect only the one that is to "
            "get it, unless it has it now"
        )
    _check_model(io, joint, old, row)
    _check_torque(io, joint, old, row.family)


def read(io: TransactionGuard, id: int, family: Family, name: str) -> int:
    """Return the value of the register `name` of servo `id`.

    Raises:
        ServoError: The servo does not answer.
    """
    register = family.registers[name]
    try:
        reply = io.read(id, family.block(name))
    except BusError as error:
        causes = {
            "timeout": ": is it powered? `pliant servos scan` lists ids and baud rates that answer",
            "corrupt": f". {SAME_ID}",
        }
        if error.reason not in causes:
            raise
        raise ServoError(f"{error}{causes[error.reason]}") from error
    return register.decode(reply.data)


def _write(io: TransactionGuard, id: int, family: Family, name: str, value: int) -> None:
    """Write `value` to the register `name` of servo `id`.

    Ignore a missing reply, because the caller reads the register back.
    """
    register = family.registers[name]
    try:
        io.write(id, register.address, register.encode(value))
    except BusError as error:
        error.raise_if_gone()


def _lock(io: TransactionGuard, id: int, family: Family, *, locked: bool) -> None:
    """Lock or unlock the EEPROM of a Feetech servo by its register Lock.

    Do nothing for Dynamixel servos, whose EEPROM is locked while torque is on.
    """
    if "lock" in family.registers:
        _write(io, id, family, "lock", int(locked))
