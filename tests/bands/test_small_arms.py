"""Target steps of 10 cm of small arms with stiff axes: bounds on speed and overshoot."""

import numpy as np
import pytest

import pliant
from experiments import steps
from experiments.arms import BESIDE, ROBOTS
from experiments.simulation import closed_loop
from pliant import Axis
from pliant.sim import Plant

COUNT = 3
#: Case of a bug report: the tool moved at 0.38 m/s despite a bound of 0.25, and overshot by 28 mm.
REPORTED_STEP = steps.Step((0.0, -0.3, 0.3, 0.9, 0.0), (0.0164, 0.0, 0.1044))


def require_urdf(name):
    """Skip the test if the URDF of the arm is not available."""
    if name in BESIDE and not (ROBOTS / BESIDE[name][0]).exists():
        pytest.skip(f"no URDF of {name} beside this checkout")


@pytest.mark.parametrize("speed", steps.SPEEDS)
@pytest.mark.parametrize("law", steps.LAWS)
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_a_step_keeps_the_tool_speed_and_stops_at_its_target(name, law, speed):
    settings = steps.settings(name, law, speed)
    for step in steps.steps(name, COUNT):
        result = steps.run(name, step, settings)
        assert result.fastest <= 1.2 * speed + 0.02, (step, result)
        assert result.overshoot <= 0.005, (step, result)


@pytest.mark.parametrize("speed", steps.SPEEDS)
def test_a_vx300s_keeps_them_under_law_paper(speed):
    require_urdf("vx300s")
    settings = steps.settings("vx300s", "paper", speed)
    for step in steps.steps("vx300s", COUNT):
        result = steps.run("vx300s", step, settings)
        assert result.fastest <= 1.2 * speed + 0.02, (step, result)
        assert result.overshoot <= 0.005, (step, result)


@pytest.mark.parametrize("speed", steps.SPEEDS)
@pytest.mark.parametrize("law", ["cap", "impedance"])
def test_a_vx300s_is_near_them_under_the_other_laws(law, speed):
    """The friction feed-forward jumps, so that the bounds are wider: measured 0.155 m/s, 8.9 mm."""
    require_urdf("vx300s")
    settings = steps.settings("vx300s", law, speed)
    for step in steps.steps("vx300s", COUNT):
        result = steps.run("vx300s", step, settings)
        assert result.fastest <= 1.2 * speed + 0.04, (step, result)
        assert result.overshoot <= 0.01, (step, result)


@pytest.mark.parametrize("speed", steps.SPEEDS)
@pytest.mark.parametrize("law", steps.LAWS)
def test_the_step_of_the_newcomer(law, speed):
    result = steps.run("so101", REPORTED_STEP, steps.settings("so101", law, speed))
    assert result.fastest <= 1.2 * speed + 0.02
    assert result.overshoot <= 0.005


@pytest.mark.parametrize("name", ["so101", "koch", "vx300s"])
def test_steps_that_are_asked_go_in_several_directions(name):
    require_urdf(name)
    directions = np.array([step.way for step in steps.steps(name, COUNT)])
    assert np.allclose(np.linalg.norm(directions, axis=1), 0.1)
    assert np.linalg.matrix_rank(directions, tol=0.01) > 1


def fastest_after_update(name, step, before, after):
    """Return the distance to the target at an update [m], and the largest speed after it [m/s].

    The target steps under the settings `before`; `after` replaces them 1.5 s later. The speed of
    the tool is averaged over 50 ms.
    """
    arm = steps.arm(name)
    controller = pliant.Controller(arm.model, before)
    plant = Plant(arm.model, rate=steps.RATE, encoder_step=np.asarray(arm.servos.encoder_step))
    plant.reset(step.q)
    target = plant.tool
    for _ in closed_loop(plant, controller, target, 0.5):
        pass
    target[:3, 3] += step.way
    path = [plant.tool[:3, 3] for _ in closed_loop(plant, controller, target, 1.5)]
    away = np.linalg.norm(target[:3, 3] - path[-1])
    controller.update(after)
    window = round(steps.WINDOW * steps.RATE)
    path = path[-window - 1 :]
    path += [plant.tool[:3, 3] for _ in closed_loop(plant, controller, target, 2.0)]
    speeds = np.linalg.norm(np.array(path)[window:] - np.array(path)[:-window], axis=1)
    return away, float(speeds.max()) / steps.WINDOW


@pytest.mark.parametrize("speed", steps.SPEEDS)
@pytest.mark.parametrize("law", steps.LAWS)
@pytest.mark.parametrize("name", ["so101", "koch", "vx300s"])
def test_an_axis_that_becomes_stiff_keeps_the_tool_speed(name, law, speed):
    """The bounds are those of a step of the target."""
    require_urdf(name)
    stiff = steps.settings(name, law, speed)
    tiny = 1e-4 if law == "paper" else 1e-3
    free = stiff.replace(axes={axis: Axis(soft=tiny, firm=2.0 * tiny) for axis in "xy"})
    bound = 1.2 * speed + (0.04 if name == "vx300s" and law != "paper" else 0.02)
    for way, step in zip((0.1, -0.1), steps.steps(name, 2), strict=True):
        sideways = steps.Step(step.q, (0.0, way, 0.0))
        away, fastest = fastest_after_update(name, sideways, free, stiff)
        assert fastest <= bound, (step, fastest)
        assert away > 0.09 or law == "paper", (step, away)
