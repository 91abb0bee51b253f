"""`Controller` from Python: inputs, state, and diagnostics after a step."""

from __future__ import annotations

import numpy as np
import pytest

import pliant

INTERMEDIATES = {
    "deviation": "k",
    "adapted_deviation": "k",
    "task_velocity": "k",
    "softness": "k",
    "compliance": "k",
    "axis_strength": "k",
    "wrench": "k",
    "q_predicted": "n",
    "velocity": "n",
    "gravity": "n",
    "feed_forward": "n",
    "gradient": "n",
    "saturated": "n",
    "locked": "n",
    "activation": "nm",
    "responsibility": "nm",
    "task_jacobian": "kn",
    "singular_values": "k",
}


@pytest.mark.parametrize("task", ["xyz rpy", "xyz", "y", "x z pitch"])
def test_intermediates_have_the_size_of_the_task(model, q, target, task):
    controller = pliant.Controller(
        model, pliant.Settings(task=task, delay=0.01, tracking=pliant.Tracking(gain=2.0))
    )
    controller.step(q, target)
    k = len(pliant.Task(task))
    sizes = {"k": k, "n": 7, "m": k + 1}
    for name, axes in INTERMEDIATES.items():
        assert getattr(controller.diagnostics, name).shape == tuple(sizes[a] for a in axes), name
    for name in ("sigma_min", "sigma_max", "damping", "gamma", "gain_factor"):
        assert isinstance(getattr(controller.diagnostics, name), float)
    assert controller.diagnostics.saturated.dtype == bool
    assert len(controller.diagnostics.factors) == len(controller.diagnostics.damping_constants) == 3
    assert tuple(controller.axes) == pliant.Task(task).names


def test_rows_are_those_of_the_task_in_order(model, q, target):
    controller = pliant.Controller(model, pliant.Settings(task="x z pitch"))
    controller.step(q, target, dt=1.0)
    rows = [0, 2, 4]
    np.testing.assert_allclose(
        controller.diagnostics.task_jacobian, model.jacobian(q)[rows], atol=1e-15
    )
    full_task = pliant.Controller(model, pliant.Settings())
    full_task.step(q, target, dt=1.0)
    np.testing.assert_allclose(
        controller.diagnostics.deviation, full_task.diagnostics.deviation[rows], atol=1e-15
    )
    np.testing.assert_allclose(controller.diagnostics.gravity, model.gravity(q), atol=1e-14)


def test_what_is_read_cannot_be_used_to_write(controller, q, target):
    controller.step(q, target)
    controller.diagnostics.deviation[:] = 7.0
    assert (controller.diagnostics.deviation != 7.0).all()
    with pytest.raises(AttributeError):
        controller.deviation = np.zeros(6)


def test_parts_can_be_read(model, controller, servos):
    assert controller.model is model
    assert controller.servos == model.servos == servos
    assert controller.settings == pliant.Settings.soft("y")
    assert controller.axes["y"].yields == "both"
    assert controller.axes["x"].yields == "none"
    assert controller.axes["x"].hold == 40.0
    assert "arm7" in repr(controller)
    plain_controller = pliant.Controller(model)
    assert plain_controller.settings == pliant.Settings()
    other = pliant.Controller(model, None, pliant.Servos(kp=99.0, max_torque=5.0))
    assert other.servos.kp.tolist() == [99.0] * 7


class _Method:
    def __init__(self, matrix):
        self._matrix = matrix

    def as_matrix(self):
        return self._matrix


class _Attribute:
    def __init__(self, name, matrix):
        setattr(self, name, matrix)


def _forms(target):
    yield target.tolist()
    yield np.asfortranarray(target)
    yield pliant.Pose(target)
    yield _Method(target)
    for name in ("homogeneous", "matrix", "A", "as_matrix"):
        yield _Attribute(name, target)
    pin = pytest.importorskip("pinocchio", reason="PyPI `pin` is not installed")
    yield pin.SE3(target)


