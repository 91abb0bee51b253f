"""Dynamixel servos with Protocol 2.0: the X series and the MX with 2.0 firmware.

Sources: control tables and data are from the ROBOTIS e-Manual. The manual gives a motor output of
P/128 PWM counts per encoder count of position error, for the value P of the register Position P
Gain; 885 PWM counts are 100 % duty. For the XL330, Rhoban/bam measured a duty of 0.00246 per radian
of error and unit of P, which differs for unknown reasons. `Units.stiffness` describes
current-limited servos.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi

from pliant.servo.models.base import (
    Block,
    Family,
    Mechanics,
    Register,
    ServoModel,
    estimated_mechanics,
    nested_blocks,
)

_COMMON = {
    "model": Register(0, 2),
    "firmware": Register(6, 1),
    "id": Register(7, 1),
    "baud": Register(8, 1),
    "return_delay": Register(9, 1),
    "drive_mode": Register(10, 1),
    "mode": Register(11, 1),
    "shadow_id": Register(12, 1),
    "homing_offset": Register(20, 4, "twos"),
    "temperature_limit": Register(31, 1),
    "voltage_max": Register(32, 2),
    "voltage_min": Register(34, 2),
    "pwm_limit": Register(36, 2),
    "position_max": Register(48, 4, "twos"),
    "position_min": Register(52, 4, "twos"),
    "shutdown": Register(63, 1),
    "torque_enable": Register(64, 1),
    "return_level": Register(68, 1),
    "hardware_error": Register(70, 1),
    "integral_gain": Register(82, 2),
    "gain": Register(84, 2),
    "watchdog": Register(98, 1),
    "goal_velocity": Register(104, 4, "twos"),
    "acceleration_cap": Register(108, 4),
    "speed_cap": Register(112, 4),
    "goal": Register(116, 4, "twos"),
    "pwm": Register(124, 2, "twos"),
    "speed": Register(128, 4, "twos"),
    "position": Register(132, 4, "twos"),
    "voltage": Register(144, 2),
    "temperature": Register(146, 1),
}

#: Register Startup Configuration. Older firmware lacks it, and may reject reads that contain it.
STARTUP = Block(60, 1)
#: Blocks with position, speed and load; the control tables have no gap in these addresses.
READ = nested_blocks(Block(126, 10), Block(104, 43))

CURRENT = Family(
    name="X, current-limited",
    protocol="p2",
    status="p2",
    registers={
        **_COMMON,
        "current_limit": Register(38, 2),
        "pwm_goal": Register(100, 2, "twos"),
        "limit": Register(102, 2, "twos"),
        "current": Register(126, 2, "twos"),
    },
    read=READ,
    write=(("limit", "goal_velocity", "acceleration_cap", "speed_cap", "goal"),),
    sync_read=True,
    full_duty=885,
    full_load=1000,
    speed_max=32767,
    ceiling="current_limit",
    multi_turn=True,
    drive_values={"pwm_goal": "pwm_limit", "integral_gain": 0},
)
DUTY = Family(
    name="X, duty-limited",
    protocol="p2",
    status="p2",
    registers={
        **_COMMON,
        "limit": Register(100, 2, "twos"),
        "load": Register(126, 2, "twos"),
    },
    read=READ,
    # Write two packets: a servo of this family has no address 102 and rejects packets with it.
    write=(("limit",), ("speed_cap", "goal")),
    sync_read=True,
    full_duty=885,
    full_load=1000,
    speed_max=32767,
    ceiling="pwm_limit",
    drive_values={"acceleration_cap": 0, "integral_gain": 0},
)

#: Motor duty [1] per radian of position error and per unit of the register Position P Gain, from
#: the e-Manual.
DUTY_PER_RADIAN = 4096 / (2 * pi) / 128 / 885


# Positional arguments, because the calls in `MODELS` are the rows of a table.
def _duty_limited(  # noqa: PLR0917 - a row of a table
    name: str,
    model_number: int,
    rated: float,
    stall: tuple[tuple[float, float], ...],
    no_load: tuple[tuple[float, float], ...],
    gain_default: int,
    voltage: tuple[float, float],
) -> ServoModel:
    """Return a servo model whose torque limit is a PWM duty.

    The arguments are those of `ServoModel`.
    """
    return ServoModel(
        name=name,
        model_number=model_number,
        family=DUTY,
        limit_type="pwm",
        stall=stall,
        no_load=no_load,
        gain=DUTY_PER_RADIAN,
        gain_default=gain_default,
        speed_unit=0.229,
        rated=rated,
        voltage=voltage,
        mechanics=estimated_mechanics(dict(stall)[rated]),
    )


def _current_limited(  # noqa: PLR0917 - a row of a table
    name: str,
    model_number: int,
    current_unit: float,
    current_max: int,
    rated: tuple[float, float],
    stall: tuple[tuple[float, float], ...],
    no_load: tuple[tuple[float, float], ...],
    gain_default: int,
    voltage: tuple[float, float],
    mechanics: Mechanics | None = None,
) -> ServoModel:
    """Return a servo model whose torque limit is a current.

    `rated` is (voltage [V], stall current [A]). The other arguments are those of `ServoModel`;
    `mechanics` None: estimated from the stall torque at the rated voltage.
    """
    model = _duty_limited(name, model_number, rated[0], stall, no_load, gain_default, voltage)
    return replace(
        model,
        family=CURRENT,
        limit_type="current",
        current_unit=current_unit,
        current_max=current_max,
        stall_current=rated[1],
        mechanics=mechanics or model.mechanics,
    )


def _pairs(*pairs: float) -> tuple[tuple[float, float], ...]:
    """Return pairs (voltage, value) from the flat list voltage, value, voltage, value, ..."""
    return tuple(zip(pairs[::2], pairs[1::2], strict=True))


_12V = (10.0, 14.8)
MODELS = (
    _current_limited(
        "XL330-M077", 1190, 0.001, 1750, (5.0, 1.47),
        _pairs(3.7, 0.18, 5.0, 0.215, 6.0, 0.228), _pairs(3.7, 278, 5.0, 383, 6.0, 456),
        400, (3.7, 6.0),
    ),
    _current_limited(
        "XL330-M288", 1200, 0.001, 1750, (5.0, 1.47),
        _pairs(3.7, 0.42, 5.0, 0.52, 6.0, 0.60), _pairs(3.7, 76, 5.0, 103, 6.0, 123),
        400, (3.7, 6.0), Mechanics(friction=0.013, damping=0.0037, armature=0.0018),
    ),
    _current_limited(
        "XC330-T181", 1210, 0.001, 910, (11.1, 0.80),
        _pairs(9.0, 0.65, 11.1, 0.76, 12.0, 0.80), _pairs(9.0, 83, 11.1, 104, 12.0, 113),
        900, (6.5, 12.0),
    ),
    _current_limited(
        "XC330-T288", 1220, 0.001, 910, (11.1, 0.80),
        _pairs(9.0, 0.76, 11.1, 0.92, 12.0, 1.00), _pairs(9.0, 52, 11.1, 65, 12.0, 71),
        900, (6.5, 12.0),
    ),
    _current_limited(
        "XM430-W210", 1030, 0.00269, 1193, (12.0, 2.3),
        _pairs(11.1, 2.7, 12.0, 3.0, 14.8, 3.7), _pairs(11.1, 70, 12.0, 77, 14.8, 95), 800, _12V,
    ),
    _current_limited(
        "XM430-W350", 1020, 0.00269, 1193, (12.0, 2.3),
        _pairs(11.1, 3.8, 12.0, 4.1, 14.8, 4.8), _pairs(11.1, 43, 12.0, 46, 14.8, 57), 800, _12V,
    ),
    _current_limited(
        "XM540-W150", 1130, 0.00269, 2047, (12.0, 4.4),
        _pairs(11.1, 6.9, 12.0, 7.3, 14.8, 8.9), _pairs(11.1, 50, 12.0, 53, 14.8, 66), 800, _12V,
    ),
    _current_limited(
        "XM540-W270", 1120, 0.00269, 2047, (12.0, 4.4),
        _pairs(11.1, 10.0, 12.0, 10.6, 14.8, 12.9), _pairs(11.1, 28, 12.0, 30, 14.8, 37), 800, _12V,
    ),
    _current_limited(
        "XH430-W210", 1010, 0.00269, 648, (12.0, 1.3),
        _pairs(11.1, 2.2, 12.0, 2.5, 14.8, 3.1), _pairs(11.1, 46, 12.0, 50, 14.8, 62), 900, _12V,
    ),
    _current_limited(
        "XH430-W350", 1000, 0.00269, 648, (12.0, 1.3),
        _pairs(11.1, 3.1, 12.0, 3.4, 14.8, 4.2), _pairs(11.1, 27, 12.0, 30, 14.8, 37), 900, _12V,
    ),
    _current_limited(
        "XH540-W150", 1110, 0.00269, 2047, (12.0, 4.9),
        _pairs(11.1, 6.6, 12.0, 7.1, 14.8, 8.5), _pairs(11.1, 66, 12.0, 70, 14.8, 86), 800, _12V,
    ),
    _current_limited(
        "XH540-W270", 1100, 0.00269, 2047, (12.0, 4.9),
        _pairs(11.1, 9.2, 12.0, 9.9, 14.8, 11.7), _pairs(11.1, 36, 12.0, 39, 14.8, 46), 800, _12V,
    ),
    _current_limited(
        "MX-64(2.0)", 311, 0.00336, 1941, (12.0, 4.1),
        _pairs(11.1, 5.5, 12.0, 6.0, 14.8, 7.3), _pairs(11.1, 58, 12.0, 63, 14.8, 78), 850, _12V,
        mechanics=Mechanics(friction=0.090, damping=0.012, armature=0.012),
    ),
    _current_limited(
        "MX-106(2.0)", 321, 0.00336, 2047, (12.0, 5.2),
        _pairs(11.1, 8.0, 12.0, 8.4, 14.8, 10.0), _pairs(11.1, 41, 12.0, 45, 14.8, 55), 850, _12V,
        mechanics=Mechanics(friction=0.104, damping=0.035, armature=0.027),
    ),
    _duty_limited(
        "MX-28(2.0)", 30, 12.0,
        _pairs(11.1, 2.3, 12.0, 2.5, 14.8, 3.1), _pairs(11.1, 50, 12.0, 55, 14.8, 67), 850, _12V,
    ),
    _duty_limited(
        "XL430-W250", 1060, 11.1,
        _pairs(9.0, 1.0, 11.1, 1.4, 12.0, 1.5), _pairs(9.0, 47, 11.1, 57, 12.0, 61), 640,
        (6.5, 12.0),
    ),
    _duty_limited(
        "XC430-W150", 1070, 12.0,
        _pairs(9.0, 1.2, 11.1, 1.4, 12.0, 1.6), _pairs(9.0, 80, 11.1, 99, 12.0, 106), 460,
        (6.5, 14.8),
    ),
    _duty_limited(
        "XC430-W240", 1080, 12.0,
        _pairs(9.0, 1.4, 11.1, 1.7, 12.0, 1.9), _pairs(9.0, 52, 11.1, 65, 12.0, 70), 700,
        (6.5, 14.8),
    ),
)  # fmt: skip
