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


def soft(text, *, holds):
    return apply_soft(SETTINGS, text, MODEL, holds=holds, option="--soft")


@pytest.mark.parametrize("holds", [True, False])
def test_no_words_change_nothing(holds):
    assert soft("", holds=holds) is SETTINGS


@pytest.mark.parametrize("text", ["y=2 z=3.5", "y=2,z=3.5", " z=3.5  y=2 "])
def test_a_cap_is_constant_over_the_deviation(text):
    for holds in (True, False):
        settings = soft(text, holds=holds)
        strengths = pliant.Controller(MODEL, settings).axes
        assert [strengths[name].soft for name in "yz"] == [(2.0, 2.0), (3.5, 3.5)]
        assert [settings.axes[name].profile for name in "yz"] == ["constant", "constant"]
        assert settings.axes["z"].adaptation == 0.0, "a named axis is as the flag says"


def test_unnamed_axes_hold_or_keep_their_settings():
    held, unchanged = soft("y=2", holds=True), soft("y=2", holds=False)
    assert (held.axes["x"], held.axes["z"]) == (pliant.Axis(), pliant.Axis())
    assert (unchanged.axes["x"], unchanged.axes["z"]) == (SETTINGS.axes["x"], SETTINGS.axes["z"])


def test_an_axis_without_a_cap_takes_the_arms_own():
    assert soft("y", holds=True).axes["y"] == pliant.Axis(yields="both")
    preset = pliant.Settings.soft("y", task=TASK).axes["y"]
    assert soft("y", holds=False).axes["y"] == preset
    both = soft("x y=2", holds=True)
    assert both.axes["x"] == pliant.Axis(yields="both")
    assert both.axes["y"].soft == (2.0, 2.0)


def test_everything_else_of_the_settings_is_kept():
    original = SETTINGS.replace(rate=50.0, max_tool_speed=(0.1, 0.5))
    settings = apply_soft(original, "y=2", MODEL, holds=True)
    assert settings == original.replace(axes={"y": pliant.Axis(soft=2.0, profile="constant")})


@pytest.mark.parametrize(
    ("text", "message"),
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
def test_invalid_values_are_refused(text, message, holds):
    with pytest.raises(pliant.ConfigError, match=message):
        soft(text, holds=holds)


def test_the_largest_cap_is_what_the_arm_holds():
    largest = pliant.Controller(MODEL, pliant.Settings.firm(task=TASK)).axes["y"].hold
    assert soft(f"y={largest}", holds=True).axes["y"].soft == (largest, largest)
    with pytest.raises(pliant.ConfigError, match="holds y with at most"):
        soft(f"y={1.01 * largest}", holds=True)
