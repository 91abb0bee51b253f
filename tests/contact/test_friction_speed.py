"""The friction in a `ContactEstimator` equals the controller's feed-forward at every speed."""

import numpy as np
import pytest

import pliant

Q = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])
FRICTION, SPEED = 0.3, 0.05  # [N·m], [rad/s]


@pytest.mark.parametrize("friction_speed", [0.01, 0.05, 0.5])
def test_residual_and_feed_forward_have_one_friction(friction_speed):
    model = pliant.robots.arm7()
    servos = pliant.Servos(kp=150.0, max_torque=10.7, friction=FRICTION, damping=0.0)
    settings = pliant.Settings.firm().replace(
        paper_options=pliant.functional.PaperOptions(friction_speed=friction_speed)
    )
    controller = pliant.Controller(model, settings, servos)
    contact = pliant.ContactEstimator(controller)
    speed = np.full(7, SPEED)
    load = model.gravity(Q) + FRICTION * np.tanh(SPEED / friction_speed)
    for _ in range(400):
        estimate = contact.update(Q, dq=speed, load=load, dt=0.01)
    assert np.abs(estimate.torque_residual).max() < 1e-3 * FRICTION


def test_the_bound_of_an_error_message_is_accepted():
    model = pliant.robots.so101()
    controller = pliant.Controller(model, pliant.Settings.firm(task="xyz"))
    contact = pliant.ContactEstimator(controller)
    for axis in ("x", "y", "z"):
        with pytest.raises(pliant.OutOfRangeError) as error:
            pliant.reactions.Force(axis, above=0.01).validate(contact, controller)
        bound = float(str(error.value).partition("outside [")[2].partition(",")[0])
        pliant.reactions.Force(axis, above=bound).validate(contact, controller)
        with pytest.raises(pliant.OutOfRangeError) as error:
            pliant.ContactEstimator(controller, touch={axis: 0.01})
        bound = float(error.value.bound.partition("[")[2].partition(",")[0])
        pliant.ContactEstimator(controller, touch={axis: bound})
