"""Targets in wrong units: rejected by steps, batches, `check_path` and the command line."""

import copy
import pickle

import numpy as np
import pytest

import pliant
from pliant.cli._targets import Target

ARMS = ["arm7", "so101", "koch"]
#: Factors from metres to feet, inches, decimetres, centimetres, millimetres.
FACTORS = [1 / 0.3048, 1 / 0.0254, 10.0, 100.0, 1000.0]


@pytest.fixture(params=ARMS)
def arm(request):
    model = getattr(pliant.robots, request.param)()
    task = "xyz" if model.n < 6 else "xyz rpy"
    controller = pliant.Controller(model, pliant.Settings.firm(task=task))
    q = np.clip(np.full(model.n, 0.3), model.lower + 0.1, model.upper - 0.1)
    controller.step(q, model.forward_kinematics(q))
    return model, controller, q


def at(model, distance, direction):
    """Return a pose at a distance from the first joint [m], in a direction (3,)."""
    pose = np.eye(4)
    pose[:3, 3] = model.reach_origin + distance * direction / np.linalg.norm(direction)
    return pose


DIRECTIONS = [np.array(d, float) for d in ([1, 0, 0], [0, -1, 0], [0, 0, 1], [1, 1, 1], [-1, 2, 0])]


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_bound_on_a_target_is_a_ball_around_the_first_joint(arm, direction):
    model, controller, q = arm
    bound = 2.0 * model.reach + 0.1
    inside, outside = at(model, bound - 1e-6, direction), at(model, bound + 1e-6, direction)
    rows = np.array([q, q])
    controller.step(q, inside)
    model.check_target(inside)
    controller.check(inside, q0=q)
    state = controller.batch_state(2)
    controller.step_batch(rows, np.array([inside, inside]), state=state)
    before = pickle.dumps(controller)
    for call in (
        lambda: controller.step(q, outside),
        lambda: model.check_target(outside),
        lambda: model.check_target(outside[:3, 3]),
        lambda: controller.check(outside, q0=q),
        lambda: controller.step_batch(rows, outside),
        lambda: controller.step_batch(rows, np.array([inside, outside])),
        lambda: controller.step_batch(rows, np.array([inside, outside]), state=state),
    ):
        with pytest.raises(pliant.OutOfRangeError) as error:
            call()
        message = str(error.value)
        assert model.joint_names[0] in message
        assert "millimetres?" in message
        assert f"{model.reach:.3f} m" in message
        assert error.value.value > bound - 2e-3
    assert pickle.dumps(controller) == before


@pytest.mark.parametrize("factor", FACTORS)
def test_a_target_in_other_units_is_refused(arm, factor):
    """Targets at half the reach or more are tested; closer ones stay plausible in other units."""
    model, controller, q = arm
    rng = np.random.default_rng(1)
    for _ in range(50):
        pose = at(model, rng.uniform(0.5, 1.0) * model.reach, rng.normal(size=3))
        pose[:3, 3] -= model.reach_origin
        pose[:3, 3] *= factor
        pose[:3, 3] += model.reach_origin
        if (
            factor < 5.0
            and np.linalg.norm(pose[:3, 3] - model.reach_origin) < 2.0 * model.reach + 0.1
        ):
            continue
        with pytest.raises(pliant.OutOfRangeError, match="is it in millimetres"):
            controller.step(q, pose)


def test_the_targets_of_the_trial_are_refused():
    model = pliant.robots.so101()
    controller = pliant.Controller(model, pliant.Settings.firm(task="xyz"))
    q = np.array([0.0, -0.3, 0.3, 0.9, 0.0])
    command = controller.step(q, model.forward_kinematics(q))
    goal = command.goal.copy()
    for target in ([25, 0, 20], [90, 0, 90], [250, 0, 200], [25.0, 0.0, 0.2]):
        with pytest.raises(pliant.OutOfRangeError, match=r"millimetres\? .* axes of 'base'"):
            controller.step(q, target)
    again = controller.step(q, model.forward_kinematics(q))
    assert np.allclose(again.goal, goal, atol=1e-2)


def test_a_task_without_translations_takes_any_position():
    model = pliant.robots.arm7()
    controller = pliant.Controller(model, pliant.Settings.firm(task="rpy"))
    q = np.full(7, 0.2)
    pose = model.forward_kinematics(q)
    pose[:3, 3] = 50.0
    controller.step(q, pose)
    controller.step_batch(np.array([q]), pose)
    with pytest.raises(pliant.OutOfRangeError):
        model.check_target(pose)


