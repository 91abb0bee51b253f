"""No controller of an experiment gets true parameters of the plant that it should not know.

Each experiment, example and row of a documented table runs up to its first physics step. Then its
plant is compared with the inputs of its controller, arm or identification.
"""

import runpy
from pathlib import Path
from unittest.mock import patch

import pytest

pytest.importorskip("mujoco", reason="plants are simulated: extra sim")

from mismatch import RANDOM, Mismatch, Parameters, under

import pliant
from experiments import (
    campaign,
    contacts,
    controllers,
    descent,
    disturbances,
    doors,
    goals,
    gravity_capture,
    hand_guiding,
    identification,
    lifecycle,
    presets,
    steps,
    teaching,
)
from experiments.arms import load
from experiments.chapters import comparison
from experiments.simulation import NOMINAL, Conditions
from pliant.arm import Arm
from pliant.sim import DRAG_15N, Plant, SimDrive
from pliant.sim.postures import VERTICAL

EXAMPLES = Path(__file__).parents[1] / "examples"
GEARS = campaign.REAL_GEARS["arm7"]


class FirstStep(Exception):
    """Raised in the first physics step, when plant and controller exist."""


def build(gap, run):
    """Run until the first physics step, and compare plant and assumptions with `gap`."""
    begins = patch.object(Plant, "advance", side_effect=FirstStep)
    with gap, begins, pytest.raises(FirstStep):
        run()
    for arm in gap.consumers:
        if isinstance(arm, Arm):
            arm.disable_torque()


def plant(**differs):
    return Mismatch(plant=Parameters(**differs), assumed=Parameters())


def promise(disturbance):
    """Run the measurement of one force cap of the campaign under a disturbance."""
    arm = load("arm7")
    bench = campaign.Bench(arm, disturbance)
    return bench.keep(0, arm.poses(1)[0], "y", 1.0, 5.0, guided=False)


def contact_gap(case):
    gears = campaign.REAL_GEARS[case.arm] if case.gears else None
    random_values = {"friction": RANDOM, "damping": RANDOM, **({"kp": RANDOM} if case.kp else {})}
    delay = sum(case.delay) / contacts.RATE
    return Mismatch(
        plant=Parameters(gears=gears, delay=delay),
        assumed=Parameters(gears=gears if case.identified else None, delay=delay, **random_values),
    )


def stress_gap(conditions):
    share = conditions.plant["friction_scale"]
    return plant(friction=share, damping=share)


def cases():
    """Yield the cases: name, stated mismatch, and function that runs the experiment."""
    for options in (
        {"load": lifecycle.LOAD},
        {"load": lifecycle.LOAD, "over_table": True, "ticks": 1},
        {"load": lifecycle.LOAD, "answered": 0.0, "ticks": 1},
        {"kp_scale": 1.25, "over_table": True},
        {"kp_scale": 0.8, "over_table": True},
    ):
        gap = plant(
            kp=options.get("kp_scale", 1.0),
            payload=options.get("load", 0.0),
            delay=0.02 * options.get("ticks", 0),
        )
        name = ", ".join(f"{key} {value:g}" for key, value in options.items())
        yield f"lower: {name}", gap, lambda o=options: lifecycle.lower(VERTICAL, **o)
    for job in descent.descents("arm7", 6):
        known = job.truth
        gap = plant(
            kp=known.stiffness,
            friction=known.friction,
            payload=known.load,
            delay=0.01 * sum(known.delay),
        )
        yield f"descent {job.number} {job.over_table}", gap, job.run
    for kp in (0.5, 0.8, 1.25, 2.0):
        yield (
            f"capture {kp}",
            plant(kp=kp),
            lambda kp=kp: gravity_capture.try_capture("arm7", 0, kp),
        )
    for kp in (0.5, 2.0):
        yield f"float {kp}", plant(kp=kp), lambda kp=kp: hand_guiding.guide("so101", 0, kp)
    for arm in teaching.ARMS:
        yield f"teach {arm}", plant(kp=0.8), lambda arm=arm: teaching.replay(arm, 0.8, True, 1.0)
    for each in (*campaign.DISTURBANCES, *campaign.gears("arm7")):
        if each.wrong or each.payload or (each.gears is not None and not each.gears_known):
            gap = plant(kp=each.kp, payload=each.payload, gears=each.gears)
            yield f"campaign {each.name}", gap, lambda each=each: promise(each)
    for case in (contacts.MAIN, *contacts.OTHERS):
        if case.friction or case.kp:
            gap, bench = contact_gap(case), contacts.Bench(case)
            yield f"contact {case.name}", gap, lambda bench=bench: bench.contact(0)
    for name, each in presets.UNDER.items():
        if "assumed" not in name:
            continue
        for preset, (law, scene) in presets.SCENES.items():
            yield f"{preset} {name}", under(each), lambda o=each, law=law, s=scene: s(law, o)
    for entry in goals._ENTRIES:
        has_second = any(second is not None for _, second in entry.goals.values())
        for each in (goals.UNCERTAIN[0], goals.UNCERTAIN[2]) if has_second else ():
            yield f"goals {entry.scenario}", under(each), lambda e=entry, o=each: e.measure(o)
    for each in goals.rate_conditions():
        if each.assumed_ratio == 1.0:
            continue
        yield (
            f"rates {each}",
            under(each),
            lambda each=each: disturbances.drag(controllers.cap(), DRAG_15N, conditions=each),
        )
    for each in (
        Conditions(gears=GEARS),
        Conditions(gears=GEARS, gears_known=True, assumed_ratio=0.7),
    ):
        yield f"gears {each.assumed_ratio}", under(each), lambda each=each: goals.door("door")(each)
    for name, each in comparison._stresses(NOMINAL).items():
        if name != "stall":
            yield (
                f"gears {name}",
                stress_gap(each),
                lambda o=each: disturbances.drag(controllers.cap(), conditions=o),
            )
    for name, kp, friction, _ in steps.DISTURBED:
        if (kp, friction) != (1.0, 1.0):
            options = {"kp_scale": kp, "friction_scale": friction}
            gap = plant(kp=kp, friction=friction)
            step, law = steps.steps("so101", 1)[0], steps.settings("so101", "cap", 0.1)
            yield (
                f"steps {name}",
                gap,
                lambda s=step, law=law, o=options: steps.run("so101", s, law, o),
            )
    scales = {"kp": 1.25, "friction": 1.4, "damping": 1.3, "delay": 0.02}
    yield "identified, rows", plant(**scales), identification.rows
    believing = identification.AssumedTable(
        table=identification.initial_table(pliant.robots.arm7()),
        delay=(1, 1),
        plant=identification.WRONG,
    )
    yield (
        "a wrong table",
        plant(**scales),
        lambda: doors.open_door(controllers.cap, conditions=believing),
    )
    for example, differs in {
        "06_capture_gravity": {"kp": 0.8},
        "17_identify": {"kp": 0.8, "friction": 1.4, "payload": 0.2, "delay": 0.01},
        "18_float": {"kp": 0.5},
    }.items():
        file = EXAMPLES / f"{example}.py"
        yield example, plant(**differs), lambda file=file: runpy.run_path(str(file))