def test_targets_of_every_kind_give_the_same_bits(model, q, target):
    expected = pliant.Controller(model).step(q, target).goal
    for form in _forms(target):
        result = pliant.Controller(model).step(q, form).goal
        assert result.tobytes() == expected.tobytes(), type(form)


def test_a_position_is_enough_without_rotations(model, q, target):
    settings = pliant.Settings(task="xyz")
    expected = pliant.Controller(model, settings).step(q, target)
    result = pliant.Controller(model, settings).step(q, target[:3, 3])
    assert result.goal.tobytes() == expected.goal.tobytes()
    with pytest.raises(
        pliant.ShapeError, match="a position alone says nothing of the task's rotations"
    ):
        pliant.Controller(model).step(q, target[:3, 3])


def test_seven_numbers_are_not_accepted_as_a_pose(controller, q):
    with pytest.raises(pliant.ShapeError, match=r"Pose.from_wxyz.* or pliant.Pose.from_xyzw"):
        controller.step(q, [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0])


def test_invalid_poses_are_refused(controller, q, target):
    for damage in (
        lambda t: t[3].fill(0.0),
        lambda t: t[0].__imul__(2.0),
        lambda t: t[0].__imul__(-1.0),
    ):
        invalid = target.copy()
        damage(invalid)
        with pytest.raises(pliant.ConfigError, match="target: "):
            controller.step(q, invalid)
    for invalid in (_Method(np.eye(3)), _Attribute("matrix", None)):
        with pytest.raises((pliant.ShapeError, TypeError), match=r"target\.(as_)?matrix"):
            controller.step(q, invalid)


BAD_STEPS = {
    "a wrong shape": {"q": np.zeros(6)},
    "a number that is none": {"q": np.full(7, np.nan)},
    "text": {"target": "home"},
    "no pose": {"target": np.ones((4, 4))},
    "a negative dt": {"dt": -0.01},
    "dt zero": {"dt": 0.0},
    "dt a text": {"dt": "now"},
    "a speed beyond belief": {"dq": np.full(7, 1e9)},
    "a short twist": {"twist": np.zeros(5)},
    "an infinite gradient": {"gradient": np.full(7, np.inf)},
    "a strange out": {"out": np.zeros(7)},
    "an unknown keyword": {"gradeint": np.zeros(7)},
}


@pytest.mark.parametrize("is_started", [False, True], ids=["fresh", "running"])
@pytest.mark.parametrize("invalid_q", BAD_STEPS)
def test_an_error_does_not_affect_the_next_step(model, q, target, invalid_q, is_started):
    settings = pliant.Settings.soft("y", tracking=pliant.Tracking(integrate=0.5))
    reference, disturbed = pliant.Controller(model, settings), pliant.Controller(model, settings)
    if is_started:
        for controller in (reference, disturbed):
            for i in range(5):
                controller.step(q + 0.003 * i, target)
    before = disturbed.diagnostics.deviation
    with pytest.raises((pliant.PliantError, TypeError)):
        disturbed.step(**{"q": q, "target": target} | BAD_STEPS[invalid_q])
    assert disturbed.diagnostics.deviation.tobytes() == before.tobytes()
    for i in range(5):
        a, b = reference.step(q + 0.01 * i, target), disturbed.step(q + 0.01 * i, target)
        for field in ("goal", "torque_limit", "speed_limit"):
            assert getattr(a, field).tobytes() == getattr(b, field).tobytes()


