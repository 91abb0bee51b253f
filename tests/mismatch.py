"""Plant-model mismatch: a test states true and assumed parameters, which are then verified.

A test of wrong assumptions states both sets of parameters; equal sets are rejected. At the end of
the `with` block, all plants, controllers and arms created in it are compared with the statement. An
experiment that passes the plant's true parameters to the controller therefore fails:

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

#: Stands for a random value of a parameter: the value need only differ from the other side's.
RANDOM = float("nan")
#: Relative and absolute difference below which two numbers are equal.
TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Parameters of one side of a mismatch: of the plant, or as the controller assumes them.

    Attributes:
        kp, friction, damping, torque: Ratios to the robot's servo table, scalars or (n,). Damping
            is the sum of gear damping and back-EMF.
        payload: Mass at the tool [kg].
        delay: Sum of the delays from the sensor to the controller and from a write to the servo
            [s]; on the assumed side it is compared only in controllers.
        reach: Ratio of the joint ranges to those of the plant's model, scalar or (n,).
        gears: Friction model by speed and load that replaces the friction of the servo table;
            None: constant friction.
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
    return not np.allclose(first, second, rtol=TOLERANCE, atol=TOLERANCE)


def under(conditions: Conditions) -> Mismatch:
    """Return the mismatch that `conditions` state, for a `with` block.

    Raises:
        AssertionError: Plant and assumptions are equal.
    """
    delay = sum(conditions.delay) / conditions.rate
    plant = Parameters(delay=delay, gears=conditions.gears)
    ratio = conditions.assumed_ratio
    gears = conditions.gears if conditions.gears_known else None
    assumed = Parameters(delay=delay, friction=ratio, damping=ratio, gears=gears)
    return Mismatch(plant=plant, assumed=assumed)


class Mismatch:
    """Context manager that compares plants and controllers created in its block with the statement.

    Attributes:
        plant, assumed: Parameters of the two sides.
        plants: Plants created in the block.
        consumers: Controllers, arms, identifications and hand guidings created in the block.
    """

    def __init__(
        self, *, plant: Parameters, assumed: Parameters, compared: tuple[str, ...] = NUMBERS
    ) -> None:
        """State the parameters of both sides; `compared` names those to compare in the end.

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
        """Return a plant with the stated parameters, and with `options` of `Plant`."""
        side = self.plant
        if side.payload:
            options.setdefault("payload", (side.payload, (0.0, 0.0, 0.0)))
        if side.gears is not None:
            options["friction"] = side.gears
        new_plant = Plant(
            model,
            servos,
            kp_scale=side.kp,
            friction_scale=side.friction,
            damping_scale=side.damping,
            **options,
        )
        self.plants.append(new_plant)
        return new_plant

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
        """Start to record all plants, controllers, arms and other consumers that are created."""
        for cls, objects in (
            (Plant, self.plants),
            (Arm, self.consumers),
            (Excitation, self.consumers),
        ):
            self._stack.enter_context(patch.object(cls, "__init__", _recorded(cls, objects)))
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
        self, owner: Any, actual: dict[str, Any], stated: Parameters, other: Parameters
    ) -> None:
        name = type(owner).__name__
        for field in self.compared:
            if field not in actual or (field == "friction" and self.plant.gears is not None):
                continue
            value, expected = actual[field], getattr(stated, field)
            if np.isnan(expected).any():
                assert differs(value, getattr(other, field)), f"{name}: {field} is the other side's"
            else:
                message = f"{name}: {field} is {value}, stated is {expected}"
                assert not differs(value, expected), message
        value, expected = actual["gears"], stated.gears is not None
        assert value == expected, f"{name}: friction by speed and load is {value}, not {expected}"


def _of_plant(plant: Plant) -> dict[str, Any]:
    gains, table = plant.gains, plant.model.servos
    return {
        "kp": gains.kp / table.kp,
        "friction": _ratio(gains.friction, table.friction),
        "damping": _ratio(gains.damping, _damping(table, plant.n)),
        "torque": gains.torque / table.max_torque,
        "payload": _mass(plant) - _mass(Plant(plant.model)),
        "delay": sum(plant._bus._delay) * plant.period,
        "reach": 1.0,
        "gears": plant._gears is not None,
    }


def _of_consumer(consumer: Any, plant: Plant) -> dict[str, Any]:
    # Torque on replaces `Arm.servos` by measured ones.
    assumed = consumer._io.servos if isinstance(consumer, Arm) else consumer.servos
    table, n = plant.model.servos, plant.n
    model, load = consumer.model, consumer.model.payload
    settings = getattr(consumer, "settings", None)
    return {
        **({} if settings is None else {"delay": settings.delay}),
        "kp": _chain(assumed.kp, n) / table.kp,
        "friction": _ratio(_chain(assumed.friction, n), table.friction),
        "damping": _ratio(_damping(assumed, n), _damping(table, n)),
        "torque": _chain(assumed.max_torque, n) / table.max_torque,
        "payload": 0.0 if load is None else load.mass,
        "reach": _ratio(
            np.subtract(model.upper, model.lower),
            np.subtract(plant.model.upper, plant.model.lower),
        ),
        "gears": bool(np.any(_chain(assumed.load_friction, n) > table.load_friction)),
    }


def _chain(column: ArrayLike, n: int) -> np.ndarray:
    """Return the first n entries of a column: those after the joints belong to grippers."""
    values = np.asarray(column, dtype=float)
    return values[:n] if values.size > n else np.broadcast_to(values, n)


def _ratio(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Return a / b; 1 where a and b are equal (also both 0 or infinite) and where b is 0."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    ratio = np.ones(np.broadcast_shapes(a.shape, b.shape))
    return np.divide(a, b, out=ratio, where=(a != b) & (b != 0.0))


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


def _recorded(cls: type, objects: list[Any]) -> Any:
    """Return an `__init__` for `cls` that appends each new object to `objects`."""
    init = cls.__init__

    @functools.wraps(init)
    def recording(self: Any, *args: Any, **options: Any) -> None:
        init(self, *args, **options)
        objects.append(self)

    return recording


def _recorder(objects: list[Any]) -> type:
    """Return a substitute for the class `Controller` that appends each new object to `objects`.

    The `__init__` of a compiled class cannot be replaced.
    """
    compiled = pliant.Controller

    class Meta(type):
        def __instancecheck__(cls, instance: object) -> bool:
            return isinstance(instance, compiled)

    class Controller(metaclass=Meta):
        def __new__(cls, *args: Any, **options: Any) -> pliant.Controller:
            objects.append(compiled(*args, **options))
            return objects[-1]

    return Controller