CASES = list(cases())


def test_all_cases_are_listed():
    assert len(CASES) == 113


@pytest.mark.parametrize(("gap", "run"), [case[1:] for case in CASES], ids=[c[0] for c in CASES])
def test_wrong_assumptions_differ_from_the_plant(gap, run):
    build(gap, run)


def connected(**options):
    return Arm(
        pliant.robots.so101(),
        SimDrive(Plant(pliant.robots.so101(), **options)),
        handle_signals=False,
    )


def test_equal_sides_are_refused():
    with pytest.raises(AssertionError, match="plant and assumptions are equal"):
        plant(kp=1.0)


@pytest.mark.parametrize(
    "differs", [{"kp": 1.25}, {"friction": 0.7}, {"payload": 0.1}, {"delay": 0.01}]
)
def test_a_plant_that_is_as_assumed_is_noticed(differs):
    failure = pytest.raises(AssertionError, match=f"Plant: {next(iter(differs))} is .* stated is")
    with failure, plant(**differs):
        connected()


def test_a_drive_that_hands_out_the_plant_s_stiffness_is_noticed():
    class Telling(SimDrive):
        def __init__(self, plant):
            super().__init__(plant, servos=plant.table.replace(kp=plant.gains.kp))

    with pytest.raises(AssertionError, match=r"Arm: kp is .* stated is"), plant(kp=1.25):
        Arm(
            pliant.robots.so101(),
            Telling(Plant(pliant.robots.so101(), kp_scale=1.25)),
            handle_signals=False,
        )


def test_a_controller_with_the_true_values_is_detected():
    model = pliant.robots.so101()
    true_model = pliant.robots.so101(payload=(0.1, (0.0, 0.0, 0.0)))
    settings = pliant.Settings(task="xyz")
    for gap, controller in (
        (plant(payload=0.1), pliant.Controller(true_model, settings)),
        (plant(delay=0.02), pliant.Controller(model, settings.replace(delay=0.02))),
        (
            plant(friction=0.5),
            pliant.Controller(
                model, settings, model.servos.replace(friction=0.5 * model.servos.friction)
            ),
        ),
    ):
        gap.build(model, delay=(1, 1) if gap.plant.delay else (0, 0))
        with pytest.raises(AssertionError, match=r"Controller: .* stated is"):
            gap.check(controller)


def test_a_block_in_which_nothing_is_compared_fails():
    with pytest.raises(AssertionError, match="no plant with a consumer"), plant(kp=2.0):
        Plant(pliant.robots.so101(), kp_scale=2.0)