def test_a_failed_update_changes_nothing(model, q, target):
    reference, updated = pliant.Controller(model), pliant.Controller(model)
    for i in range(3):
        reference.step(q + 0.001 * i, target)
        updated.step(q + 0.001 * i, target)
    settings = updated.settings
    with pytest.raises(pliant.OutOfRangeError, match=r"tracking\.gain"):
        updated.update(pliant.Settings(tracking=pliant.Tracking(gain=50.0)))
    with pytest.raises(pliant.ShapeError, match=r"null_space\.posture"):
        updated.update(pliant.Settings(null_space=pliant.NullSpace(posture=[0.0] * 6)))
    with pytest.raises(TypeError):
        updated.update("softer")
    for call in (
        lambda: updated.set_payload(-1.0),
        lambda: updated.set_gravity([0.0, 0.0, np.nan]),
        lambda: updated.set_delay(2.0),
        lambda: updated.reset([0.0] * 6),
    ):
        with pytest.raises(pliant.PliantError):
            call()
    assert updated.settings is settings
    assert updated.step(q, target).goal.tobytes() == reference.step(q, target).goal.tobytes()


def test_same_inputs_same_bits(model, target):
    generator = np.random.default_rng(3)
    inputs = generator.normal(0.0, 0.02, (200, 7)) + np.array(
        [0.3, -0.4, 0.2, -1.2, 0.5, 0.6, -0.3]
    )

    def run():
        controller = pliant.Controller(
            model,
            pliant.Settings.soft("y yaw", tracking=pliant.Tracking(integrate=0.2), delay=0.01),
        )
        return b"".join(
            command.goal.tobytes() + command.torque_limit.tobytes()
            for command in (controller.step(q, target) for q in inputs)
        )

    assert run() == run()


def test_reset_forgets_everything(model, q, target):
    new, old = pliant.Controller(model), pliant.Controller(model)
    for i in range(20):
        old.step(q + 0.01 * i, target)
    old.reset(q)
    new.reset(q)
    assert old.step(q, target).goal.tobytes() == new.step(q, target).goal.tobytes()


def test_step_joints_is_a_step_to_their_pose_with_them_as_posture(model, q):
    expected = q + 0.02
    a = pliant.Controller(model).step_joints(q, expected)
    settings = pliant.Settings(null_space=pliant.NullSpace(posture=expected))
    b = pliant.Controller(model, settings).step(q, model.forward_kinematics(expected))
    np.testing.assert_allclose(a.goal, b.goal, atol=1e-14)
    np.testing.assert_allclose(a.torque_limit, b.torque_limit, atol=1e-12)


def test_payload_gravity_and_delay_while_running(model, controller, q, target):
    controller.step(q, target)
    before = controller.diagnostics.gravity
    controller.set_payload(0.5, (0.0, 0.0, 0.1))
    controller.step(q, target)
    np.testing.assert_allclose(
        controller.diagnostics.gravity, before, atol=1e-12
    )  # the new gravity takes effect gradually, within 0.5 s
    for _ in range(50):
        controller.step(q, target)
    loaded_model = pliant.robots.arm7(payload=pliant.Payload(0.5, (0.0, 0.0, 0.1)))
    np.testing.assert_allclose(controller.diagnostics.gravity, loaded_model.gravity(q), atol=1e-12)
    controller.set_payload(0.0)
    controller.set_gravity([0.0, 0.0, 0.0])
    controller.step(q, target)
    assert not controller.diagnostics.gravity.any()
    controller.set_delay(0.3)
    assert controller.diagnostics.gain_factor == 1.0
    stiff = pliant.Controller(model, pliant.Settings(tracking=pliant.Tracking(gain=6.0)))
    stiff.set_delay(0.02)
    assert stiff.diagnostics.gain_factor < 1.0
    stiffness = controller.capture_gravity(q, q)
    np.testing.assert_allclose(stiffness, model.servos.kp)


def test_update_takes_over_position_targets(model, q, target):
    controller = pliant.Controller(model, pliant.Settings())
    controller.step(q, target)
    controller.update(pliant.Settings(task="xyz"))
    assert controller.settings.task == pliant.Task("xyz")
    assert controller.diagnostics.deviation.shape == (3,)
    controller.step(q, target[:3, 3])


