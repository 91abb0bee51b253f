"""Presets and deviation limits: names, units, errors, other arms, goals without jumps."""

import numpy as np
import pytest

import pliant
import pliant.robots
from pliant import Axis, Controller, Settings

#: Names that the printed form of a preset uses.
ROOM = {
    kind.__name__: kind
    for kind in (
        Settings,
        Axis,
        pliant.Task,
        pliant.Tracking,
        pliant.NullSpace,
        pliant.TorqueLimits,
        pliant.functional.PaperOptions,
    )
}
Q = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])
PRESETS = {
    "paper": Settings.paper,
    "firm": Settings.firm,
    "door": Settings.door,
    "drawer": Settings.drawer,
    "wipe": Settings.wipe,
    "hand_over": Settings.hand_over,
    "plug": Settings.plug,
    "hand_guiding": Settings.hand_guiding,
}


@pytest.fixture(scope="module")
def arm():
    return pliant.robots.arm7()


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("robot", ["arm7", "so101", "koch"])
def test_every_preset_fits_every_arm(name, robot):
    model = getattr(pliant.robots, robot)()
    task = "all" if robot == "arm7" else "xyz"
    settings = PRESETS[name](task=task)
    command = Controller(model, settings).step(
        np.zeros(model.n), model.forward_kinematics(np.zeros(model.n))
    )
    assert np.isfinite(command.goal).all()
    assert eval(repr(settings), ROOM) == settings


def test_forces_are_the_arm_s_own_or_those_given(arm):
    default = Controller(arm, Settings.plug()).axes["z"]
    assert default.soft == (4.0, 4.0)
    assert default.firm == (15.0, 15.0)
    custom = Controller(arm, Settings.plug(push=10.0)).axes["z"]
    assert custom.soft == (10.0, 10.0)
    assert custom.profile == "constant"
    assert Controller(arm, Settings.wipe()).axes["z"].soft == (4.0, 4.0)
    assert Settings.wipe(press=5.0, axis="x").axes["x"].soft == (5.0, 5.0)
    assert Settings.drawer(axis="y", pull=7.0).axes["y"].soft == (7.0, 7.0)


def test_a_driven_axis_may_have_a_spring_of_its_own(arm):
    press = {"z": Axis(stiffness=400.0, yields="both", soft=5.0)}
    Controller(arm, Settings.wipe(law="impedance", axes=press))


def test_the_sign_of_a_plug_is_the_way_in():
    assert Settings.plug(axis="-z").axes["z"].yields == "+"
    assert Settings.plug(axis="z").axes["z"].yields == "-"
    assert Settings.plug(axis="+x").axes["x"].yields == "-"


def test_axes_that_a_preset_needs_must_belong_to_the_task():
    assert Settings.drawer(task="xyz").axes["yaw"] == Axis()
    with pytest.raises(pliant.ConfigError, match=r"axes\.z: 'z' is not an axis of the task"):
        Settings.wipe(task="xy yaw")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Settings.plug(law="impedance"),
            r"axes\.z\.stiffness: under law=\"impedance\" 'z' yields without a spring",
        ),
        (lambda: Settings.wipe(press=0.0), r"press \[N\] = 0 is outside"),
        (lambda: Settings.plug(push=-1.0), r"push \[N\] = -1 is outside"),
        (lambda: Settings.drawer(pull=float("inf")), r"pull \[N\] = inf is outside"),
        (lambda: Settings.drawer(axis="yaw"), "'yaw' is not a direction"),
        (lambda: Settings.plug(axis="--z"), "'-z' is not a direction"),
        (lambda: Axis(deviation_limit=0.0), r"deviation_limit = 0 is outside \(0, 5\]"),
        (
            lambda: Axis(deviation_limit=None, on_deviation_limit="stop"),
            "must be one of 'yield', 'wait'",
        ),
        (
            lambda: Axis(soft=4.0, deviation_limit=0.02),
            "has no effect on an axis that yields to both sides",
        ),
    ],
)
def test_invalid_arguments_are_refused_by_name(make, message):
    with pytest.raises(pliant.PliantError, match=message):
        make()


