"""`--soft`: yielding axes, their caps, and the other axes."""

import pytest

import pliant
from pliant.config._soft import apply_soft

MODEL = pliant.robots.so101()
TASK = pliant.Task(axes="xyz")
#: Settings in which every value differs from its default, so that kept values can be recognised.
SETTINGS = pliant.Settings(
    task=TASK, axes={"x": pliant.Axis(soft=1.5), "z": pliant.Axis(soft=1.0, adaptation=0.5)}
)


def soft(words, *, holds):
    return apply_soft(SETTINGS, words, MODEL, holds=holds, option="--soft")


@pytest.mark.parametrize("holds", [True, False])
def test_no_words_change_nothing(holds):
    assert soft("", holds=holds) is SETTINGS


@pytest.mark.parametrize("words", ["y=2 z=3.5", "y=2,z=3.5", " z=3.5  y=2 "])
def test_a_cap_is_constant_over_the_deviation(words):
    for holds in (True, False):
        made = soft(words, holds=holds)
        strengths = pliant.Controller(MODEL, made).axes
        assert [strengths[name].soft for name in "yz"] == [(2.0, 2.0), (3.5, 3.5)]
        assert [made.axes[name].profile for name in "yz"] == ["constant", "constant"]
        assert made.axes["z"].adaptation == 0.0, "a named axis is as the flag says"


def test_axes_that_are_not_named_hold_or_stay():
    hold, stay = soft("y=2", holds=True), soft("y=2", holds=False)
    assert (hold.axes["x"], hold.axes["z"]) == (pliant.Axis(), pliant.Axis())
    assert (stay.axes["x"], stay.axes["z"]) == (SETTINGS.axes["x"], SETTINGS.axes["z"])


def test_an_axis_without_a_cap_takes_the_arms_own():
    assert soft("y", holds=True).axes["y"] == pliant.Axis(yields="both")
    preset = pliant.Settings.soft("y", task=TASK).axes["y"]
    assert soft("y", holds=False).axes["y"] == preset
    both = soft("x y=2", holds=True)
    assert both.axes["x"] == pliant.Axis(yields="both")
    assert both.axes["y"].soft == (2.0, 2.0)


def test_everything_else_of_the_settings_is_kept():
    own = SETTINGS.replace(rate=50.0, max_tool_speed=(0.1, 0.5))
    made = apply_soft(own, "y=2", MODEL, holds=True)
    assert made == own.replace(axes={"y": pliant.Axis(soft=2.0, profile="constant")})


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("y=60", r"--soft y=60: this arm holds y with at most \S+ N; a cap is at most that"),
        ("roll", "roll is not an axis of the task, which has x, y, z"),
        ("w=2", "--soft 'w'"),
        ("y=two", "--soft takes axis or axis=newtons"),
        ("y=-1", "a cap is a number from 0 up, got -1"),
        ("y=inf", "got inf"),
        ("y=2 y", "names y twice"),
    ],
)
@pytest.mark.parametrize("holds", [True, False])
def test_what_cannot_be_is_refused(words, said, holds):
    with pytest.raises(pliant.ConfigError, match=said):
        soft(words, holds=holds)


def test_the_largest_cap_is_what_the_arm_holds():
    most = pliant.Controller(MODEL, pliant.Settings.firm(task=TASK)).axes["y"].hold
    assert soft(f"y={most}", holds=True).axes["y"].soft == (most, most)
    with pytest.raises(pliant.ConfigError, match="holds y with at most"):
        soft(f"y={1.01 * most}", holds=True)
