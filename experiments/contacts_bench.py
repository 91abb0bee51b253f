"""Random contacts and free motion of a simulated arm, estimated through its servos.

A run records estimate, bound and true force, tick by tick; thresholds are evaluated afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from experiments.campaign_arms import load
from experiments.campaign_jobs import REAL_GEARS
from pliant.robots import COUNT_12_BIT
from pliant.sim import Plant

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from experiments.campaign_arms import Arm
    from pliant.sim.ground_truth import GroundTruth

    Array = NDArray[np.float64]

RATE = 100.0
#: Start of a hand, and its duration [s].
COMES, STAYS = 0.7, 0.8
#: Random contacts: stiffness [N/m], speed [m/s] and largest force [N] of the hand, speed of the arm
#: [m/s]; the first two are drawn by their logarithms.
STIFFNESS, SPEED, FORCE, MOTION = (200.0, 20e3), (0.02, 0.25), (0.15, 0.9), (0.0, 0.15)
#: Free motion: largest distance of the joints from a middle pose [rad], time from point to point
#: [s].
WANDER, LEG = 0.45, (1.2, 3.0)
#: Share of legs after which the arm rests for half a second.
RESTS = 0.3


@dataclass(frozen=True)
class Case:
    """Errors of the controller's assumptions, and the part of them that the estimator knows.

    Attributes:
        name: For tables.
        arm: By name.
        encoder: True if readings have counts that flicker.
        friction: Share by which assumed friction and damping are off, at random by joint.
        kp: The same of k_p.
        gears: True if friction depends on speed and load.
        identified: True if the controller knows the gears' friction by speed and load.
        sensed: True if servos report their load, 10 % off at most and with 1 % of noise.
        delay: Known delay of readings and commands [ticks].
        told: Options of `pliant.ContactEstimator`.
    """

    name: str
    arm: str = "arm7"
    encoder: bool = True
    friction: float = 0.3
    kp: float = 0.0
    gears: bool = False
    identified: bool = False
    sensed: bool = False
    delay: tuple[int, int] = (0, 0)
    told: Mapping[str, Any] = field(default_factory=dict)

    def options(self) -> dict[str, Any]:
        """Return the options of the estimator: known errors, in shares."""
        known = {"kp_error": max(self.kp, 0.02), "gravity_error": 0.02, "load_error": 0.1}
        return {"friction_error": max(self.friction, 0.05), **known, **self.told}


@dataclass(frozen=True)
class Record:
    """One run, one row per reading.

    Attributes:
        felt: Estimated force (N, 3) [N] and torque (N, 3) [N·m], base axes: (N, 6).
        bound: Its uncertainty (N, 6).
        truth: True force in the period before the reading (N, 6).
        evidence: Largest residual of a joint over its bound (N,).
    """

    felt: Array
    bound: Array
    truth: Array
    evidence: Array


class Bump:
    """A hand that meets the tool at its present position and continues behind a spring.

    ``f = clip(stiffness (speed (t - t0) - shift since t0), 0, limit)`` along a direction: it pushes
    and never pulls.
    """

    at = "tool"

    def __init__(self, direction: Array, stiffness: float, speed: float, limit: float) -> None:
        """Direction (3,) in base axes, stiffness [N/m], speed [m/s], largest force [N]."""
        self.direction, self.stiffness, self.speed, self.limit = direction, stiffness, speed, limit
        self._met: Array | None = None

    def force(self, ground_truth: GroundTruth, t: float) -> tuple[Array, Array, Array]:
        """The push at the tool."""
        place, none = ground_truth.frame("tool").position, np.zeros(3)
        if not COMES <= t < COMES + STAYS:
            return none, none, place
        if self._met is None:
            self._met = place.copy()
        deep = self.speed * (t - COMES) - float(self.direction @ (place - self._met))
        return min(max(self.stiffness * deep, 0.0), self.limit) * self.direction, none, place


class Bench:
    """One arm in one case; every run is seeded by its number."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.arm: Arm = load(case.arm)

    @cached_property
    def poses(self) -> Array:
        """Return poses (N, n) [rad], none near a singular one or a stop."""
        low, high = np.asarray(self.arm.model.lower), np.asarray(self.arm.model.upper)
        room = 0.5 if self.arm.model.n > 5 else 0.3
        found = self.arm.poses(len(self.arm.drawn))
        clear: Array = found[((found > low + room) & (found < high - room)).all(axis=1)]
        held = [self.arm.capacity(q, 2, -1.0) > 0.3 * self.arm.median_capacity[0] for q in clear]
        poses: Array = clear[np.array(held)]
        return poses

    def contact(self, number: int) -> Record:
        """Run one random contact."""
        rng = np.random.default_rng((number, 1))
        q = self.poses[number % len(self.poses)]
        direction, way = _direction(rng), _direction(rng)
        most = rng.uniform(*FORCE) * 0.45 * self.arm.median_capacity[0]
        hand = Bump(direction, _log(rng, STIFFNESS), _log(rng, SPEED), most)
        speed = rng.uniform(*MOTION) if rng.random() < 0.5 else 0.0
        pose = self.arm.model.forward_kinematics(q)

        def target(t: float) -> Array:
            moved = pose.copy()
            moved[:3, 3] += way * speed * max(t - 0.2, 0.0)
            return moved

        plant, controller, contact = self._make(rng, (hand,))
        return self._run(plant, controller, contact, q, target, seconds=COMES + STAYS, rng=rng)

    def free(self, number: int, seconds: float) -> Record:
        """Run free motion from point to point, smooth, with rests."""
        rng = np.random.default_rng((number, 2))
        q = self.poses[number % len(self.poses)]
        path = _Path(rng, q, np.asarray(self.arm.model.lower), np.asarray(self.arm.model.upper))
        plant, controller, contact = self._make(rng, ())
        kinematics = self.arm.model.forward_kinematics

        def target(t: float) -> Array:
            pose: Array = kinematics(path(t))
            return pose

        return self._run(plant, controller, contact, q, target, seconds=seconds, rng=rng)

    def _make(
        self, rng: np.random.Generator, hands: tuple[Bump, ...]
    ) -> tuple[Plant, pliant.Controller, pliant.ContactEstimator]:
        """Make plant, controller and estimator of one run."""
        case, true = self.case, self.arm.servos
        n = self.arm.model.n

        def off(share: float) -> Array:
            return rng.uniform(1.0 - share, 1.0 + share, n)

        count = COUNT_12_BIT if case.encoder else 0.0
        table = REAL_GEARS[case.arm].assumed(true) if case.identified else true
        rubs = off(case.friction)
        believed = table.replace(
            friction=rubs * np.asarray(table.friction),
            load_friction=rubs * np.asarray(table.load_friction),
            stribeck=rubs * np.asarray(table.stribeck),
            load_stribeck=rubs * np.asarray(table.load_stribeck),
            damping=off(case.friction) * np.asarray(table.damping),
            kp=off(case.kp) * np.asarray(table.kp),
            encoder_step=count,
        )
        task, delay = " ".join(self.arm.axes), sum(case.delay) / RATE
        settings = pliant.Settings(task=task, rate=RATE, delay=delay)
        controller = pliant.Controller(self.arm.model, settings, believed)
        options: dict[str, Any] = {
            "rate": RATE,
            "delay": case.delay,
            "count": count,
            "flicker": int(case.encoder),
        }
        if case.gears:
            options["friction"] = REAL_GEARS[case.arm]
        seed = int(rng.integers(2**31))
        plant = Plant(self.arm.model, true, scene=hands, seed=seed, **options)
        return plant, controller, pliant.ContactEstimator(controller, **case.options())

    def _run(
        self,
        plant: Plant,
        controller: pliant.Controller,
        contact: pliant.ContactEstimator,
        q: Array,
        target: Any,
        *,
        seconds: float,
        rng: np.random.Generator,
    ) -> Record:
        """Close the loop and record the estimate."""
        plant.reset(q)
        controller.reset(q)
        count = round(seconds * RATE)
        felt, bound, truth = (np.zeros((count, 6)) for _ in range(3))
        evidence = np.zeros(count)
        usable = np.asarray(self.arm.servos.max_torque)
        gain = rng.uniform(0.9, 1.1, usable.size)
        for tick in range(count):
            reading = plant.read().q
            load = None
            if self.case.sensed and tick > 0:
                load = gain * plant.torque + 0.01 * usable * rng.standard_normal(usable.size)
            found = contact.update(reading, load=load)
            felt[tick], bound[tick] = found.force_base, found.uncertainty_base
            evidence[tick] = found.residual_ratio
            if plant.hands:
                truth[tick, :3] = plant.hands[0].force
            command = controller.step(reading, target(tick / RATE))
            plant.write(command.goal, command.torque_limit)
            plant.advance()
        return Record(felt, bound, truth, evidence)


class _Path:
    """Joints from point to point with minimum jerk, and rests."""

    def __init__(self, rng: np.random.Generator, middle: Array, low: Array, high: Array) -> None:
        self._rng, self._middle = rng, middle
        self._low, self._high = low + 0.3, high - 0.3
        self._begin, self._end, self._from, self._to = 0.0, 0.5, middle, middle

    def __call__(self, t: float) -> Array:
        if t >= self._end:
            self._begin, self._from = self._end, self._to
            wish = self._middle + self._rng.uniform(-WANDER, WANDER, self._middle.size)
            self._to = np.clip(wish, self._low, self._high)
            self._end += self._rng.uniform(*LEG)
            if self._rng.random() < RESTS:
                self._to, self._end = self._from, self._begin + 0.5
        s = (t - self._begin) / (self._end - self._begin)
        smooth = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        where: Array = self._from + smooth * (self._to - self._from)
        return where


def _direction(rng: np.random.Generator) -> Array:
    """Return a random direction (3,)."""
    vector = rng.standard_normal(3)
    unit: Array = vector / np.linalg.norm(vector)
    return unit


def _log(rng: np.random.Generator, span: tuple[float, float]) -> float:
    """Return a random number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(*np.log(span))))
