"""`Controller.report` and `feasibility.check_path`: shapes, texts and errors."""

from __future__ import annotations

import numpy as np
import pytest

import pliant
from pliant import robots


def test_report_has_joint_arrays_and_one_entry_per_axis(controller, q):
    report = controller.report(q=q)
    for name in ("q", "torque_limit", "saturated", "locked"):
        assert getattr(report, name).shape == (7,), name
    assert report.gravity_margin.shape == (7, 2)
    assert len(report.joints) == 7
    assert tuple(report.axes) == ("x", "y", "z", "roll", "pitch", "yaw")
    for name, axis in report.axes.items():
        assert axis.name == name
        assert np.shape(axis.yield_force) == (2, 2)
        for pair in (axis.static_force, axis.capacity, axis.coupling, axis.host_loss_force):
            assert np.shape(pair) == (2,), name
        assert axis.friction >= axis.friction_left >= 0.0
        assert axis.thresholds[0] <= axis.thresholds[1]
        assert len(axis.yields) == len(axis.coupled_to) == len(axis.stop) == 2
    assert report.axes["y"].yields == (True, True)
    assert report.axes["z"].yields == (False, False)
    assert report.sigma_min > 0.0
    assert report.condition > 1.0
    again = controller.report(q)
    assert report == again
    assert report.axes["y"] == again.axes["y"]
    assert report.axes["y"] != report.axes["z"]


def largest_host_loss_force(report):
    """Return the largest force on a hand along the translations after a host loss."""
    return max(max(report.axes[axis].host_loss_force) for axis in "xyz")


@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_max_host_loss_force_bounds_the_force_after_a_host_loss(model, q, offset):
    target = model.forward_kinematics(q)
    target[0, 3] += offset
    unbounded = pliant.Controller(model, pliant.Settings.soft("y"))
    unbounded.step(q, target)
    free = unbounded.report()
    largest = largest_host_loss_force(free) - 4.0  # [N]
    controller = pliant.Controller(
        model,
        pliant.Settings.soft("y", torque_limits=pliant.TorqueLimits(max_host_loss_force=largest)),
    )
    command = controller.step(q, target)
    report = controller.report()
    assert largest - 0.5 < largest_host_loss_force(report) <= largest
    assert report.max_host_loss_force == largest
    assert np.all(command.torque_limit <= free.torque_limit)
    assert np.all(command.torque_limit >= 1.1 * np.abs(model.gravity(q)) - 1e-12)
    assert not [sentence for sentence in report.summary() if "max_host_loss_force" in sentence]


def test_a_bound_below_the_share_of_the_weight_is_reported(model, q):
    settings = pliant.Settings.soft(
        "y", torque_limits=pliant.TorqueLimits(max_host_loss_force=10.0)
    )
    report = pliant.Controller(model, settings).report(q)
    assert report.axes["z"].host_loss_force[0] > 10.0
    (sentence,) = [sentence for sentence in report.summary() if "max_host_loss_force" in sentence]
    assert "−z" in sentence
    check = pliant.feasibility.check_path(model, settings, q)
    assert not check
    (issue,) = [
        item for item in check.issues if item.setting == "torque_limits.max_host_loss_force"
    ]
    assert (issue.about, issue.required) == ("−z", True)
    assert issue.value >= report.axes["z"].host_loss_force[0]
    assert pliant.feasibility.check_path(
        model,
        settings.replace(torque_limits=pliant.TorqueLimits(max_host_loss_force=issue.value)),
        q,
    )
    for value in (0.0, -1.0, np.nan):
        with pytest.raises(pliant.OutOfRangeError, match="max_host_loss_force"):
            pliant.Settings(torque_limits=pliant.TorqueLimits(max_host_loss_force=value))


def test_the_reduction_of_springs_and_dampers_by_delay_is_reported(model, q):
    springs = {"xyz": pliant.Axis(stiffness=800.0, damping=90.0)}
    controller = pliant.Controller(model, pliant.Settings(law="impedance", axes=springs))
    report = controller.report(q)
    assert report.damping_factor == controller.report(q).damping_factor <= 1.0
    controller.set_delay(0.1)
    delayed_report = controller.report(q)
    assert delayed_report.damping_factor < report.damping_factor
    assert delayed_report.gain_factor < report.gain_factor
    (sentence,) = [sentence for sentence in delayed_report.summary() if "damping" in sentence]
    assert f"{delayed_report.damping_factor:.2f}"[:4] in sentence


def test_a_hold_raised_to_leave_room_is_reported(model, q):
    settings = pliant.Settings(axes={"y": pliant.Axis(soft=90.0)})
    (sentence,) = [s for s in pliant.Controller(model, settings).report(q).summary() if "room" in s]
    assert sentence == "y: hold is 90.0 N instead of 40.0, to leave room for soft and firm."


