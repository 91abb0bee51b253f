"""Variants of the Feetech STS3215.

Sources: the control table is Feetech's, as quoted by huggingface/lerobot; the duty per radian of
position error is from oscilloscope measurements of Rhoban/bam (7.4 V variant). Stall torque and
speed of the variants with gear ratios 1:191 and 1:147 are scaled from 1:345. All variants have the
same model number, so the user names the variant.
"""

from __future__ import annotations

from pliant.servo.models.base import Block, Family, Mechanics, Register, ServoModel, nested_blocks

STS = Family(
    name="STS3215",
    protocol="p1",
    status="feetech",
    registers={
        "firmware": Register(0, 2),
        "model": Register(3, 2),
        "id": Register(5, 1),
        "baud": Register(6, 1),
        "return_delay": Register(7, 1),
        "return_level": Register(8, 1),
        "position_min": Register(9, 2),
        "position_max": Register(11, 2),
        "temperature_limit": Register(13, 1),
        "voltage_max": Register(14, 1),
        "voltage_min": Register(15, 1),
        "max_torque": Register(16, 2),
        "phase": Register(18, 1),
        "shutdown": Register(19, 1),
        "gain": Register(21, 1),
        "integral_gain": Register(23, 1),
        "homing_offset": Register(31, 2, "bit11"),
        "mode": Register(33, 1),
        "protective_torque": Register(34, 1),
        "protection_time": Register(35, 1),
        "overload_torque": Register(36, 1),
        "torque_enable": Register(40, 1),
        "acceleration_cap": Register(41, 1),
        "goal": Register(42, 2, "bit15"),
        "goal_time": Register(44, 2),
        "speed_cap": Register(46, 2, "bit15"),
        "limit": Register(48, 2),
        "lock": Register(55, 1),
        "position": Register(56, 2, "bit15"),
        "speed": Register(58, 2, "bit15"),
        "load": Register(60, 2, "bit10"),
        "voltage": Register(62, 1),
        "temperature": Register(63, 1),
        "condition": Register(65, 1),
        "current": Register(69, 2, "bit15"),
    },
    read=nested_blocks(Block(56, 15), Block(0, 71)),
    write=(("goal", "goal_time", "speed_cap", "limit"),),
    sync_read=True,
    full_duty=1000,
    full_load=1000,
    speed_max=3400,
    ceiling="max_torque",
    drive_values={"acceleration_cap": 0},
)

#: One kilogram-force centimetre [N·m].
KG_CM = 0.0980665


#: Gear friction, damping and inertia, identified on the 7.4 V variant with gear ratio 1:345.
GEARS = Mechanics(friction=0.052, damping=0.059, armature=0.028)


def _geared(ratio: float) -> Mechanics:
    """Return `GEARS` scaled from gear ratio 345 to `ratio`.

    Friction is proportional to the gear ratio, damping and inertia to its square.
    """
    r = ratio / 345
    return Mechanics(
        friction=GEARS.friction * r,
        damping=GEARS.damping * r * r,
        armature=GEARS.armature * r * r,
    )


def _sts3215(  # noqa: PLR0917 -- a row of a table
    name: str,
    aliases: tuple[str, ...],
    stall: tuple[float, float],
    speed: float,
    voltage: tuple[float, float],
    mechanics: Mechanics,
) -> ServoModel:
    """Return the servo model of a variant of the STS3215.

    `stall` is (voltage [V], stall torque [N·m]), `speed` the no-load speed at that voltage [rpm],
    `voltage` the lowest and highest supply voltage [V].
    """
    return ServoModel(
        name=name,
        model_number=777,
        family=STS,
        limit_type="pwm",
        stall=(stall,),
        no_load=((stall[0], speed),),
        gain=0.166,
        gain_default=32,
        speed_unit=60 / 4096,
        current_unit=0.0065,
        rated=stall[0],
        voltage=voltage,
        overload=0.80,
        mechanics=mechanics,
        aliases=aliases,
    )


#: Supply range of the 7.4 V variants [V].
_SUPPLY_7V4 = (4.0, 8.4)
#: Stall torque at 7.4 V of the variant with gear ratio 1:345 [N·m].
_STALL_7V4 = 19.5 * KG_CM
MODELS = (
    _sts3215(
        "STS3215-7.4V", ("STS3215-C001", "STS3215"), (7.4, _STALL_7V4), 52.0, _SUPPLY_7V4, GEARS
    ),
    _sts3215("STS3215-12V", ("STS3215-C018",), (12.0, 30.0 * KG_CM), 45.0, (6.0, 12.6), GEARS),
    _sts3215(
        "STS3215-7.4V-191",
        ("STS3215-C044",),
        (7.4, _STALL_7V4 * 191 / 345),
        52.0 * 345 / 191,
        _SUPPLY_7V4,
        _geared(191),
    ),
    _sts3215(
        "STS3215-7.4V-147",
        ("STS3215-C046",),
        (7.4, _STALL_7V4 * 147 / 345),
        52.0 * 345 / 147,
        _SUPPLY_7V4,
        _geared(147),
    ),
)