def test_a_slide_without_limits_reaches_everything():
    rail = """<robot name="rail"><link name="base"/><link name="tool"/>
    <joint name="rail" type="prismatic"><parent link="base"/><child link="tool"/><axis xyz="1 0 0"/>
    <limit lower="-1e9" upper="1e9" effort="9" velocity="1"/></joint></robot>"""
    model = pliant.Model.from_urdf_str(rail)
    model.check_target([90.0, 0.0, 0.0])


def test_joint_targets_beyond_the_limits_by_a_margin_are_refused(arm):
    model, controller, q = arm
    for i in range(model.n):
        for limit, sign in ((model.upper, 1.0), (model.lower, -1.0)):
            if not np.isfinite(limit[i]):
                continue
            expected = q.copy()
            expected[i] = limit[i] + sign * 0.19
            model.check_joint_target(expected)
            command = controller.step_joints(q, expected)
            assert np.all(np.isfinite(command.goal))
            before = pickle.dumps(controller)
            for excess in (0.21, 2.75, 57.0):
                expected[i] = limit[i] + sign * excess
                for call in (
                    lambda expected=expected: controller.step_joints(q, expected),
                    lambda expected=expected: model.check_joint_target(expected),
                    lambda expected=expected: controller.check(expected),
                    lambda expected=expected: controller.check(np.array([q, expected])),
                ):
                    with pytest.raises(pliant.OutOfRangeError) as error:
                        call()
                    message = str(error.value)
                    assert model.joint_names[i] in message
                    assert "degrees?" in message
                    assert f"limits [{model.lower[i]:g}, {model.upper[i]:g}]" in message
                    assert error.value.value == expected[i]
            assert pickle.dumps(controller) == before


def test_small_degrees_are_refused():
    model = pliant.robots.so101()
    controller = pliant.Controller(model, pliant.Settings.firm(task="xyz"))
    q = np.zeros(5)
    for expected in ([5, 3, -2, 4, 1], [0, 4.5, 0, 0, 0], [90, 0, 45, 0, 0]):
        with pytest.raises(pliant.OutOfRangeError, match="is it in degrees"):
            controller.step_joints(q, expected)


def test_rows_that_are_too_far_become_nan_where_asked():
    """Tested with and without a state, and with few rows and many (one chunk and several)."""
    model = pliant.robots.arm7()
    rng = np.random.default_rng(0)
    bound = 2.0 * model.reach + 0.1
    for settings in (pliant.Settings.paper(), pliant.Settings.firm()):
        controller = pliant.Controller(model, settings)
        for count in (3, 300):
            rows = rng.uniform(-0.5, 0.5, (count, 7)) + np.array([0, 0, 0, -1, 0, 0, 0])
            poses = model.forward_kinematics_batch(rows)
            is_far = rng.random(count) < 0.3
            is_far[1] = True
            for i in np.flatnonzero(is_far):
                poses[i] = at(model, bound * rng.uniform(1.001, 50), rng.normal(size=3))
            for state in (None, controller.batch_state(count)):
                out = controller.step_batch(rows, poses, state=state, invalid="nan")
                assert np.array_equal(np.isnan(out.goal).any(axis=1), is_far)
                first = int(np.flatnonzero(is_far)[0])
                with pytest.raises(
                    pliant.OutOfRangeError, match=rf"targets\[{first}\].*millimetres"
                ):
                    controller.step_batch(rows, poses, state=state)


def test_the_shell_has_no_check_of_its_own():
    model = pliant.robots.so101()
    bound = 2.0 * model.reach + 0.1
    x, y, z = model.reach_origin
    Target.parse(f'{{"position": [{x}, {y}, {z + bound - 1e-6}]}}', model)
    for line in (
        f'{{"position": [{x}, {y}, {z + bound + 1e-6}]}}',
        f'{{"q": [0, {model.upper[1] + 0.21}, 0, 0, 0]}}',
    ):
        with pytest.raises(pliant.ConfigError, match=r"millimetres\?|degrees\?"):
            Target.parse(line, model)


def test_an_error_leaves_the_next_command_as_it_would_have_been(arm):
    model, controller, q = arm
    twin = copy.copy(controller)
    pose = model.forward_kinematics(q)
    pose[2, 3] += 0.02
    for _ in range(5):
        with pytest.raises(pliant.OutOfRangeError):
            controller.step(q, at(model, 100.0, DIRECTIONS[3]))
        with pytest.raises(pliant.OutOfRangeError):
            controller.step_joints(q, 57.3 * np.ones(model.n))
        a, b = controller.step(q, pose), twin.step(q, pose)
        assert np.array_equal(a.goal, b.goal)
        assert np.array_equal(a.torque_limit, b.torque_limit)
