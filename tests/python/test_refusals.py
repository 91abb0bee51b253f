"""Error messages for invalid arguments: they name argument, value, bound and alternatives."""

from __future__ import annotations

import numpy as np
import pytest

import pliant


def error_text(call, *args, **kwargs) -> str:
    with pytest.raises((pliant.PliantError, TypeError, OSError)) as error:
        call(*args, **kwargs)
    return str(error.value)


@pytest.mark.parametrize("dt", [1.01, 10.0])
def test_a_time_in_milliseconds_is_refused(controller, model, q, target, dt):
    message = rf"dt [s] = {dt:g} is outside (0, 1]; is it in milliseconds?"
    assert error_text(controller.step, q, target, dt=dt) == message
    assert error_text(controller.step_joints, q, q, dt=dt) == message
    assert error_text(controller.step_batch, q[None], target, dt=dt) == message
    assert error_text(pliant.ContactEstimator(controller).update, q, dt=dt) == message
    for instance in (controller, pliant.Controller(model, pliant.Settings(rate=1.0))):
        instance.step(q, target, dt=None if instance is not controller else 1.0)
    assert error_text(controller.step, q, target, dt=0.0) == "dt [s] = 0 is outside (0, 1]"
    assert error_text(controller.step, q, target, dt=np.nan) == "dt [s] = NaN is outside (0, 1]"


@pytest.mark.parametrize("axis", range(3))
def test_a_position_in_millimetres_is_refused(model, q, target, axis):
    controller = pliant.Controller(model, pliant.Settings(task="xyz"))
    position = target[:3, 3].copy()
    position[axis] = target[axis, 3] = -250.0
    message = error_text(model.check_target, position).removeprefix("target")
    assert message.startswith(": distance of position [")
    assert "outside [0, 1.520]: the arm reaches 0.710 m; is it in millimetres?" in message
    assert error_text(controller.step, q, target) == f"target{message}"
    assert error_text(controller.step, q, position) == f"target{message}"
    assert error_text(controller.step_batch, q[None], target) == f"targets{message}"
    assert error_text(controller.step_batch, q[None], position[None]).endswith(message)
    expected = f"position {'xyz'[axis]} [m] = -250 is outside ±100; is it in millimetres?"
    assert error_text(model.inverse_kinematics, target, q).endswith(expected)
    position[axis] = 1.2
    goals = controller.step_batch(np.stack([q, q]), position).goal
    assert np.isfinite(goals).all()
    assert np.isfinite(controller.step(q, position).goal).all()


def test_a_pose_with_a_wrong_last_row_is_refused(model, target):
    controller = pliant.Controller(model)
    target[3, 0] = 1.0
    message = "last row of a 4×4 pose must be 0 0 0 1, got 1 0 0 1: is the matrix transposed?"
    assert error_text(controller.check, target) == f"path_or_pose: {message}"
    target[3] = 1.0, 0.0, 0.0, 2.0
    assert error_text(controller.check, target).endswith("got 1 0 0 2")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: pliant.Settings(max_tool_speed=300),
            "max_tool_speed [m/s, rad/s] = 300 is outside",
        ),
        (
            lambda: pliant.Axis(deviation_limit=20),
            "deviation_limit = 20 is outside (0, 5] [m, rad]",
        ),
        (lambda: pliant.Axis(soft_until=10, firm_from=100), "firm_from = 100 is outside"),
    ],
)
def test_millimetres_and_degrees_in_settings_are_refused(make, message):
    def controller():
        value = make()
        if isinstance(value, pliant.Axis):
            value = pliant.Settings(axes={"x": value})
        pliant.Controller(pliant.robots.arm7(), value)

    assert message in error_text(controller)


def test_nan_is_named_in_the_error(model, q, target):
    invalid_q = np.where(np.arange(7) == 2, np.nan, q)
    name = model.joint_names[2]
    assert error_text(model.forward_kinematics, invalid_q) == f"q[2] ({name}) = NaN is outside ±1e6"
    controller = pliant.Controller(model)
    assert error_text(controller.step, invalid_q, target) == f"q[2] ({name}) = NaN is outside ±1e6"
    target[0, 3] = np.inf
    message = error_text(controller.step, q, target)
    assert message == "target: position x [m] = inf is outside ±100"


