"""Report and check from Python: shapes, texts, inputs."""

from __future__ import annotations

import json

import numpy as np
import pytest

import pliant
from pliant import robots

SHAPES = {
    "q": (7,),
    "torque_limit": (7,),
    "static_force": (6, 2),
    "capacity": (6, 2),
    "gives_way": (6, 2, 2),
    "friction": (6,),
    "friction_left": (6,),
    "coupling": (6, 2),
    "thresholds": (6, 2),
    "gravity_margin": (7, 2),
    "saturated": (7,),
    "locked": (7,),
    "host_loss_force": (6, 2),
    "stop_distance": (6, 2),
    "stop_room": (6, 2),
    "stop_friction": (6, 2),
    "way_friction": (6, 2),
    "way_sigma": (6, 2),
    "way_distance": (6, 2),
    "deviation_limit": (6, 2),
}


def test_report_has_everything_and_can_be_written_down(controller, q):
    report = controller.report(q=q)
    for name, shape in SHAPES.items():
        assert getattr(report, name).shape == shape, name
    assert report.axes == ("x", "y", "z", "roll", "pitch", "yaw")
    assert len(report.joints) == len(report.q)
    assert len(report.yields) == len(report.coupled_to) == len(report.stop_joint) == 6
    assert report.sigma_min > 0.0
    assert report.condition > 1.0
    assert json.loads(json.dumps(report.to_dict()))["axes"] == list(report.axes)
    assert set(SHAPES) <= set(report.to_dict())
    assert report == controller.report(q)


@pytest.mark.parametrize("displaced", [0.0, 0.03])
def test_dead_host_max_bounds_what_is_left_of_a_dead_host(model, q, displaced):
    target = model.forward_kinematics(q)
    target[0, 3] += displaced
    plain = pliant.Controller(model, pliant.Settings.soft("y"))
    plain.step(q, target)
    free = plain.report()
    most = float(free.host_loss_force[:3].max()) - 4.0  # [N]
    controller = pliant.Controller(
        model,
        pliant.Settings.soft("y", torque_limits=pliant.TorqueLimits(max_host_loss_force=most)),
    )
    command = controller.step(q, target)
    report = controller.report()
    assert most - 0.5 < report.host_loss_force[:3].max() <= most
    assert report.max_host_loss_force == most
    assert np.all(command.torque_limit <= free.torque_limit)
    assert np.all(command.torque_limit >= 1.1 * np.abs(model.gravity(q)) - 1e-12)
    assert not [said for said in report.summary() if "max_host_loss_force" in said]


def test_more_than_the_weight_leaves_cannot_be_kept(model, q):
    settings = pliant.Settings.soft(
        "y", torque_limits=pliant.TorqueLimits(max_host_loss_force=10.0)
    )
    report = pliant.Controller(model, settings).report(q)
    assert report.host_loss_force[2, 0] > 10.0
    (said,) = [said for said in report.summary() if "max_host_loss_force" in said]
    assert "−z" in said
    check = pliant.feasibility.check_path(model, settings, q)
    assert not check
    (found,) = [one for one in check.findings if one.setting == "torque_limits.max_host_loss_force"]
    assert (found.about, found.required) == ("−z", True)
    assert found.value >= report.host_loss_force[2, 0]
    assert pliant.feasibility.check_path(
        model,
        settings.replace(torque_limits=pliant.TorqueLimits(max_host_loss_force=found.value)),
        q,
    )
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(pliant.OutOfRangeError, match="max_host_loss_force"):
            pliant.Settings(torque_limits=pliant.TorqueLimits(max_host_loss_force=wrong))


def test_what_delay_takes_off_springs_and_dampers_can_be_read(model, q):
    springs = {"xyz": pliant.Axis(stiffness=800.0, damping=90.0)}
    controller = pliant.Controller(model, pliant.Settings(law="impedance", axes=springs))
    report = controller.report(q)
    assert report.damping_factor == controller.report(q).damping_factor <= 1.0
    controller.set_delay(0.1)
    late = controller.report(q)
    assert late.damping_factor < report.damping_factor
    assert late.gain_factor < report.gain_factor
    (said,) = [said for said in late.summary() if "damping" in said]
    assert f"{late.damping_factor:.2f}"[:4] in said


def test_a_hold_raised_to_leave_room_is_reported(model, q):
    settings = pliant.Settings(axes={"y": pliant.Axis(soft=90.0)})
    (said,) = [s for s in pliant.Controller(model, settings).report(q).summary() if "room" in s]
    assert said == "y: hold is 90.0 N instead of 40.0, to leave room for soft and firm."


