"""Joints at position limits of the simulated arm: excursion, gravity, and rest after a push."""

import numpy as np
import pytest
from mismatch import RANDOM, Mismatch, Parameters

import pliant
from experiments import joint_limit_rest
from experiments.controllers import NO_RATE_LIMITS
from pliant import robots
from pliant.sim import Plant
from pliant.sim.postures import VERTICAL

#: By arm: initial position [rad], caps [N], largest accepted excursion of the first joint [rad].
ARMS = {
    "arm7": (VERTICAL, (4.0, 20.0), 0.02),
    "so101": (np.array([0.2, -0.3, 0.3, 0.9, 0.0]), (0.5, 2.0), 0.08),
}


def limited_model(name, q, room):
    """Return the arm with its first joint limited to q ± `room`; the plant has wider limits."""
    bounds = {robots.load(name).joint_names[0]: (q[0] - room, q[0] + room)}
    return robots.load(name, limits=bounds)


def excursions(name, cap, ticks, law="cap"):
    """Return the excursion of the first joint beyond its limit [rad]: largest, final, ringing.

    The target is out of reach along the soft axis y.
    """
    q, room = ARMS[name][0], 0.05
    model, delay = limited_model(name, q, room), 2 * ticks / 100.0
    gap = Mismatch(plant=Parameters(delay=delay), assumed=Parameters(delay=delay, reach=RANDOM))
    plant = gap.build(robots.load(name), delay=(ticks, ticks))
    spring = {"stiffness": 500.0} if law == "impedance" else {}
    settings = pliant.Settings(
        task="xyz" if model.n == 5 else "xyz rpy",
        axes={"y": pliant.Axis(soft=cap, firm=cap, **spring)},
        law=law,
        delay=delay,
        **NO_RATE_LIMITS,
    )
    controller = pliant.Controller(model, settings)
    gap.check(controller)
    target = model.forward_kinematics(q)
    target[1, 3] += 0.3 * np.sign(model.jacobian(q)[1, 0])
    plant.reset(q)
    out = []
    for _ in range(300):
        command = controller.step(plant.read().q, target[:3, 3] if model.n == 5 else target)
        plant.write(command.goal, command.torque_limit)
        plant.advance()
        out.append(abs(plant.q[0] - q[0]) - room)
    assert max(out) > -0.01, "the joint got to its limit"
    return max(out), out[-1], np.ptp(out[-50:])


@pytest.mark.parametrize("ticks", [0, 1])
@pytest.mark.parametrize("name", ARMS)
def test_a_soft_axis_does_not_drive_a_joint_out_of_its_limits(name, ticks):
    for cap in ARMS[name][1]:
        largest, _, oscillation = excursions(name, cap, ticks)
        assert largest < ARMS[name][2]  # measured 0.017
        assert oscillation < 1e-3


def test_a_soft_axis_of_law_impedance_does_not_either():
    largest, _, _ = excursions("arm7", 20.0, 0, law="impedance")
    assert largest < 0.02


def test_gravity_is_carried_at_a_limit():
    """A joint at its limit stays there, also if its weight pulls it away."""
    name, q = "arm7", ARMS["arm7"][0]
    model = robots.load(name)
    weight = model.gravity(q)
    joint = int(np.argmax(np.abs(weight)))
    for side in (-1.0, 1.0):
        edge = (q[joint], q[joint] + 0.5) if side < 0.0 else (q[joint] - 0.5, q[joint])
        bounded = robots.load(name, limits={model.joint_names[joint]: edge})
        controller = pliant.Controller(bounded, pliant.Settings(axes={"y": pliant.Axis()}))
        plant = Plant(model)
        plant.reset(q)
        for _ in range(100):
            command = controller.step(plant.read().q, model.forward_kinematics(q))
            plant.write(command.goal, command.torque_limit)
            plant.advance()
        assert np.abs(plant.q - q).max() < 1e-3
    assert abs(weight[joint]) > 1.0


@pytest.mark.parametrize("ticks", [0, 1])
@pytest.mark.parametrize(("name", "pose"), [("arm7", 0), ("arm7", 2), ("so101", 3), ("koch", 2)])
def test_an_arm_beside_its_stops_comes_to_rest_after_a_push(name, pose, ticks):
    """The arm neither oscillates nor drifts after the release."""
    result = joint_limit_rest.Job(name, pose, ticks).run()
    assert result.moves[1] < 4e-3  # [rad], motion within a second, 8 s after release
    assert result.turns[1] == 0