def calls(model, q):
    """Return calls with one argument of a wrong type, and the expected error texts."""
    instance = pliant.Controller(model, pliant.Settings(task="xyz"))
    position = model.forward_kinematics(q)[:3, 3]
    contact = pliant.ContactEstimator(instance)
    text = model.source[0]
    servos = pliant.Servos.of
    return {
        "mass": (
            lambda: instance.set_payload("0.3"),
            "a number [kg]; 0 for no payload, got '0.3' (str)",
        ),
        "mass ": (lambda: instance.set_payload(None), "a number [kg]; 0 for no payload, got None"),
        "delay": (lambda: instance.set_delay("a"), "a number [s], got 'a' (str)"),
        "delay ": (lambda: instance.set_delay(True), "a number [s], got True (bool)"),
        "press": (lambda: pliant.Settings.wipe(press="5"), "a number [N], got '5' (str)"),
        "pull": (lambda: pliant.Settings.drawer(pull="5"), "a number [N], got '5' (str)"),
        "push": (lambda: pliant.Settings.plug(push="5"), "a number [N], got '5' (str)"),
        "axis": (lambda: pliant.Settings.wipe(axis=3), "the name of an axis, such as 'x', got 3"),
        "kp_error": (
            lambda: pliant.ContactEstimator(instance, kp_error="2%"),
            "a number; a share of 2 % is 0.02",
        ),
        "filter": (
            lambda: pliant.ContactEstimator(instance, filter="fast"),
            "a number [s], got 'fast' (str)",
        ),
        "max_wrench": (
            lambda: pliant.ContactEstimator(instance, max_wrench=3),
            "a pair (force [N], torque [N·m]), got 3",
        ),
        "axes": (
            lambda: pliant.ContactEstimator(instance, axes=3),
            "an axis key such as 'xyz rpy', got 3",
        ),
        "accept_thresholds": (
            lambda: pliant.ContactEstimator(instance, accept_thresholds=3),
            "True or False, got 3",
        ),
        "dt": (lambda: contact.update(q, dt="a"), "a number [s], got 'a' (str)"),
        "sent": (lambda: contact.update(q, sent=3), "a pair (goal, torque_limit), got 3"),
        "count": (lambda: instance.batch_state(-1), "a whole number, 0 or more, got -1 (int)"),
        "state": (
            lambda: instance.step_batch(q[None], position, state=3),
            "a BatchState, as batch_state(N) ",
        ),
        "out": (
            lambda: instance.step(q, position, out=np.zeros(7)),
            "a Command, as a step returns it, got ",
        ),
        "source": (lambda: pliant.Model.from_urdf(None), "the path of a URDF file (str or path"),
        "text": (lambda: pliant.Model.from_urdf_str(None), "URDF text; for a file there is Model"),
        "damping": (
            lambda: pliant.functional.damped_pseudo_inverse(np.eye(3), "a"),
            "a number, got 'a' (str)",
        ),
        "restarts": (
            lambda: model.inverse_kinematics(np.eye(4), q, restarts=-1),
            "a whole number, 0 or more, got -1 (int)",
        ),
        "position_tolerance": (
            lambda: model.inverse_kinematics(np.eye(4), q, position_tolerance="fine"),
            "a number [m], got 'fine' (str)",
        ),
        "voltage [V]": (lambda: servos(["sts3215"], voltage="7.4"), "a number, got '7.4' (str)"),
        "locked.wrist": (
            lambda: pliant.Model.from_urdf_str(text, tip="tool", locked={"wrist": "0"}),
            "a position [rad or m], got '0' (str)",
        ),
        "limits.wrist": (
            lambda: pliant.Model.from_urdf_str(text, tip="tool", limits={"wrist": 2.0}),
            "a pair (lower, upper) [rad or m], got 2.0 (float)",
        ),
        "locked": (
            lambda: pliant.Model.from_urdf_str(text, tip="tool", locked=3),
            "a dict such as {'gripper': 0.3}, got 3 (int)",
        ),
        "Axis.soft": (lambda: pliant.Axis(soft="a"), "a number, or a pair (pushed toward -"),
    }


def test_an_argument_of_a_wrong_type_is_named_with_valid_types(model, q):
    for name, (call, expected) in calls(model, q).items():
        message = error_text(call)
        assert message.startswith(name.strip()), message
        assert f"must be {expected}" in message, message


def test_errors_name_the_axis(model):
    assert error_text(pliant.Axis, soft=5, firm=1) == "Axis.soft = 5 is outside [0, firm = 1]"
    settings = pliant.Settings(
        axes={"y": pliant.Axis(yields="both", stiffness=1e5)}, law="impedance"
    )
    message = error_text(pliant.Controller, model, settings)
    assert "axes.stiffness: y=100000 N/m is" in message
    assert " times the bound for the median pose" in message


def test_the_variant_of_a_servo_that_fits_the_supply_is_named():
    message = error_text(pliant.Servos.of, ["STS3215-7.4V"], voltage=12.0)
    assert "STS3215-7.4V takes 4 to 8.4 V, got 12 V; for 12 V there is STS3215-12V;" in message
    assert "there is" not in error_text(pliant.Servos.of, ["STS3215-7.4V"], voltage=100.0)
