"""Force against deviation: profiles of soft axes, and deviation limits of stiff axes."""

from contextlib import nullcontext

import numpy as np
import pytest
from mismatch import under

from experiments import compliance, disturbances
from experiments.simulation import NOMINAL, Conditions
from pliant import Axis, Settings

SOFT, FIRM = 4.0, 15.0  # [N]
#: Joint friction that the feed-forward does not compensate, as a force along y, plus a margin [N].
FRICTION = 1.8
DEVIATIONS = (0.005, 0.02, 0.04, 0.055, 0.07, 0.09, 0.11, 0.13)  # [m]
NEARLY = [NOMINAL, *(Conditions(delay=(1, 1), assumed_ratio=share) for share in (0.7, 1.3))]


def expected_force(profile, deviation):
    """Return the expected force [N] at a deviation [m]: the cap, or the force of the servos."""
    c = float(np.clip(1.0 - (deviation - 0.01) / 0.09, 0.0, 1.0))
    strength = {
        "hardening": c * SOFT + (1.0 - c) * FIRM,
        "constant": SOFT,
        "softening": c * FIRM + (1.0 - c) * SOFT,
    }[profile]
    return min(strength, compliance.stiffness("y") * deviation)


def test_profiles_are_felt_as_promised_and_differ_where_they_should():
    """At 0.02 m the profile `softening` has the largest force, at 0.13 m `hardening`."""
    forces = {}
    for profile in ("hardening", "constant", "softening"):
        result = compliance.answer(
            Settings(axes={"y": Axis(soft=SOFT, firm=FIRM, profile=profile)})
        )
        forces[profile] = {
            deviation: float(result.force[np.abs(result.deviation - deviation) < 0.003].mean())
            for deviation in DEVIATIONS
        }
        for deviation, force in forces[profile].items():
            assert force == pytest.approx(expected_force(profile, deviation), abs=FRICTION), (
                profile,
                deviation,
            )
    near, far = (
        {name: by_deviation[deviation] for name, by_deviation in forces.items()}
        for deviation in (0.02, 0.13)
    )
    assert near["softening"] > near["hardening"] + 4.0 > near["constant"] + 4.0
    assert far["hardening"] > far["softening"] + 8.0
    assert far["softening"] == pytest.approx(far["constant"], abs=0.5)


@pytest.mark.parametrize(
    "conditions", NEARLY[:1] + [pytest.param(c, marks=pytest.mark.full) for c in NEARLY[1:]]
)
def test_a_stiff_axis_follows_a_strong_hand_beyond_its_limit(conditions):
    limit = 0.02  # [m]
    with nullcontext() if conditions is NOMINAL else under(conditions):
        free = disturbances.drag(Settings.firm(), conditions=conditions)
        result = disturbances.drag(
            Settings(axes={"y": Axis(deviation_limit=limit)}), conditions=conditions
        )
    expected = limit * compliance.stiffness("y")  # [N], measured 11.0
    assert result.moved > 0.14  # [m], of 0.15
    assert result.held == pytest.approx(expected, abs=2.5)  # [N], measured 10.8
    assert result.force < 0.5 * free.force  # [N], measured 12.5 and 36.2
    assert result.drift < 0.25 * free.drift  # measured 6 and 42 mm
    assert result.end < 0.002  # [m], distance from the target at the end
    assert result.fastest < 0.7 * free.fastest  # measured 0.95 and 1.87 rad/s


@pytest.mark.parametrize("reaction", ["yield", "wait"])
def test_a_blocked_axis_does_not_push_with_all_it_has(reaction):
    limit = 0.01  # [m]
    free = compliance.block(Settings.firm())
    result = compliance.block(
        Settings(axes={"x": Axis(deviation_limit=limit, on_deviation_limit=reaction)})
    )
    expected = limit * compliance.stiffness("x")  # [N], measured 13.9
    assert result.force == pytest.approx(expected, abs=3.5)  # [N], measured 11.6, 12.7
    assert result.force < 0.75 * free.force  # measured 18.1
    assert result.limited == pytest.approx(1.0)
    assert free.limited == pytest.approx(0.0)
    assert result.left < 0.002  # [m], distance from the target after the wall is gone
    assert result.fastest < 0.5 * free.fastest  # measured 0.27, 0.33 and, `free`, 0.77 m/s


def test_a_target_that_waits_waits_on_all_axes_and_one_that_follows_does_not():
    follow, hold = (
        compliance.block(
            Settings(axes={"x": Axis(deviation_limit=0.01, on_deviation_limit=reaction)})
        )
        for reaction in ("yield", "wait")
    )
    assert follow.aside == pytest.approx(compliance.ASIDE, abs=0.01)  # measured 0.106
    assert hold.aside < 0.6 * compliance.ASIDE  # measured 0.046


@pytest.mark.parametrize("reaction", ["yield", "wait"])
@pytest.mark.parametrize(
    "speed", [(0.25, 1.0), (float("inf"), float("inf"))], ids=["speed", "none"]
)
def test_a_limit_does_not_keep_a_free_arm_from_its_target(reaction, speed):
    for limit in (0.002, 0.005):
        axes = {"x": Axis(deviation_limit=limit, on_deviation_limit=reaction)}
        result = compliance.jump(Settings(axes=axes, max_tool_speed=speed))
        assert result.after < 2.5  # [s], measured 0.6-1.7
        assert result.left < 1e-3  # [m]
        assert result.speed < 1e-3  # [rad/s]


@pytest.mark.parametrize("reaction", ["yield", "wait"])
def test_at_the_tool_s_speed_a_limit_of_5_mm_costs_nothing(reaction):
    free = compliance.jump(Settings())
    result = compliance.jump(
        Settings(axes={"x": Axis(deviation_limit=0.005, on_deviation_limit=reaction)})
    )
    assert result.after == pytest.approx(free.after, abs=0.05)  # [s], measured 0.82
