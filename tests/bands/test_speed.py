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
