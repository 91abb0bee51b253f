"""Accuracy of identification: ``python -m experiments.identification``.

The servos of every built-in arm are identified in simulations whose servos differ from the table in
one or several properties. Then drag and door experiments of `arm7` run with a controller that
assumes a wrong, the identified and the true servo table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from experiments import command_line, controllers, goals, markdown
from experiments.runner import Job, run_by_key
from experiments.simulation import Conditions
from pliant import identify, robots
from pliant.sim import (
    DRAG_15N,
    DRAG_80N,
    MX64,
    MX106,
    STS3215,
    ForceProfile,
    Friction,
    Plant,
    Push,
)
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from experiments.poses import Array


#: Start pose of each arm (n,) [rad].
STARTS = {
    "arm7": np.asarray(VERTICAL),
    "so101": np.array([0.2, -0.3, 0.3, 0.9, 0.0]),
    "koch": np.array([0.2, -0.3, 0.3, 0.9, 0.0]),
}
#: Payload that each arm can lift [kg].
LIFTS = {"arm7": 0.3, "so101": 0.3, "koch": 0.05}
#: Horizontal force at the tool of each arm, along y of the base [N].
FORCES = {"arm7": 5.0, "so101": 2.0, "koch": 0.5}
CENTRE = (0.02, 0.01, 0.05)  # [m]
COUNT, DEADBAND = np.deg2rad(0.088), np.deg2rad(0.06)
GEARS = {
    "arm7": Friction.of([MX106] * 4 + [MX64] * 3),
    "so101": STS3215,
    "koch": STS3215,
}
#: Options of the simulated arm by name of the case. `lift` is the payload as a share of `LIFTS`,
#: `gears` selects the friction `GEARS`, `force` the force `FORCES`; the other options are those of
#: `pliant.sim.Plant`.
CASES: dict[str, dict[str, Any]] = {
    "as the table": {},
    "k_p × 0.8": {"kp_scale": 0.8},
    "k_p × 1.25": {"kp_scale": 1.25},
    "friction × 0.7": {"friction_scale": 0.7},
    "friction × 1.3": {"friction_scale": 1.3},
    "friction × 3": {"friction_scale": 3.0},
    "damping × 0.7": {"damping_scale": 0.7},
    "1 tick of delay": {"delay": (1, 0)},
    "2 ticks of delay": {"delay": (1, 1)},
    "payload, a third": {"lift": 1 / 3},
    "payload": {"lift": 1.0},
    "dead band 0.06°": {"deadband": DEADBAND},
    "force at the tool": {"force": True},
    "gears as they are": {"gears": True},
    "several at once": {
        "kp_scale": 0.8,
        "friction_scale": 1.3,
        "delay": (1, 1),
        "lift": 2 / 3,
        "deadband": DEADBAND,
    },
}


@dataclass(frozen=True, kw_only=True)
class IdentificationErrors:
    """Errors of one identification by `identify.identify_servos`.

    Attributes:
        arm, case: Names of arm and case.
        kp, friction, damping: Identified over true values of each joint (n,); damping includes
            back-EMF.
        kp_bars: Error of k_p over its estimated standard deviation, of each joint (n,).
        loaded: True for joints whose gravity torque in the start pose exceeds three times their
            friction (n,).
        delay: Identified minus true delay [s].
        mass, mass_bars: Identified minus true mass of the payload [kg], and this error over its
            estimated standard deviation.
        centre: Distance of the identified from the true centre of mass of the payload [m]; NaN if
            there is no payload or none was found.
        spread: Residuals of the fit over the residuals that friction and encoder explain.
        seconds: Simulated duration of the identification [s].
        found: Complete result of the identification.
    """

    arm: str
    case: str
    kp: Array
    friction: Array
    damping: Array
    kp_bars: Array
    loaded: NDArray[np.bool_]
    delay: float
    mass: float
    mass_bars: float
    centre: float
    spread: float
    seconds: float
    found: identify.Identification


def plant(arm: str, case: str, rate: float = 100.0) -> Plant:
    """Return a simulated arm in its start pose, with the options of a case and a real encoder step.

    `rate` is the control rate [Hz].
    """
    options = dict(CASES[case])
    lift, gears = options.pop("lift", 0.0), options.pop("gears", False)
    if lift:
        options["payload"] = (lift * LIFTS[arm], CENTRE)
    if gears:
        options["friction"] = GEARS[arm]
    if options.pop("force", False):
        course = ForceProfile(start=0.0, rise=0.5, end=np.inf)
        options["scene"] = [Push(force_vector=(0.0, FORCES[arm], 0.0), course=course)]
    out = Plant(robots.load(arm), encoder_step=COUNT, rate=rate, **options)
    out.reset(STARTS[arm])
    return out


def identify_arm(
    arm: str, case: str, span: float = 0.4, rate: float = 100.0
) -> IdentificationErrors:
    """Identify the servos of a simulated arm, and return the errors of the result.

    Args:
        arm: Key of `STARTS`.
        case: Key of `CASES`.
        span: Largest distance of each joint from the start pose during the identification [rad].
        rate: Control rate [Hz].
    """
    body = plant(arm, case, rate)
    model = robots.load(arm)
    table = initial_table(model)
    result = identify.identify_servos(body, model, table, span=span)
    gains, servos = body.gains, result.servos
    gravity = np.asarray(model.gravity(STARTS[arm]))
    lift = CASES[case].get("lift", 0.0) * LIFTS[arm]
    friction = gains.friction
    if CASES[case].get("gears"):
        friction = np.asarray(GEARS[arm].at_rest(gravity))
    emf = gains.torque / np.asarray(servos.no_load_speed) if table.limit_type == "pwm" else 0.0
    damping = (servos.damping + servos.kv + emf) / (gains.damping + gains.kv)
    load = result.payload
    centre = np.linalg.norm(load.com - CENTRE) if lift and load.found else np.nan
    return IdentificationErrors(
        arm=arm,
        case=case,
        kp=servos.kp / gains.kp,
        friction=result.friction / friction,
        damping=damping,
        kp_bars=(servos.kp - gains.kp) / result.sigma["kp"],
        loaded=np.abs(gravity) > 3.0 * gains.friction,
        delay=result.delay - sum(CASES[case].get("delay", (0, 0))) / rate,
        mass=load.mass - lift,
        mass_bars=(load.moments[0] - lift) / load.mass_sigma,
        centre=float(centre),
        spread=result.residual_ratio,
        seconds=body.time,
        found=result,
    )


def initial_table(model: pliant.Model) -> pliant.Servos:
    """Return the initial servo table of an identification, in which k_p is not known."""
    if model.servos is None:
        raise pliant.ConfigError(f"{model.name} has no servos")
    return model.servos.replace(encoder_step=COUNT, stiffness_known=False)


@dataclass(frozen=True, kw_only=True)
class AssumedTable(Conditions):
    """Conditions of a run in which the controller assumes the given servo table and delay.

    Attributes:
        table: Assumed servo parameters.
        known_delay: Assumed sum of the delays of readings and of commands [s].
    """

    table: pliant.Servos
    known_delay: float = 0.0

    def servos(self) -> pliant.Servos:
        """Return the assumed servo parameters."""
        return self.table

    def controller(self, law: Any) -> Any:
        """Return a controller of `arm7` with the settings `law` and these assumptions."""
        settings = law.replace(rate=self.rate, delay=self.known_delay, accept_high_adaptation=True)
        return pliant.Controller(robots.arm7(), settings, self.table)


#: True over assumed servo parameters of `arm7` in the experiments before and after identification.
WRONG: dict[str, Any] = {"kp_scale": 1.25, "friction_scale": 1.4, "damping_scale": 1.3}


def rows(span: float = 0.4) -> list[tuple[str, dict[str, float]]]:
    """Measure forces of a hand that drags the tool, and of an arm that opens a door.

    The servo table is wrong, then the identified one, then the true one.

    `span` is the largest distance of each joint from the start pose during the identification
    [rad].

    Returns:
        For each table, its name and the measured numbers by name.
    """
    delay, options = (1, 1), {**WRONG, "encoder_step": COUNT}
    body = Plant(robots.arm7(), delay=delay, **options)
    body.reset(STARTS["arm7"])
    table = initial_table(robots.arm7())
    result = identify.identify_servos(body, robots.arm7(), table, span=span)
    gains = body.gains
    true = table.replace(
        kp=gains.kp,
        friction=gains.friction,
        damping=gains.damping,
        kv=gains.kv,
        stiffness_known=True,
    )
    beliefs = {
        "the table, wrong": (table, 0.0),
        "identified": (result.servos, result.delay),
        "known exactly": (true, sum(delay) / 100.0),
    }
    measures = {
        "15 N hand": goals.measure_drag(controllers.cap(), DRAG_15N),
        "strong hand": goals.measure_drag(controllers.cap(), DRAG_80N),
        "door": goals.door("door"),
    }
    out = []
    for name, (servos, known) in beliefs.items():
        conditions = AssumedTable(table=servos, known_delay=known, delay=delay, plant=options)
        figures = {
            f"{scene}: {figure}": value
            for scene, measure in measures.items()
            for figure, value in measure(conditions).items()
        }
        out.append((name, figures))
    return out


class RecordingPlant:
    """A simulated arm that records its true positions at every reading."""

    def __init__(self, body: Plant) -> None:
        """Record the motion of `body`."""
        self._body = body
        self.q: list[Array] = []
        self.tool: list[Array] = []

    def read(self) -> Any:
        """Record the true positions, and return the reading of the arm."""
        self.q.append(self._body.q.copy())
        self.tool.append(self._body.tool[:3, 3].copy())
        return self._body.read()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._body, name)


def motion(arm: str, span: float) -> list[str]:
    """Return how far joints and tool of an arm move in an identification, as cells of a row."""
    body = RecordingPlant(plant(arm, "as the table"))
    model = robots.load(arm)
    identify.identify_servos(body, model, initial_table(model), span=span)
    joints = np.abs(np.array(body.q) - body.q[0]).max(axis=0)
    tool = 1e3 * (np.array(body.tool) - body.tool[0])
    return [
        arm,
        f"{span:g}",
        f"{np.median(joints):.2f} / {joints.max():.2f}",
        f"{-tool[:, 2].min():.0f}",
        f"{tool[:, 2].max():.0f}",
        f"{np.linalg.norm(tool, axis=1).max():.0f}",
    ]


MOTION_COLUMNS = ("arm", "span [rad]", "joints [rad]", "down [mm]", "up [mm]", "away [mm]")
#: Arguments `span` of the table of motions [rad].
SPANS = (0.05, 0.1, 0.4)


def line(errors: IdentificationErrors) -> list[str]:
    """Return the errors of one identification as the cells of a table row, see `COLUMNS`."""

    def percent(values: Array) -> str:
        deviation = 100.0 * np.abs(values - 1.0)
        return f"{np.median(deviation):.1f} / {deviation.max():.1f}"

    return [
        errors.arm,
        errors.case,
        percent(errors.kp[errors.loaded]) if errors.loaded.any() else "–",
        percent(errors.kp[~errors.loaded]) if (~errors.loaded).any() else "–",
        percent(errors.friction),
        percent(errors.damping),
        f"{1e3 * errors.delay:+.1f}",
        f"{1e3 * errors.mass:+.0f}",
        "–" if np.isnan(errors.centre) else f"{1e3 * errors.centre:.0f}",
        f"{100.0 * np.mean(np.abs(errors.kp_bars) < 2.0):.0f}",
        f"{errors.spread:.1f}",
        f"{errors.seconds:.0f}",
    ]


COLUMNS = (
    "arm",
    "the arm is",
    "k_p loaded [%]",
    "k_p not loaded [%]",
    "friction [%]",
    "damping [%]",
    "delay [ms]",
    "mass [g]",
    "centre [mm]",
    "k_p within 2 σ [%]",
    "spread",
    "time [s]",
)


def main(
    *,
    arm: command_line.Arms = (),
    span: float = 0.4,
    jobs: int = 2,
    before_and_after: bool = True,
    motions: bool = False,
) -> None:
    """Identify the servos of simulated arms; print errors as median / worst over the joints.

    Args:
        arm: Names of the arms; default: the built-in arms.
        span: Largest distance of each joint from the start pose during the identification [rad].
        jobs: Number of processes.
        before_and_after: True also runs drag and door before and after the identification.
        motions: True prints instead how far joints (median / worst) and tool move from the start.
    """
    if motions:
        pairs = [(name, value) for name in arm or tuple(STARTS) for value in SPANS]
        moved = run_by_key(
            [Job(f"{name} {value}", motion, (name, value)) for name, value in pairs], jobs
        )
        print(markdown.table(MOTION_COLUMNS, moved.values()))
        return
    work = [
        Job(f"{name} {case}", identify_arm, (name, case, span))
        for name in arm or tuple(STARTS)
        for case in CASES
    ]
    outcomes = run_by_key(work, jobs)
    print(markdown.table(COLUMNS, (line(outcome) for outcome in outcomes.values())))
    if before_and_after:
        table = rows(span)
        print()
        print(
            markdown.table(
                ("figure", *(name for name, _ in table)),
                (
                    (figure, *(f"{figures[figure]:.2f}" for _, figures in table))
                    for figure in table[0][1]
                ),
            )
        )


if __name__ == "__main__":
    command_line.start(main)
