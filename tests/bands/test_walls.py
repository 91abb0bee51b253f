"""Running into a wall with the default law: cap 15 N on the axis that meets it."""

import pytest

from pliant.experiments import laws, walls

ALWAYS = {("+x", 2e4, 0.25), ("+y", 2e4, 0.10), ("-z", 2e3, 0.25)}
CASES = [
    pytest.param(way, k, v, marks=() if (way, k, v) in ALWAYS else pytest.mark.full)
    for way in walls.DIRECTIONS
    for k in walls.STIFFNESSES
    for v in walls.SPEEDS
]


@pytest.mark.parametrize(("direction", "stiffness", "speed"), CASES)
def test_cap_bounds_the_bump(direction, stiffness, speed):
    seen = walls.bump(laws.cap, direction, speed=speed, stiffness=stiffness)
    assert seen.mass == pytest.approx({"+x": 1.72, "+y": 0.54, "-z": 0.48}[direction], rel=0.01)
    assert seen.peak <= seen.allowed  # [N] (2.8 less)
    assert seen.later < 23.0  # [N] (18.9)
    assert 11.5 <= seen.final <= 18.0  # [N] (13.7-15.2)