def test_formula_of_the_static_force(controller, model, q):
    report = controller.report(q)
    jacobian, gravity = model.jacobian(q), model.gravity(q)
    for side, sign in enumerate((-1.0, 1.0)):
        lever = sign * jacobian
        room = (report.torque_limit + np.sign(lever) * gravity) / np.abs(lever)
        forces = [axis.static_force[side] for axis in report.axes.values()]
        np.testing.assert_allclose(forces, room.min(axis=1), rtol=1e-9)


def test_report_of_the_last_step_needs_one(controller, q, target):
    with pytest.raises(pliant.ConfigError, match="no step"):
        controller.report()
    command = controller.step(q, target)
    np.testing.assert_array_equal(controller.report().torque_limit, command.torque_limit)


def test_sentences_of_the_report(controller, q):
    report = controller.report(q)
    sentences = report.summary()
    assert any(
        line.startswith("±y gives way at") and "cannot be softer than" in line for line in sentences
    )
    assert any(line.startswith("After a host loss now") for line in sentences)
    assert all(line.endswith(".") for line in sentences)
    assert all(line in str(report) for line in sentences)
    assert "Report" in repr(report)


def along_y(model, q):
    """Return the motion of the joints per metre of y under a push, by the servos' stiffness."""
    jacobian = model.jacobian(q)
    springs = jacobian.T / np.asarray(model.servos.kp)[:, None]
    return (springs @ np.linalg.inv(jacobian @ springs))[:, 1]


def arm_near_limit(model, q, room):
    """Return the arm with a joint at the distance `room` [rad] from its upper limit, and its index.

    It is the joint that a motion along +y turns most.
    """
    joint = int(np.argmax(along_y(model, q)))
    limits = {name: (-50.0, 50.0) for name in model.joint_names}
    limits[model.joint_names[joint]] = (-50.0, q[joint] + room)
    return robots.arm7(limits=limits), joint


def test_a_position_limit_is_announced_where_it_is_met(model, q):
    settings = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=15.0)})
    limited_model, joint = arm_near_limit(model, q, 0.035)
    report = pliant.Controller(limited_model, settings).report(q)
    towards_minus, stop = report.axes["y"].stop
    assert towards_minus is None
    assert stop.joint == limited_model.joint_names[joint]
    distance = stop.distance
    assert 0.0 < distance < 0.15
    assert stop.margin == pytest.approx(0.035)
    # Move by the reported distance in small steps: the joint must end at its limit.
    position, steps = q.copy(), 1000
    for _ in range(steps):
        position += distance / steps * along_y(limited_model, position)
    assert position[joint] == pytest.approx(q[joint] + 0.035, abs=1e-3)
    # At the limit, the other joints continue the motion against their friction.
    others = np.linalg.pinv(np.delete(limited_model.jacobian(position), joint, axis=1))[:, 1]
    rubs = np.abs(others) @ np.delete(model.servos.friction, joint)
    assert stop.friction == pytest.approx(rubs, rel=0.05)
    start = f"+y: {limited_model.joint_names[joint]} is 2.0° from its limit: pushed farther than "
    (sentence,) = [line for line in report.summary() if line.startswith(start)]
    assert sentence.startswith(f"{start}{1e3 * distance:.0f} mm, the stop takes")


def test_an_axis_without_a_stop_in_its_way_announces_none(model, q):
    settings = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=15.0)})
    limits = {name: (-50.0, 50.0) for name in model.joint_names}
    report = pliant.Controller(robots.arm7(limits=limits), settings).report(q)
    assert all(axis.stop == (None, None) for axis in report.axes.values())
    assert not any("limit:" in line for line in report.summary())
    report = pliant.Controller(arm_near_limit(model, q, 0.0)[0], settings).report(q)
    towards_minus, stop = report.axes["y"].stop
    assert towards_minus is None
    assert stop.distance == 0.0
    assert any("is at its limit" in line for line in report.summary())


def test_check_notes_a_stop_that_comes_before_the_whole_cap(model, q):
    settings = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=15.0)})
    limited_model, joint = arm_near_limit(model, q, 0.035)
    check = pliant.feasibility.check_path(limited_model, settings, np.array([q, q - 0.01]))
    assert check.achievable, "a note, not a demand"
    (note,) = [f for f in check.issues if "position limit when" in f.reason]
    assert note.pose == 0
    assert note.about == "+y"
    assert limited_model.joint_names[joint] in note.reason
    stops = pliant.Controller(limited_model, settings).report(q).axes["y"].stop
    distance = [np.inf if stop is None else stop.distance for stop in stops]
    np.testing.assert_array_equal(check.stop_distance[1], distance)
    assert np.isinf(check.stop_distance[0]).all(), "x does not yield"


def test_deviation_limits_are_reported(model, q):
    limited_axis = pliant.Axis(deviation_limit=0.02, on_deviation_limit="wait")
    follows = pliant.Axis(deviation_limit=0.1)
    settings = pliant.Settings(axes={"x": limited_axis, "yaw": follows, "y": pliant.Axis(soft=4.0)})
    report = pliant.Controller(model, settings).report(q)
    limits = [report.axes[axis].deviation_limit[0] for axis in ("x", "y", "yaw")]
    np.testing.assert_array_equal(limits, (0.02, np.inf, 0.1))
    assert report.axes["x"].on_deviation_limit == "wait"
    sentences = report.summary()
    assert "±x: pushed farther than 20 mm off its target, the whole target waits." in sentences
    sentence = "±yaw: pushed farther than 0.10 rad off its target, its target follows the tool."
    assert sentence in sentences
    assert sum("off its target" in line for line in sentences) == 2


