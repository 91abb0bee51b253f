"""Dynamixel servos with Protocol 1.0: EX-106+, RX-64, MX-28, MX-64, MX-106.

Sources: control tables and data are from the ROBOTIS e-Manual. The motor duty per radian of
position error of MX servos is from oscilloscope measurements of Rhoban/bam.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant.servo.models.base import (
    Block,
    Family,
    Mechanics,
    Register,
    ServoModel,
    estimated_mechanics,
    nested_blocks,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

_COMMON = {
    "model": Register(0, 2),
    "firmware": Register(2, 1),
    "id": Register(3, 1),
    "baud": Register(4, 1),
    "return_delay": Register(5, 1),
    "position_min": Register(6, 2),
    "position_max": Register(8, 2),
    "temperature_limit": Register(11, 1),
    "voltage_min": Register(12, 1),
    "voltage_max": Register(13, 1),
    "max_torque": Register(14, 2),
    "return_level": Register(16, 1),
    "shutdown": Register(18, 1),
    "torque_enable": Register(24, 1),
    "goal": Register(30, 2),
    "speed_cap": Register(32, 2),
    "limit": Register(34, 2),
    "position": Register(36, 2),
    "speed": Register(38, 2, "bit10"),
    "load": Register(40, 2, "bit10"),
    "voltage": Register(42, 1),
    "temperature": Register(43, 1),
}


def _family(name: str, *, drive_values: Mapping[str, int | str], **further: Register) -> Family:
    return Family(
        name=name,
        protocol="p1",
        status="p1",
        registers={**_COMMON, **further},
        # Read the register Torque Limit with every reading: a servo sets it to 0 after an overload.
        read=nested_blocks(Block(34, 10), Block(0, 50)),
        write=(("goal", "speed_cap", "limit"),),
        sync_read=False,
        full_duty=1023,
        full_load=1023,
        speed_max=1023,
        ceiling="max_torque",
        drive_values=drive_values,
    )


# Address 28 is the clockwise compliance slope of EX and RX servos, and the P gain of MX servos;
# addresses 10 and 73 are Drive Mode and Goal Acceleration.
_GAIN, _DUAL = Register(28, 1), Register(10, 1)
#: Further registers of the position loop of EX and RX servos: dead zones on both sides, slope on
#: the counterclockwise side, and minimum torque outside of the dead zones (punch).
_COMPLIANCE = {
    "margin_cw": Register(26, 1),
    "margin_ccw": Register(27, 1),
    "slope_ccw": Register(29, 1),
    "punch": Register(48, 2),
}


def _compliance(punch: int) -> dict[str, int | str]:
    """Return the values for the registers `_COMPLIANCE` while an EX or RX servo is driven.

    The dead zones (margins) have their factory values, `punch` is the minimum torque, and the
    counterclockwise slope equals the clockwise one.
    """
    return {"margin_cw": 1, "margin_ccw": 1, "slope_ccw": "gain", "punch": punch}


RX = _family("RX-64", drive_values=_compliance(32), gain=_GAIN, **_COMPLIANCE)
EX = _family("EX-106+", drive_values=_compliance(0), gain=_GAIN, drive_mode=_DUAL, **_COMPLIANCE)
#: Further registers of MX servos, which are 0 while they are driven: no acceleration limit, and no
#: integral part, which would push against a hand with more and more torque.
_MX = {"acceleration_cap": Register(73, 1), "integral_gain": Register(27, 1)}
_ZEROS = dict.fromkeys(_MX, 0)
MX = _family("MX-28, MX-64", drive_values=_ZEROS, gain=_GAIN, **_MX)
MX_DUAL = _family("MX-106", drive_values=_ZEROS, gain=_GAIN, drive_mode=_DUAL, **_MX)


def _mx(  # noqa: PLR0917 - a row of a table
    name: str,
    number: int,
    family: Family,
    stall: tuple[float, float, float],
    no_load: tuple[float, float, float],
    mechanics: Mechanics,
) -> ServoModel:
    """Return an MX servo model.

    Stall torques [N·m] and no-load speeds [rpm] are those at 11.1, 12.0 and 14.8 V.
    """
    volts = (11.1, 12.0, 14.8)
    return ServoModel(
        name=name,
        model_number=number,
        family=family,
        limit_type="pwm",
        stall=tuple(zip(volts, stall, strict=True)),
        no_load=tuple(zip(volts, no_load, strict=True)),
        gain=0.158,
        gain_default=32,
        speed_unit=0.114,
        rated=12.0,
        voltage=(10.0, 14.8),
        mechanics=mechanics,
    )


MODELS = (
    ServoModel(
        name="EX-106+",
        model_number=107,
        family=EX,
        limit_type="pwm",
        counts_per_turn=4096 * 360 / 250.92,
        max_position=4095,
        stall=((18.5, 10.9),),
        no_load=((18.5, 91.0),),
        gain=0.0,
        gain_default=32,
        speed_unit=0.111,
        rated=14.8,
        voltage=(12.0, 18.5),
        mechanics=estimated_mechanics(8.7),
    ),
    ServoModel(
        name="RX-64",
        model_number=64,
        family=RX,
        limit_type="pwm",
        counts_per_turn=1023 * 360 / 300,
        max_position=1023,
        stall=((18.5, 5.3),),
        no_load=((18.5, 64.0),),
        gain=0.0,
        gain_default=32,
        speed_unit=0.111,
        rated=14.8,
        voltage=(12.0, 18.5),
        mechanics=estimated_mechanics(4.2),
    ),
    _mx("MX-28", 29, MX, (2.3, 2.5, 3.1), (50.0, 55.0, 67.0), estimated_mechanics(2.5)),
    _mx(
        "MX-64", 310, MX, (5.5, 6.0, 7.3), (58.0, 63.0, 78.0),
        Mechanics(friction=0.090, damping=0.012, armature=0.012),
    ),
    _mx(
        "MX-106", 320, MX_DUAL, (8.0, 8.4, 10.0), (41.0, 45.0, 55.0),
        Mechanics(friction=0.104, damping=0.035, armature=0.027),
    ),
)  # fmt: skip
