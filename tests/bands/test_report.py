"""The report compared with simulation: force at which the arm yields, force after a host loss."""

import numpy as np
import pytest

import pliant
from experiments import cap_accuracy, controllers, disturbances
from experiments.poses import AXES, arm, tool
from experiments.simulation import NOMINAL, run
from pliant.sim.hand import ForceProfile, Push
from pliant.sim.postures import AT_DOOR, HORIZONTAL, VERTICAL

RANDOM = cap_accuracy.poses(4, cap_accuracy.CLEAR)
#: Axis, pushed direction, and force cap [N] or torque cap [N·m].
PUSHES = (("y", 1.0, 8.0), ("y", -1.0, 5.0), ("z", 1.0, 8.0), ("x", -1.0, 8.0), ("yaw", 1.0, 1.0))
#: Allowed excess of a force over cap and friction, as a share of the cap: the push still grows
#: while the arm starts to move.
TOLERANCE = 0.15  # measured 0.10
#: By direction of the push after a host loss: allowed deviation from the reported peak force, as a
#: share of that force.
HOST_LOSS_TOLERANCE = {"+y": 0.1, "-y": 0.1, "-x": 0.1, "-z": 0.1, "+x": 0.25, "+z": 0.4}


def yield_forces(q, axis, sign, cap):
    """Return the force at which a growing push moves the axis, and the reported force [N, N·m]."""
    index = AXES.index(axis)
    settings = pliant.Settings(
        axes={axis: pliant.Axis(soft=cap, firm=cap)}, **controllers.NO_RATE_LIMITS
    )
    controller = NOMINAL.controller(settings)
    assert isinstance(controller, pliant.Controller)
    report = controller.report(q).axes[axis]
    vector = np.zeros(3)
    vector[index % 3] = 2.0 * cap * sign
    course = ForceProfile(start=0.2, rise=5.0, end=np.inf)
    hand = (
        Push(force_vector=vector, course=course)
        if index < 3
        else Push(torque_vector=vector, course=course)
    )
    trace = run(NOMINAL.build(hand), controller, tool(q), 5.0, q=q)
    bound = 1.25 * cap * cap_accuracy._compliance(q, index) + (0.005, 0.03)[index // 3]
    is_away = sign * trace.moved[:, index] > bound
    assert is_away.any(), "it never gave way"
    measured = (trace.force if index < 3 else trace.moment)[int(np.argmax(is_away)), index % 3]
    reported = report.yield_force[int(sign > 0.0)][1]
    return sign * float(measured), reported, report.friction


@pytest.mark.parametrize("pose", range(5))
def test_a_growing_push_moves_the_arm_where_the_report_says(pose):
    q = (VERTICAL, HORIZONTAL, AT_DOOR, *RANDOM[1:3])[pose]
    for axis, sign, cap in PUSHES:
        measured, reported, friction = yield_forces(q, axis, sign, cap)
        assert reported - 0.02 * cap <= measured <= reported + friction + TOLERANCE * cap, (
            axis,
            sign,
        )


@pytest.mark.parametrize("push", HOST_LOSS_TOLERANCE)
def test_the_report_foretells_what_a_dead_host_leaves(push):
    settings = controllers.cap(eta=0.0)
    report = pliant.Controller(arm(), settings).report(VERTICAL)
    reported = report.axes[push[1:]].host_loss_force[int(push[0] == "+")]
    measured = disturbances.lose_host(settings, push).force
    assert abs(reported / measured - 1.0) < HOST_LOSS_TOLERANCE[push]
