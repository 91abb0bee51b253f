"""Motion into a wall with the default law and a cap of 15 N along the direction of contact."""

import pytest

from experiments import controllers, disturbances


@pytest.mark.parametrize("speed", disturbances.SPEEDS)
@pytest.mark.parametrize("stiffness", disturbances.STIFFNESSES)
@pytest.mark.parametrize("direction", disturbances.DIRECTIONS)
def test_cap_bounds_the_bump(direction, stiffness, speed):
    result = disturbances.bump(controllers.cap, direction, speed=speed, stiffness=stiffness)
    assert result.mass == pytest.approx({"+x": 1.72, "+y": 0.54, "-z": 0.48}[direction], rel=0.01)
    assert result.peak <= result.allowed  # [N]; the measured peak is 2.8 N less
    assert result.later < 23.0  # [N], measured 18.9
    assert 11.5 <= result.final <= 18.0  # [N], measured 13.7-15.2
