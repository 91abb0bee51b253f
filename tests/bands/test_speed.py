"""Tool speed with a bounded target speed, also while the tool catches up after friction."""

import numpy as np
import pytest

import pliant
from pliant import robots, sim

START = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657]  # [rad]
PATH_LENGTH = 0.15  # [m]
#: Largest excess of the tool's speed while it catches up [m/s]; measured 0.08.
MAX_EXCESS = 0.1


def tool_speeds(speed, axis):
    """Return speeds [m/s] of reference and tool per tick, on a straight path along a base axis."""
    model = robots.arm7()
    controller = pliant.Controller(model, pliant.Settings(max_tool_speed=speed))
    arm = sim.Plant(model, rate=100.0)
    arm.reset(START)
    target, positions = arm.tool, []
    for tick in range(100 + round((PATH_LENGTH / speed + 0.5) * arm.rate)):
        if tick == 100:
            target[axis, 3] += PATH_LENGTH
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
        positions.append((controller.diagnostics.reference[:3, 3], arm.tool[:3, 3]))
    assert abs(arm.tool[axis, 3] - target[axis, 3]) < 0.002  # [m]
    return np.linalg.norm(np.diff(np.array(positions[99:]), axis=0), axis=2).T * arm.rate


@pytest.mark.parametrize("axis", range(3), ids="xyz")
@pytest.mark.parametrize("speed", [0.05, 0.1, 0.25])
def test_the_tool_is_a_little_faster_than_its_target_where_it_catches_up(speed, axis):
    reference, tool = tool_speeds(speed, axis)
    assert reference.max() <= speed * (1.0 + 1e-6)
    assert tool.max() < speed + MAX_EXCESS
    underway = tool[50 : round(PATH_LENGTH / speed * 100.0)]
    assert abs(underway.mean() / speed - 1.0) < 0.1


#: Speed limit [m/s], and speed at which no axis exerts force in the direction of motion anymore.
LIMIT = 0.25
FORCELESS = LIMIT + 2.0 * 0.08
#: Largest excess over `FORCELESS` while the arm brakes [m/s]; measured 0.08.
BRAKING = 0.1
#: Almost stretched, and two bent poses: the tool rises by 0.3 and 0.6 m [rad].
STRETCHED = [0.0, 0.0, 0.0, -0.04, 0.0, 0.0, 0.0]
BENT = ([0.3, -0.5, 0.2, -1.5, 0.2, 0.3, 0.1], [0.8, -1.0, 0.4, -1.9, 0.0, 0.5, 0.0])


def leave_stretched_pose(settings, target, duration):
    """Return the largest speed of the tool [m/s] and its distance [m] to the target in the end."""
    model = robots.arm7()
    controller = pliant.Controller(model, settings)
    arm = sim.Plant(model, rate=100.0)
    arm.reset(STRETCHED)
    positions = []
    for _ in range(round(duration * arm.rate)):
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
        positions.append(arm.tool[:3, 3])
    speeds = np.linalg.norm(np.diff(np.array(positions), axis=0), axis=1) * arm.rate
    return speeds.max(), np.linalg.norm(positions[-1] - target[:3, 3])


@pytest.mark.parametrize("law", ["cap", "impedance"])
@pytest.mark.parametrize("soft", ["x", "x y"])
@pytest.mark.parametrize("pose", range(len(BENT)))
def test_soft_axes_do_not_let_the_tool_fly_as_the_arm_leaves_a_singular_pose(pose, soft, law):
    """The elbow bends much for the first millimetres of z: 0.9 to 1.1 m/s without a reduction."""
    target = robots.arm7().forward_kinematics(BENT[pose])
    settings = pliant.Settings.soft(soft, task="xyz", max_tool_speed=LIMIT).replace(law=law)
    assert leave_stretched_pose(settings, target, 4.0)[0] < FORCELESS + BRAKING
