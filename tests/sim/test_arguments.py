"""Invalid arguments of plant, hand guiding and identification: errors with name and remedy."""

import numpy as np
import pytest

import pliant
import pliant.robots
from pliant import identify
from pliant.sim import Friction, Plant

ARM = pliant.robots.arm7()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"kp_scale": "x"}, r"kp_scale must be a number or 7 numbers.*'x'"),
        ({"payload": 0.3}, r"payload is a mass .* got 0\.3"),
        ({"rate": "fast"}, r"rate must be a number, got 'fast' \(str\)"),
        ({"delay": ("a", 1)}, r"delay must be two whole numbers"),
        ({"bus_outage": 3}, r"bus_outage must be a pair of times"),
        ({"bus_outage": (2.0, 1.0)}, r"bus_outage must begin before it ends"),
        ({"seed": "x"}, r"seed must be a whole number"),
        ({"encoder_flicker": "a", "encoder_step": 1e-3}, r"encoder_flicker must be a whole number"),
        ({"read_loss": "a"}, r"read_loss must be in \[0, 1\], got 'a'"),
        ({"overload": 3}, r"overload must be an Overload"),
        ({"scene": [3]}, r"scene\[0\] is neither a hand"),
        ({"off_chain": "free"}, r"off_chain is 'held' or 'welded', got 'free'"),
        ({"servos": "sts3215"}, r"servos must be a Servos.*Servos\.of"),
        ({"friction_creep": 2.0}, r"friction_creep must be in \[0\.001, 1\], got 2"),
    ],
)
def test_a_plant_names_invalid_arguments(options, text):
    with pytest.raises((pliant.PliantError, TypeError), match=text):
        Plant(ARM, **options)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Plant("arm7"), r"model must be a Model, as pliant\.robots\.arm7\(\)"),
        (lambda: Friction(base="x"), r"Friction\.base must be numbers, got 'x'"),
        (lambda: pliant.HandGuiding(None), r"model must be a Model.*got None"),
        (lambda: pliant.HandGuiding(ARM, "sts"), r"servos must be a Servos"),
        (lambda: pliant.HandGuiding(ARM, rate="x"), r"rate must be a number, got 'x'"),
        (lambda: pliant.HandGuiding(ARM, payload=(0.3,)), r"payload must be a Payload, or mass"),
        (
            lambda: identify.capture_gravity.procedure(ARM),
            r"controller must be a Controller, got <Model",
        ),
        (lambda: identify.capture_gravity(None, pliant.Controller(ARM)), r"arm must have read\(\)"),
        (lambda: identify.identify_servos.procedure("arm7"), r"model must be a Model"),
        (lambda: identify.identify_servos.procedure(ARM, span=np.nan), r"span \[rad\] must be in"),
        (
            lambda: identify.identify_servos.procedure(ARM, span=3.0),
            r"span \[rad\] must be in \[0\.05, 0\.5\], got 3",
        ),
        (lambda: identify.identify_servos.procedure(ARM, span=0.0), r"must be in \[0\.05, 0\.5\]"),
        (
            lambda: identify.estimate_payload.procedure(pliant.Controller(ARM), span=0.6),
            r"span \[rad\] must be in \[0\.05, 0\.5\], got 0\.6",
        ),
        (lambda: identify.identify_servos.procedure(ARM, poses=[[0.0]]), r"postures \(K, 7\)"),
        (lambda: identify.identify_servos.procedure(ARM, poses=0), r"poses must be at least 1"),
        (lambda: identify.identify_servos(Plant(ARM), ARM, rate=np.nan), r"rate \[Hz\] must be in"),
    ],
)
def test_wrong_arguments_are_rejected_with_the_accepted_ones(make, text):
    with pytest.raises((pliant.PliantError, TypeError), match=text):
        make()


def test_another_arms_positions_end_a_procedure():
    with pytest.raises(pliant.ShapeError, match="7 finite numbers"):
        identify.capture_gravity(Plant(pliant.robots.so101()), pliant.Controller(ARM))


def test_a_diverging_simulation_is_not_a_config_error(monkeypatch):
    plant = Plant(ARM)
    monkeypatch.setattr(plant, "_is_passive", lambda: False)
    monkeypatch.setattr(plant, "_run", lambda steps: plant.mj_data.qpos.fill(np.nan))
    with pytest.raises(pliant.PliantError, match=r"diverged at t = 0\.0\d+ s with dt") as error:
        plant.advance()
    assert error.type is pliant.PliantError