def pushed_away(arm, controller, metres, ticks=60):
    """Return goals while the tool is moved along y, away from its target, at a constant speed."""
    target, q, goals = arm.forward_kinematics(Q), Q, []
    for tick in range(ticks):
        moved_target = target.copy()
        moved_target[1, 3] += metres * (tick + 1) / ticks
        q = arm.inverse_kinematics(moved_target, q).q
        goals.append(controller.step(q, target).goal.copy())
    return np.array(goals), q, target


def test_a_target_that_follows_is_reported_and_does_not_bump(arm):
    controller = Controller(arm, Settings(axes={"y": Axis(deviation_limit=0.02)}))
    goals, _, target = pushed_away(arm, controller, 0.06)
    assert controller.diagnostics.deviation_limited.tolist() == [
        False,
        True,
        False,
        False,
        False,
        False,
    ]
    assert controller.diagnostics.deviation[1] == pytest.approx(-0.02, abs=1e-9)
    assert controller.diagnostics.reference[1, 3] - target[1, 3] == pytest.approx(0.04, abs=1e-4)
    # Beyond the limit the goals move as fast as the arm: 1 mm, so 2.4 mrad of a joint, per tick.
    assert np.abs(np.diff(goals[10:], axis=0)).max() < 3e-3  # [rad], measured 2.6e-3


def test_a_target_at_rest_that_waits_does_what_it_did_without_a_limit(arm):
    waiting, free = (
        Controller(
            arm, Settings(axes={"y": Axis(deviation_limit=0.02, on_deviation_limit="wait")})
        ),
        Controller(arm),
    )
    goals, _, target = pushed_away(arm, waiting, 0.06)
    np.testing.assert_array_equal(goals, pushed_away(arm, free, 0.06)[0])
    assert waiting.diagnostics.deviation_limited.tolist() == [
        False,
        True,
        False,
        False,
        False,
        False,
    ]
    assert not free.diagnostics.deviation_limited.any()
    np.testing.assert_allclose(waiting.diagnostics.reference, target, atol=1e-9)


def test_a_limit_that_comes_while_the_arm_is_beyond_it_comes_within_the_slew(arm):
    controller = Controller(arm)
    goals, q, target = pushed_away(arm, controller, 0.06)
    controller.update(Settings(axes={"y": Axis(deviation_limit=0.01)}))
    after = controller.step(q, target)
    assert controller.diagnostics.deviation[1] == pytest.approx(-0.01, abs=1e-9)
    slew = controller.settings.tracking.goal_slew / controller.settings.rate
    assert np.abs(after.goal - goals[-1]).max() <= slew + 1e-12


def test_a_followed_target_is_led_back_at_the_tool_s_speed(arm):
    settings = Settings(axes={"y": Axis(deviation_limit=0.02)}, max_tool_speed=(0.1, 1.0))
    controller = Controller(arm, settings)
    _, _, target = pushed_away(arm, controller, 0.06)
    positions = []
    for _ in range(200):
        controller.step(Q, target)
        positions.append(controller.diagnostics.reference[1, 3])
    speed = np.abs(np.diff(positions)).max() * controller.settings.rate
    assert speed <= 0.1 + 1e-9
    assert positions[-1] == pytest.approx(target[1, 3], abs=1e-12)
    assert not controller.diagnostics.deviation_limited.any()


def test_a_side_that_yields_has_no_limit(arm):
    settings = Settings(axes={"y": Axis(soft=4.0, yields="+", deviation_limit=0.02)})
    for metres, has_limit in ((0.06, False), (-0.06, True)):
        controller = Controller(arm, settings)
        pushed_away(arm, controller, metres)
        assert bool(controller.diagnostics.deviation_limited[1]) is has_limit