def test_update_computes_the_capacities_of_a_new_controller(model, q, target):
    """Capacities of poses are cached by axes and frame of the task, so a new task has its own."""
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    tasks = (
        pliant.Task("all"),
        pliant.Task("xyz"),
        pliant.Task("x z pitch"),
        pliant.Task("x z pitch", frame=rotation),
        pliant.Task("x z pitch"),
        pliant.Task("all"),
    )
    running = pliant.Controller(model)
    for task in tasks:
        settings = pliant.Settings(task=task)
        running.update(settings)
        new = pliant.Controller(model, settings)
        assert running.axes == new.axes
        running.reset(q)
        assert running.step(q, target).goal.tobytes() == new.step(q, target).goal.tobytes()
        assert running.report().sigma_0 == new.report().sigma_0


def test_errors_name_the_parameters_that_a_law_needs(q):
    from pathlib import Path

    urdf = Path(__file__).resolve().parents[1] / "data" / "golden" / "arm7.urdf"
    bare_model = pliant.Model.from_urdf(urdf, tip="tool")
    with pytest.raises(
        pliant.ConfigError, match=r'law="cap" needs the stiffness k_p of joints shoulder_pitch'
    ):
        pliant.Controller(bare_model)
    assert pliant.Controller(bare_model, pliant.Settings.paper()).servos is None
    with pytest.raises(pliant.ShapeError, match=r"servos.kp has shape \(6,\), expected \(7,\)"):
        pliant.Controller(bare_model, None, pliant.Servos(kp=[1.0] * 6, max_torque=1.0))
    with pytest.raises(TypeError):
        pliant.Controller(bare_model, {"law": "cap"})


def test_springs_of_law_impedance(q):
    model = pliant.robots.arm7()
    target = model.forward_kinematics(q)
    settings = pliant.Settings(law="impedance", axes={"y": pliant.Axis(yields="both")})
    controller = pliant.Controller(model, settings)
    strengths = controller.axes
    assert strengths["x"].stiffness == (800.0, 800.0)
    assert strengths["y"].stiffness == (0.0, 0.0)
    assert strengths["yaw"].stiffness == (20.0, 20.0)
    assert strengths["x"].damping == (0.0, 0.0)
    displaced = target.copy()
    displaced[:2, 3] += 0.01
    for _ in range(100):  # the tool speed limit applies to the target too
        controller.step(q, displaced)
    assert controller.diagnostics.gain_factor == 1.0
    np.testing.assert_allclose(
        controller.diagnostics.wrench, [8.0, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-6
    )
    controller.set_delay(0.1)  # with this delay, springs are limited to the stiffness of the servos
    controller.step(q, displaced)
    assert 0.2 < controller.diagnostics.gain_factor < 0.6
    wrench = controller.diagnostics.wrench
    assert wrench[0] == pytest.approx(8.0 * controller.diagnostics.gain_factor, rel=1e-6)


def test_too_stiff_springs_are_refused_with_the_nearest_that_work():
    model = pliant.robots.arm7()
    stiff = {"xyz": pliant.Axis(stiffness=2000.0)}
    settings = pliant.Settings(law="impedance", axes=stiff, delay=0.02)
    with pytest.raises(pliant.ConfigError, match=r"use x=\d+ N/m, y=\d+ N/m, z=\d+ N/m"):
        pliant.Controller(model, settings)
    pliant.Controller(model, settings.replace(accept_high_stiffness=True))


@pytest.mark.parametrize("law", ["cap", "paper", "impedance"])
@pytest.mark.parametrize("size", [5e-324, 1e-310, 1e-300])
def test_denormal_positions_are_positions_too(model, law, size):
    settings = pliant.Settings.paper() if law == "paper" else pliant.Settings(law=law)
    controller = pliant.Controller(model, settings)
    target = model.forward_kinematics(np.zeros(7))
    for tick in range(20):
        command = controller.step(size * np.arange(7) * (tick % 3), target)
        assert np.isfinite(command.goal).all()
        assert np.isfinite(command.torque_limit).all()