def test_formula_of_the_static_force(controller, model, q):
    report = controller.report(q)
    jacobian, gravity = model.jacobian(q), model.gravity(q)
    for side, sign in enumerate((-1.0, 1.0)):
        lever = sign * jacobian
        room = (report.torque_limit + np.sign(lever) * gravity) / np.abs(lever)
        np.testing.assert_allclose(report.static_force[:, side], room.min(axis=1), rtol=1e-9)


def test_report_of_the_last_step_needs_one(controller, q, target):
    with pytest.raises(pliant.ConfigError, match="no step"):
        controller.report()
    command = controller.step(q, target)
    np.testing.assert_array_equal(controller.report().torque_limit, command.torque_limit)


def test_sentences_of_the_report(controller, q):
    report = controller.report(q)
    said = report.summary()
    assert any(
        line.startswith("±y gives way at") and "cannot be softer than" in line for line in said
    )
    assert any(line.startswith("After a host loss now") for line in said)
    assert all(line.endswith(".") for line in said)
    assert all(line in str(report) for line in said)
    assert "Report" in repr(report)


def along_y(model, q):
    """Return joint rates while a push moves y by one metre, along the servos' springs."""
    jacobian = model.jacobian(q)
    springs = jacobian.T / np.asarray(model.servos.kp)[:, None]
    return (springs @ np.linalg.inv(jacobian @ springs))[:, 1]


def near_a_stop(model, q, room):
    """Return the arm with the joint that +y turns most at this distance from its upper limit."""
    joint = int(np.argmax(along_y(model, q)))
    limits = {name: (-50.0, 50.0) for name in model.joint_names}
    limits[model.joint_names[joint]] = (-50.0, q[joint] + room)
    return robots.arm7(limits=limits), joint


def test_a_position_limit_is_announced_where_it_is_met(model, q):
    settings = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=15.0)})
    near, joint = near_a_stop(model, q, 0.035)
    report = pliant.Controller(near, settings).report(q)
    assert report.stop_joint[1] == (None, near.joint_names[joint])
    way = report.stop_distance[1, 1]
    assert 0.0 < way < 0.15
    assert report.stop_room[1, 1] == pytest.approx(0.035)
    # A push that far, in small steps, ends at the limit.
    at, steps = q.copy(), 1000
    for _ in range(steps):
        at += way / steps * along_y(near, at)
    assert at[joint] == pytest.approx(q[joint] + 0.035, abs=1e-3)
    # There the others remain, with their friction.
    left = np.linalg.pinv(np.delete(near.jacobian(at), joint, axis=1))[:, 1]
    rubs = np.abs(left) @ np.delete(model.servos.friction, joint)
    assert report.stop_friction[1, 1] == pytest.approx(rubs, rel=0.05)
    start = f"+y: {near.joint_names[joint]} is 2.0° from its limit: pushed farther than "
    (said,) = [line for line in report.summary() if line.startswith(start)]
    assert said.startswith(f"{start}{1e3 * way:.0f} mm, the stop takes")


def test_an_axis_without_a_stop_in_its_way_announces_none(model, q):
    settings = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=15.0)})
    wide = {name: (-50.0, 50.0) for name in model.joint_names}
    report = pliant.Controller(robots.arm7(limits=wide), settings).report(q)
    assert np.isinf(report.stop_distance).all()
    assert np.isinf(report.stop_room).all()
    assert not report.stop_friction.any()
    assert not any("limit:" in line for line in report.summary())
    report = pliant.Controller(near_a_stop(model, q, 0.0)[0], settings).report(q)
    np.testing.assert_array_equal(report.stop_distance[1], (np.inf, 0.0))
    assert any("is at its limit" in line for line in report.summary())


def test_check_notes_a_stop_that_comes_before_the_whole_cap(model, q):
    settings = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=15.0)})
    near, joint = near_a_stop(model, q, 0.035)
    check = pliant.feasibility.check_path(near, settings, np.array([q, q - 0.01]))
    assert check.achievable, "a note, not a demand"
    (note,) = [f for f in check.findings if "position limit when" in f.reason]
    assert note.pose == 0
    assert note.about == "+y"
    assert near.joint_names[joint] in note.reason
    distance = pliant.Controller(near, settings).report(q).stop_distance[1]
    np.testing.assert_array_equal(check.stop_distance[1], distance)
    assert np.isinf(check.stop_distance[0]).all(), "x does not yield"