def test_check_takes_a_posture_a_path_and_a_pose(controller, model, q):
    assert controller.check(q)
    path = q + 0.1 * np.sin(np.arange(35).reshape(5, 7))
    check = controller.check(path)
    assert check.poses == 5
    assert check.achievable
    assert check.capacity.shape == (6, 2)
    assert check.friction_left.shape == (6,)
    assert len(check.worst_pose) == 6
    assert max(max(pair) for pair in check.worst_pose) < 5
    pose = model.forward_kinematics(q)
    for target in (pose, pliant.Pose(pose)):
        assert controller.check(target, q0=q).achievable
    with pytest.raises(pliant.ShapeError, match=r"\(N, 7\)"):
        controller.check(np.zeros(6))


def test_check_names_the_setting_and_a_value_that_works(model, q):
    wanted = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=80.0)})
    check = pliant.feasibility.check_path(model, wanted, q)
    assert not check
    worst = min((f for f in check.issues if f.required), key=lambda f: f.value)
    assert worst.setting == "axes.y.firm"
    assert worst.about in ("+y", "−y")
    assert f"nearest that works: axes.y.firm={worst.value:g}" in str(check)
    changed = wanted.replace(axes={"y": pliant.Axis(soft=4.0, firm=worst.value)})
    assert pliant.feasibility.check_path(model, changed, q)


def test_tracking_raises_soft_to_three_times_the_friction(model, q):
    original = pliant.Settings(axes={"y": pliant.Axis(soft=0.01, firm=15.0)})
    result = original.raise_soft(model, q)
    rubs = pliant.Controller(model, original).report(q).axes["y"].friction
    soft = np.max(result.axes["y"].soft)
    assert 3.0 * rubs <= soft <= 3.3 * rubs
    np.testing.assert_array_equal(result.axes["y"].firm, 15.0)
    assert result.raise_soft(model, q) == result
    assert np.min(original.raise_soft(model).axes["y"].soft) > 0.1


def test_a_singular_pose_that_a_push_leads_to_is_reported(model):
    """The elbow is nearly stretched, so that an outward push ends at the arm's reach."""
    q = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])
    bent_q = q.copy()
    bent_q[3] = -0.6
    settings = pliant.Settings(axes={"x": pliant.Axis(soft=5.0)})
    report = pliant.Controller(model, settings).report(bent_q)
    threshold, x = 0.1 * report.sigma_0, report.axes["x"]
    assert x.path_sigma[1] < threshold < 0.99 * x.path_sigma[0]
    assert x.path_friction[1] > 5.0 * x.friction
    assert x.path_friction[0] < 1.1 * x.friction
    distance = x.path_distance[1]
    for share, is_reached in ((0.7, True), (1.05, False)):
        target = model.forward_kinematics(bent_q)
        target[0, 3] += share * distance
        assert model.inverse_kinematics(target, bent_q).converged is is_reached
    (sentence,) = [s for s in report.summary() if "singular" in s]
    assert sentence.startswith(
        f"+x: pushed by {1e3 * distance:.0f} mm the arm is near a singular pose"
    )

    check = pliant.feasibility.check_path(model, settings, np.stack([q, bent_q]))
    assert check.sigma_pose == 1
    assert check.sigma_min == pytest.approx(report.sigma_min, rel=0.01)
    assert check.path_sigma[0, 1] == x.path_sigma[1]
    assert np.all(np.isinf(check.path_sigma[1:])), "sides that do not yield"
    (issue,) = [item for item in check.issues if "singular" in item.reason]
    assert (issue.about, issue.pose, issue.required) == ("+x", 1, False)


def test_check_takes_what_a_step_takes(model, q, target):
    position = target[:3, 3]
    position_settings = pliant.Settings(task="xyz")
    expected = str(pliant.feasibility.check_path(model, position_settings, target, q0=q))

    class Held:
        matrix = target

    for form in (position, position.tolist(), pliant.Pose(target), Held()):
        assert str(pliant.feasibility.check_path(model, position_settings, form, q0=q)) == expected
        pliant.Controller(model, position_settings).step(q, form)
    with pytest.raises(pliant.ShapeError, match=r"expected \(4, 4\), \(3,\), \(7,\) or \(N, 7\)"):
        pliant.feasibility.check_path(model, position_settings, np.zeros(5))
    with pytest.raises(pliant.ShapeError, match=r"expected \(4, 4\), \(7,\) or \(N, 7\)"):
        pliant.feasibility.check_path(model, pliant.Settings(), position)
    assert not pliant.feasibility.check_path(model, position_settings, [0.9, 0.0, 0.9])
