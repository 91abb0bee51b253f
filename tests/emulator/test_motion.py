"""Independent servos with their load: torque limits, speeds, holding, falling."""

from __future__ import annotations

import math

import pytest
from emulator.helpers import le16

from pliant import ConfigError
from pliant.emulator import MODELS, Device, Load
from pliant.emulator.models import ALIASES
from pliant.emulator.simulation import Simulation


def world(model, **registers):
    simulation = Simulation([Device(model, 1, **registers).build(None)])
    return simulation, simulation.servos[0]


def set_goal(servo, counts, share):
    """Set goal and torque limit, and switch torque on, through the registers."""
    names = servo.table
    if "torque_limit" in names:
        full = names["torque_limit"].high
        servo.put("torque_limit", share * full)
    else:
        servo.put("goal_pwm", 885)
        if "goal_current" in names:
            servo.put("goal_current", share * servo.get("current_limit"))
        else:
            servo.put("goal_pwm", share * 885)
    servo.put("goal_position", counts)
    servo.put("torque_enable", 1)


def settle(model):
    kind = MODELS[ALIASES.get(model, model)]
    current = kind.family == "x" and kind.current_unit > 0.0
    simulation, servo = world(model, **({"operating_mode": 5} if current else {}))
    servo.load.inertia = 3.0 * servo.model.motor.inertia
    return simulation, servo


@pytest.mark.parametrize("model", list(MODELS))
def test_every_model_reaches_a_goal_and_stays(model):
    simulation, servo = settle(model)
    goal = servo.position + (40 if model == "RX-64" else 200)
    set_goal(servo, goal, 0.6)
    simulation.advance(2.0)
    lag = abs(servo.position - goal)
    friction = servo.model.motor.friction / servo.drive().stiffness / servo.model.count
    assert lag <= friction + 3
    assert abs(servo.shaft.speed) < 0.01


@pytest.mark.parametrize("model", ["EX-106+", "MX-64", "XM430-W350", "XL430-W250", "STS3215"])
def test_torque_at_a_stop_is_what_the_register_says(model):
    simulation, servo = settle(model)
    servo.load.stops = (servo.shaft.angle - 0.01, servo.shaft.angle + 0.01)
    set_goal(servo, servo.position + 400, 0.3)
    simulation.advance(1.0)
    assert servo.shaft.torque == pytest.approx(servo.drive().ceiling, rel=1e-6)
    assert servo.shaft.torque < 0.6 * servo.stall


def test_a_duty_limited_servo_resists_a_push_with_more_than_its_limit():
    simulation, servo = world("STS3215")
    set_goal(servo, servo.position + 300, 0.2)
    servo.load.torque = -3.0 * servo.drive().ceiling
    simulation.advance(0.1)
    assert servo.shaft.speed < 0.0
    back = servo.drive().ceiling - servo.model.motor.slope * servo.shaft.speed
    assert servo.shaft.torque == pytest.approx(back)
    assert servo.shaft.torque > servo.drive().ceiling


def test_a_current_limited_servo_does_not():
    simulation, servo = world("XM430-W350", operating_mode=5)
    set_goal(servo, servo.position + 300, 0.2)
    servo.load.torque = -2.0 * servo.drive().ceiling
    simulation.advance(0.1)
    assert servo.shaft.torque == pytest.approx(servo.drive().ceiling)


@pytest.mark.parametrize(
    ("model", "register", "value", "speed"),
    [
        ("MX-28", "moving_speed", 50, 50 * 0.114 * math.pi / 30),
        ("XL430-W250", "profile_velocity", 20, 20 * 0.229 * math.pi / 30),
        ("STS3215", "goal_velocity", 300, 300 * math.pi / 2048),
    ],
)
def test_speed_registers_bound_the_speed(model, register, value, speed):
    simulation, servo = world(model)
    servo.put(register, value)
    set_goal(servo, servo.position + 800, 1.0)
    simulation.advance(0.5)
    before = servo.shaft.angle
    simulation.advance(0.5)
    assert (servo.shaft.angle - before) / 0.5 == pytest.approx(speed, rel=0.05)


def test_without_torque_a_pendulum_falls_and_with_it_hangs_on():
    simulation, servo = world("MX-64")
    servo.load = Load(inertia=0.02, pendulum=1.5, down=servo.shaft.angle - math.pi / 2)
    angle = servo.shaft.angle
    set_goal(servo, servo.position, 0.9)
    simulation.advance(1.0)
    assert abs(servo.shaft.angle - angle) < 0.06
    servo.put("torque_enable", 0)
    simulation.advance(1.0)
    assert servo.shaft.angle - servo.load.down < 0.5


def test_no_load_speed_is_the_makers():
    simulation, servo = world("STS3215-12V", min_position_limit=0, max_position_limit=0)
    servo.put("p_coefficient", 254)
    set_goal(servo, servo.position + 30000, 1.0)
    simulation.advance(1.0)
    motor = servo.model.motor
    # No-load speed of the data sheet, reduced by the maximum duty of 97 % and by gear friction.
    expected = (0.97 * motor.stall - motor.friction) / (motor.slope + motor.damping)
    assert servo.shaft.speed == pytest.approx(expected, rel=0.01)
    assert 0.75 * motor.speed < servo.shaft.speed < motor.speed


def test_a_stalled_servo_heats_up_until_it_unloads():
    simulation, servo = world("STS3215", overload_torque=100)
    servo.load.stops = (servo.shaft.angle, servo.shaft.angle)
    set_goal(servo, servo.position + 1000, 0.95)
    seconds = 0
    while servo.enabled and seconds < 60:
        simulation.advance(1.0)
        seconds += 1
    assert 10 < seconds < 60
    assert servo.temperature == pytest.approx(servo.get("temperature_limit"), abs=2.0)


def test_time_is_kept_to_whole_steps_however_it_is_cut():
    simulation, servo_one = world("STS3215")
    other, servo_other = world("STS3215")
    for servo in (servo_one, servo_other):
        set_goal(servo, 2500, 0.5)
    simulation.advance(0.3)
    for _ in range(700):
        other.advance(0.3 / 700)
    assert other.time == simulation.time == pytest.approx(0.3)
    assert servo_one.shaft == servo_other.shaft


def test_time_does_not_run_backwards():
    simulation, _ = world("STS3215")
    for seconds in (-0.1, math.nan, math.inf):
        with pytest.raises(ConfigError, match="advance"):
            simulation.advance(seconds)


def test_loss_of_the_plug_ends_torque():
    simulation, servo = world("XL430-W250")
    set_goal(servo, 2500, 1.0)
    servo.plugged = False
    simulation.advance(0.2)
    assert servo.position == 2048
    assert le16(servo.position) == (0, 8)