def test_deviation_limits_are_reported(model, q):
    held = pliant.Axis(deviation_limit=0.02, on_deviation_limit="wait")
    follows = pliant.Axis(deviation_limit=0.1)
    settings = pliant.Settings(axes={"x": held, "yaw": follows, "y": pliant.Axis(soft=4.0)})
    report = pliant.Controller(model, settings).report(q)
    np.testing.assert_array_equal(report.deviation_limit[[0, 1, 5], 0], (0.02, np.inf, 0.1))
    said = report.summary()
    assert "±x: pushed farther than 20 mm off its target, the whole target waits." in said
    assert "±yaw: pushed farther than 0.10 rad off its target, its target comes along." in said
    assert sum("off its target" in line for line in said) == 2


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
    asked = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=80.0)})
    check = pliant.feasibility.check_path(model, asked, q)
    assert not check
    worst = min((f for f in check.findings if f.required), key=lambda f: f.value)
    assert worst.setting == "axes.y.firm"
    assert worst.about in ("+y", "−y")
    assert f"nearest that works: axes.y.firm={worst.value:g}" in str(check)
    better = asked.replace(axes={"y": pliant.Axis(soft=4.0, firm=worst.value)})
    assert pliant.feasibility.check_path(model, better, q)


def test_tracking_raises_soft_to_three_times_the_friction(model, q):
    asked = pliant.Settings(axes={"y": pliant.Axis(soft=0.01, firm=15.0)})
    raised = asked.raise_soft(model, q)
    rubs = pliant.Controller(model, asked).report(q).friction[1]
    soft = np.max(raised.axes["y"].soft)
    assert 3.0 * rubs <= soft <= 3.3 * rubs
    np.testing.assert_array_equal(raised.axes["y"].firm, 15.0)
    assert raised.raise_soft(model, q) == raised
    assert np.min(asked.raise_soft(model).axes["y"].soft) > 0.1


def test_a_singular_pose_that_a_push_leads_to_is_said(model):
    """A nearly stretched elbow: pushed outward, the arm's reach ends."""
    q = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])
    bent = q.copy()
    bent[3] = -0.6
    settings = pliant.Settings(axes={"x": pliant.Axis(soft=5.0)})
    report = pliant.Controller(model, settings).report(bent)
    near = 0.1 * report.sigma_0
    assert report.way_sigma[0, 1] < near < 0.99 * report.way_sigma[0, 0]
    assert report.way_friction[0, 1] > 5.0 * report.friction[0]
    assert report.way_friction[0, 0] < 1.1 * report.friction[0]
    far = report.way_distance[0, 1]
    for share, reached in ((0.7, True), (1.05, False)):
        target = model.forward_kinematics(bent)
        target[0, 3] += share * far
        assert model.inverse_kinematics(target, bent).converged is reached
    (said,) = [s for s in report.summary() if "singular" in s]
    assert said.startswith(f"+x: pushed by {1e3 * far:.0f} mm the arm is near a singular pose")

    check = pliant.feasibility.check_path(model, settings, np.stack([q, bent]))
    assert check.sigma_pose == 1
    assert check.sigma_min == pytest.approx(report.sigma_min, rel=0.01)
    assert check.way_sigma[0, 1] == report.way_sigma[0, 1]
    assert np.all(np.isinf(check.way_sigma[1:])), "sides that do not yield"
    (found,) = [one for one in check.findings if "singular" in one.reason]
    assert (found.about, found.pose, found.required) == ("+x", 1, False)


def test_check_takes_what_a_step_takes(model, q, target):
    at = target[:3, 3]
    lone = pliant.Settings(task="xyz")
    wanted = str(pliant.feasibility.check_path(model, lone, target, q0=q))

    class Held:
        matrix = target

    for form in (at, at.tolist(), pliant.Pose(target), Held()):
        assert str(pliant.feasibility.check_path(model, lone, form, q0=q)) == wanted
        pliant.Controller(model, lone).step(q, form)
    with pytest.raises(pliant.ShapeError, match=r"expected \(4, 4\), \(3,\), \(7,\) or \(N, 7\)"):
        pliant.feasibility.check_path(model, lone, np.zeros(5))
    with pytest.raises(pliant.ShapeError, match=r"expected \(4, 4\), \(7,\) or \(N, 7\)"):
        pliant.feasibility.check_path(model, pliant.Settings(), at)
    assert not pliant.feasibility.check_path(model, lone, [0.9, 0.0, 0.9])
