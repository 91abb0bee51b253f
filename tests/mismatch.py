"""Plant-model mismatch: a test states true and assumed parameters, which are then verified.

A test with wrong assumptions states both sets of parameters; equal sets are rejected. At the end of
the `with` block, each plant and each user of a servo table created in it is compared with them. A
drive or an experiment that passes the plant's true parameters to the controller therefore fails:

    with Mismatch(plant=Parameters(kp=1.25), assumed=Parameters()):
        run = lower(grasp, kp_scale=1.25)
"""

from __future__ import annotations

import functools
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np

import pliant
from pliant.arm.arm import Arm
from pliant.identify._excitation import Excitation
from pliant.sim import Plant

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from experiments.simulation import Conditions
    from pliant.sim.friction import Friction

#: Placeholder for a random value, which only has to differ from that of the other side.
DRAWN = float("nan")
#: Relative difference below which two numbers are equal.
SAME = 1e-6


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Parameters of one side: those of the plant, or the assumed ones.

    Attributes:
        kp, friction, damping, torque: Ratios to the robot's servo table, scalars or (n,). Damping
            is the sum of gear damping and back-EMF.
        payload: Mass at the tool [kg].
        delay: Delay from sampling to reading plus that from a write to the servo [s]; of the
            assumed side, only the delay in a controller is compared.
        reach: Ratio of the joint ranges to those of the plant's model, scalar or (n,).
        gears: Friction model by speed and load, in place of the table; None: constant friction.
    """

    kp: ArrayLike = 1.0
    friction: ArrayLike = 1.0
    damping: ArrayLike = 1.0
    torque: ArrayLike = 1.0
    payload: float = 0.0
    delay: float = 0.0
    reach: ArrayLike = 1.0
    gears: Friction | None = None


NUMBERS = ("kp", "friction", "damping", "torque", "payload", "delay", "reach")


def differs(plant: ArrayLike, assumed: ArrayLike) -> bool:
    """Return True if two numbers, or some entries of two arrays, differ."""
    first, second = np.broadcast_arrays(np.asarray(plant, float), np.asarray(assumed, float))
    return not np.allclose(first, second, rtol=SAME, atol=SAME)


def under(conditions: Conditions) -> Mismatch:
    """Return the mismatch that `conditions` state, for a `with` block.

    Raises:
        AssertionError: Plant and assumptions are equal.
    """
    delay = sum(conditions.delay) / conditions.rate
    plant = Parameters(delay=delay, gears=conditions.gears)
    share = conditions.believed
    known = conditions.gears if conditions.gears_known else None
    assumed = Parameters(delay=delay, friction=share, damping=share, gears=known)
    return Mismatch(plant=plant, assumed=assumed)


class Mismatch:
    """Context manager that checks the objects created in its block against the stated parameters.

    Attributes:
        plant, assumed: Parameters of the two sides.
        plants: Plants made in the block.
        consumers: Controllers, arms, identifications and hand guidings made in the block.
    """

    def __init__(
        self, *, plant: Parameters, assumed: Parameters, compared: tuple[str, ...] = NUMBERS
    ) -> None:
        """State both sides; only the parameters named in `compared` are compared.

        Raises:
            AssertionError: The two sides are equal.
        """
        self.plant, self.assumed, self.compared = plant, assumed, compared
        self.plants: list[Plant] = []
        self.consumers: list[Any] = []
        self._stack = ExitStack()
        assert any(differs(getattr(plant, name), getattr(assumed, name)) for name in NUMBERS) or (
            plant.gears is not assumed.gears
        ), f"plant and assumptions are equal: the test would be given the plant's own {plant}"

    def build(
        self, model: pliant.Model, servos: pliant.Servos | None = None, **options: Any
    ) -> Plant:
        """Make the plant; `options` of `Plant` in addition to the stated parameters."""
        side = self.plant
        if side.payload:
            options.setdefault("payload", (side.payload, (0.0, 0.0, 0.0)))
        if side.gears is not None:
            options["friction"] = side.gears
        made = Plant(
            model,
            servos,
            kp_scale=side.kp,
            friction_scale=side.friction,
            damping_scale=side.damping,
            **options,
        )
        self.plants.append(made)
        return made

    def servos(self, model: pliant.Model) -> pliant.Servos:
        """Return the assumed servo table."""
        side, table = self.assumed, model.servos
        return table.replace(
            kp=np.multiply(side.kp, table.kp),
            friction=np.multiply(side.friction, table.friction),
            damping=np.multiply(side.damping, table.damping),
            max_torque=np.multiply(side.torque, table.max_torque),
        )

    def __enter__(self) -> Mismatch:
        """Start to record the plants, controllers, arms, ... that are made."""
        for cls, made in (
            (Plant, self.plants),
            (Arm, self.consumers),
            (Excitation, self.consumers),
        ):
            self._stack.enter_context(patch.object(cls, "__init__", _recorded(cls, made)))
        self._stack.enter_context(patch.object(pliant, "Controller", _recorder(self.consumers)))
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        """Compare the recorded objects with the statement, unless an exception was raised."""
        self._stack.close()
        if kind is None:
            self.check()

    def check(self, *consumers: Any) -> None:
        """Compare the recorded plants and consumers, and `consumers`, with the statement.

        Raises:
            AssertionError: An object differs from the statement, or there is no plant or no
                consumer.
        """
        pairs = [
            (plant, consumer)
            for plant in self.plants
            for consumer in (*self.consumers, *consumers)
            if consumer.model.joint_names == plant.model.joint_names
        ]
        assert pairs, "no plant with a consumer of its servo table was made"
        for plant, consumer in pairs:
            self._compare(plant, _of_plant(plant), self.plant, self.assumed)
            self._compare(consumer, _of_consumer(consumer, plant), self.assumed, self.plant)

    def _compare(
        self, whose: Any, found: dict[str, Any], stated: Parameters, other: Parameters
    ) -> None:
        name = type(whose).__name__
        for field in self.compared:
            if field not in found or (field == "friction" and self.plant.gears is not None):
                continue
            is_, meant = found[field], getattr(stated, field)
            if np.isnan(meant).any():
                assert differs(is_, getattr(other, field)), f"{name}: {field} is the other side's"
            else:
                assert not differs(is_, meant), f"{name}: {field} is {is_}, stated is {meant}"
        has, meant = found["gears"], stated.gears is not None
        assert has == meant, f"{name}: friction by speed and load is {has}, stated is {meant}"


def _of_plant(plant: Plant) -> dict[str, Any]:
    gains, table = plant.gains, plant.model.servos
    return {
        "kp": gains.kp / table.kp,
        "friction": _over(gains.friction, table.friction),
        "damping": _over(gains.damping, _damping(table, plant.n)),
        "torque": gains.torque / table.max_torque,
        "payload": _mass(plant) - _mass(Plant(plant.model)),
        "delay": sum(plant._bus._delay) * plant.period,
        "reach": 1.0,
        "gears": plant._gears is not None,
    }


def _of_consumer(consumer: Any, plant: Plant) -> dict[str, Any]:
    own, table, n = consumer.servos, plant.model.servos, plant.n
    model, load = consumer.model, consumer.model.payload
    heard = getattr(consumer, "settings", None)
    return {
        **({} if heard is None else {"delay": heard.delay}),
        "kp": _chain(own.kp, n) / table.kp,
        "friction": _over(_chain(own.friction, n), table.friction),
        "damping": _over(_damping(own, n), _damping(table, n)),
        "torque": _chain(own.max_torque, n) / table.max_torque,
        "payload": 0.0 if load is None else load.mass,
        "reach": _over(
            np.subtract(model.upper, model.lower),
            np.subtract(plant.model.upper, plant.model.lower),
        ),
        "gears": bool(np.any(_chain(own.load_friction, n) > table.load_friction)),
    }


def _chain(column: ArrayLike, n: int) -> np.ndarray:
    """Return the first n entries, those of the chain's joints; an arm's table has grippers too."""
    values = np.asarray(column, dtype=float)
    return values[:n] if values.size > n else np.broadcast_to(values, n)


def _over(one: ArrayLike, other: ArrayLike) -> np.ndarray:
    """Return `one` over `other`; 1 for equal values, also for 0 and 0 or two infinities."""
    one, other = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    ratio = np.ones(np.broadcast_shapes(one.shape, other.shape))
    return np.divide(one, other, out=ratio, where=(one != other) & (other != 0.0))


def _damping(table: pliant.Servos, n: int) -> np.ndarray:
    """Return the sum of gear damping and back-EMF (n,) [N·m·s/rad]."""
    total = _chain(table.damping, n)
    if table.limit_type == "pwm" and table.no_load_speed is not None:
        total = total + _chain(table.max_torque, n) / _chain(table.no_load_speed, n)
    return total


def _mass(plant: Plant) -> float:
    """Return the mass of the robot with its load [kg], without the scene."""
    model, body = plant.mj_model, plant.ground_truth.frame("tool").body
    while model.body_parentid[body]:
        body = model.body_parentid[body]
    return float(model.body_subtreemass[body])


def _recorded(cls: type, made: list[Any]) -> Any:
    """Return an `__init__` for `cls` that appends each new object to `made`."""
    init = cls.__init__

    @functools.wraps(init)
    def recording(self: Any, *args: Any, **options: Any) -> None:
        init(self, *args, **options)
        made.append(self)

    return recording


def _recorder(made: list[Any]) -> type:
    """Return a stand-in for the class `Controller` that appends each new object to `made`.

    It is needed because the `__init__` of a compiled class cannot be replaced.
    """
    compiled = pliant.Controller

    class Meta(type):
        def __instancecheck__(cls, instance: object) -> bool:
            return isinstance(instance, compiled)

    class Controller(metaclass=Meta):
        def __new__(cls, *args: Any, **options: Any) -> pliant.Controller:
            made.append(compiled(*args, **options))
            return made[-1]

    return Controller
