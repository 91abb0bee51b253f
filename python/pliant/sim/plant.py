"""A simulated arm with the interface of a real one.

`read()` returns the reading of the bus, `write()` takes goals and torque limits, `advance()` runs
the physics of one control period.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from pliant._core import ConfigError, Model, PliantError, ShapeError
from pliant._validation import format_value, instance, number
from pliant.drive import State
from pliant.sim import _checks as checks
from pliant.sim._bus import Bus, Command
from pliant.sim._model_builder import build_spec, last_moving
from pliant.sim._mujoco import mujoco
from pliant.sim._parameters import resolve, tabulate
from pliant.sim._servos import ServoBank, check_overload
from pliant.sim.friction import Friction, Gears
from pliant.sim.ground_truth import TOOL, WRIST, GroundTruth
from pliant.sim.hand import AppliedForce

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike

    from pliant._core import Servos
    from pliant._typing import Array, Mask
    from pliant.sim._model_builder import Build, OffChain, Robot
    from pliant.sim._servos import Overload
    from pliant.sim.hand import Hand


class Fixture(Protocol):
    """Scene object with bodies in the physics model, such as a door.

    Hands and walls have no bodies: they only exert forces. A subclass overrides only the methods
    that it needs.
    """

    def add(self, build_spec: Build) -> None:
        """Add bodies and constraints before the model is compiled."""

    def place(self, plant: Plant) -> None:
        """Place all bodies at a reset, relative to the tool."""

    def before(self, plant: Plant) -> None:
        """Prepare each physics step, e.g. prescribed motion."""
        return

    def during(self, plant: Plant) -> None:
        """Apply external forces (`mj_data.qfrc_applied`), with positions up to date."""
        return

    def after(self, plant: Plant) -> None:
        """Record results after each physics step."""
        return


class Plant:
    """A simulated arm with torque-limited position servos and imperfections of servos and bus.

    A servo is ``clip(kp (goal - q) - kv dq, ±limit)``. Gear friction, damping and back-EMF act
    outside the limit, so a limit of 0 does not make a joint free. The limit holds in every physics
    step. A command holds until the next one arrives.

    Args:
        model: The robot; the world frame is its base frame.
        servos: Servo table; default the model's own, or a guess from its efforts.
        extra_servos: Servos of off-chain joints by joint name, one entry each; default a guess from
            their efforts.
        dt: Physics step [s].
        rate: Control rate [Hz]; a period must be a whole number of physics steps.
        delay: Ticks from sampling to read(), and from write() to the servo.
        encoder_step: Encoder count [rad]; readings and goals are rounded to it.
        encoder_flicker: Counts by which readings toggle at random.
        noise: Standard deviation of the readings before rounding [rad].
        deadband: Error below which a servo gives no torque [rad]; above it, the error counts from
            the edge of the band.
        read_loss: Share of readings lost.
        write_loss: Share of writes lost.
        bus_outage: Start and end of an outage of the bus in both directions [s].
        kp_scale: Ratio of true to tabulated stiffness, scalar or (n,).
        friction_scale: Ratio of true to tabulated friction.
        damping_scale: Ratio of true to tabulated damping, gears and back-EMF.
        payload: Mass [kg] and centre (3,) in the tool frame [m] of a load unknown to the
            controller.
        overload: Overload protection of the servos; None: no protection.
        friction: Dry friction of the gears: `coulomb`, as in the table, or by speed and load.
        friction_creep: Creep of a joint that dry friction should hold, in [0.001, 1]: its speed is
            about 1 ms · friction_creep · torque / inertia. 1 is MuJoCo's own, 0.1 closer to real
            gears.
        off_chain: `held` gives a gripper servos of its own, `welded` freezes it.
        scene: Hands, walls and fixtures (doors).
        seed: Seed of all random sources; equal seeds give equal runs.

    Attributes:
        model: The robot.
        n: Joints of the chain.
        rate, period, dt: Control rate [Hz], control period and physics step [s].
        steps: Physics steps per period.
        gains: The true servo parameters.
        table: The servo table (n,), as a controller may assume it.
        extra_tables: Servo table of each off-chain joint that has a servo, one entry each.
        tabulated: Parameters of `table`, without `kp_scale` and the other scales.
        write_delay: From write() to the servos [s].
        hands: Record of each hand, in the order of the scene.
        mj_model, mj_data, spec: MuJoCo's own objects, for pictures and pages.

    Raises:
        ConfigError: An argument is out of range; the message names it.
        OutOfRangeError: `friction_creep` is outside its range.
        ShapeError: An argument is neither a scalar nor of length n.
        TypeError: Model, servos, overload or an item of the scene has the wrong type.

    Example:
        >>> plant = Plant(pliant.robots.arm7(), rate=100.0)
        >>> plant.reset(q_start)
        >>> for _ in range(500):
        ...     command = controller.step(plant.read().q, target)
        ...     plant.write(command.goal, command.torque_limit)
        ...     plant.advance()
    """

    def __init__(
        self,
        model: Robot,
        servos: Any | None = None,
        *,
        extra_servos: Mapping[str, Servos] | None = None,
        dt: float = 0.001,
        rate: float = 100.0,
        delay: tuple[int, int] = (0, 0),
        encoder_step: ArrayLike = 0.0,
        encoder_flicker: int = 0,
        noise: ArrayLike = 0.0,
        deadband: ArrayLike = 0.0,
        read_loss: float = 0.0,
        write_loss: float = 0.0,
        bus_outage: tuple[float, float] | None = None,
        kp_scale: ArrayLike = 1.0,
        friction_scale: ArrayLike = 1.0,
        damping_scale: ArrayLike = 1.0,
        payload: tuple[float, Sequence[float]] | None = None,
        overload: Overload | None = None,
        friction: Literal["coulomb"] | Friction = "coulomb",
        friction_creep: float = 1.0,
        off_chain: OffChain = "held",
        scene: Iterable[Hand | Fixture] = (),
        seed: int = 0,
    ) -> None:
        """Build the arm; until reset it stands in the middle of its joint ranges."""
        n = self.n = int(instance(model, Model, "model").n)
        self.steps = checks.physics_steps(dt, rate)
        self.model, self.dt, self.rate = model, float(dt), float(rate)
        self.period = 1.0 / self.rate
        if off_chain not in {"held", "welded"}:
            value = format_value(off_chain)
            raise ConfigError(f"off_chain is 'held' or 'welded', got {value}")
        self.table = tabulate(model, servos)
        self.tabulated = resolve(self.table)
        self.gains = self.tabulated.scaled(kp_scale, friction_scale, damping_scale)
        self._bus = Bus(
            n,
            delay=delay,
            encoder_step=encoder_step,
            encoder_flicker=encoder_flicker,
            noise=noise,
            read_loss=read_loss,
            write_loss=write_loss,
            bus_outage=bus_outage,
            seed=seed,
        )
        self.write_delay = self._bus.write_delay * self.period
        hands, self._fixtures = _split_scene(scene)
        built = build_spec(
            model,
            self.gains,
            dt=self.dt,
            off_chain=off_chain,
            payload=checks.load(payload),
            # In MuJoCo a joint held by dry friction always creeps.
            creep=number(friction_creep, "friction_creep", 1e-3, 1.0),
            extra=checks.extra(model, extra_servos),
        )
        self.extra_tables = {name: built.extra[name] for name in built.held}
        for fixture in self._fixtures:
            fixture.add(built)
        self.spec = built.spec
        try:
            self.mj_model: mujoco.MjModel = built.spec.compile()
        except ValueError as error:
            name = built.spec.modelname
            raise ConfigError(f"MuJoCo refuses the model {name!r}: {error}") from error
        self.mj_data = mujoco.MjData(self.mj_model)
        self._bank = ServoBank(
            built,
            self.mj_model,
            self.mj_data,
            self.gains,
            deadband=checks.per_joint(deadband, n, "deadband", low=0.0),
            overload=check_overload(overload),
        )
        self._gears = self._make_gears(friction)
        names = {TOOL: model.tip, WRIST: last_moving(model)}
        self.ground_truth = GroundTruth(self.mj_model, self.mj_data, names)
        self._tool, self._wrist = self.ground_truth.frame(TOOL), self.ground_truth.frame(WRIST)
        self.set_hands(hands)
        lower, upper = np.asarray(model.lower), np.asarray(model.upper)
        finite = np.isfinite(lower) & np.isfinite(upper)
        self.reset(np.where(finite, (np.where(finite, lower, 0) + upper) / 2, 0.0))

    @property
    def sent(self) -> Command:
        """Last order sent: goals (n,) [rad] and limits (n,) [N·m]."""
        return self._bus.sent

    def read(self) -> State:
        """Return the reading of this tick: delayed, rounded, repeated if lost."""
        return self._bus.state

    def write(
        self,
        goal: ArrayLike,
        limit: ArrayLike | None = None,
        extra: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        """Send goals and torque limits; they reach the servos after the write delay.

        Args:
            goal: Joint goals (n,) [rad].
            limit: Torque limits (n,) [N·m], symmetric, at least 0, cut at the usable torque; None
                keeps the last limits.
            extra: Goal [rad] and limit [N·m] of off-chain joints by name.

        Raises:
            ShapeError: A vector does not have n entries. Nothing is sent.
            ConfigError: A value is not finite, a limit is negative, or a joint is unknown. Nothing
                is sent.
        """
        goal = self._vector(goal, "goal")
        limit = self._bus.sent.limit if limit is None else self._vector(limit, "limit")
        if np.any(limit < 0.0):
            raise ConfigError(f"limit must be at least 0 N·m, got {limit.min():g}")
        pairs = dict(self._bus.sent.extra)
        for name, pair in (extra or {}).items():
            if name not in self._bank.held:
                known = ", ".join(self._bank.held) or "none"
                raise ConfigError(f"no off-chain joint {name!r} to write to; there are: {known}")
            angle, max_limit = (float(v) for v in pair)
            if not (np.isfinite(angle) and max_limit >= 0.0):
                raise ConfigError(f"extra[{name!r}] is a goal and a limit >= 0, got {pair!r}")
            pairs[name] = (angle, min(max_limit, self._bank.held[name][1]))
        self._bus.send(Command(goal, np.minimum(limit, self.gains.torque), pairs))

    def advance(self, n_steps: int | None = None) -> None:
        """Run the physics for one control period, or `n_steps` physics steps, and sample.

        Every call is one tick of the bus, whatever its duration.

        Raises:
            PliantError: The physics diverged.
        """
        steps = self.steps if n_steps is None else int(n_steps)
        self._bank.apply(self._bus.deliver(self.time), self.period)
        for record in self.hands:
            record.begin()
        if self._is_passive():
            mujoco.mj_step(self.mj_model, self.mj_data, steps)
            self._bank.count()
        else:
            for _ in range(steps):
                self._step()
        self._bank.close()
        for record in self.hands:
            record.end(steps)
        if not np.isfinite(self.mj_data.qpos).all():
            raise PliantError(
                f"the simulation diverged at t = {self.time:.3f} s with dt {self.dt:g} s"
            )
        self._forward()
        self._bus.sample(self.q, self._bank.angles(), self.time)

    def reset(self, q: ArrayLike) -> State:
        """Put the arm at rest: goals at q, limits at the usable torque, time at 0.

        Doors and walls are placed relative to the tool of this pose; all random sources restart.

        Args:
            q: Joint positions (n,) [rad].

        Returns:
            The first reading.

        Raises:
            ShapeError: q does not have n entries.
            ConfigError: q is not finite.
        """
        q = self._vector(q, "q")
        mujoco.mj_resetData(self.mj_model, self.mj_data)
        first = Command(q, self.gains.torque.copy(), dict(self._bank.held))
        self._bank.reset(q)
        self._bank.apply(first, self.period)
        self._forward()
        for fixture in self._fixtures:
            fixture.place(self)
        self._forward()
        self.ground_truth.remember()
        self.set_hands(record.hand for record in self.hands)
        self._bus.reset(first, self._bank.angles())
        self._bus.sample(self.q, self._bank.angles(), 0.0)
        return self.read()

    @property
    def q(self) -> Array:
        """True joint positions (n,) [rad]."""
        return self._bank.q

    @property
    def dq(self) -> Array:
        """True joint velocities (n,) [rad/s]."""
        return self._bank.dq

    @property
    def torque(self) -> Array:
        """Mean torque of the servos over the last period (n,) [N·m], inside their limits."""
        return self._bank.torque.copy()

    @property
    def tripped(self) -> Mask:
        """Mask of the servos that have cut their torque by overload (n,)."""
        return self._bank.tripped

    @property
    def tool(self) -> Array:
        """True pose of the tool in base axes (4, 4)."""
        return self._tool.pose

    @property
    def wrist(self) -> Array:
        """True position of the wrist centre, the origin of the last moving link (3,) [m]."""
        return self._wrist.position.copy()

    @property
    def time(self) -> float:
        """Time since reset [s]."""
        return float(self.mj_data.time)

    @property
    def fixtures(self) -> tuple[Fixture, ...]:
        """The doors and other bodies of the scene, in the order given."""
        return tuple(self._fixtures)

    @property
    def friction(self) -> Array:
        """Largest dry friction of the joints in this state (n,) [N·m]."""
        if self._gears is None:
            return self.gains.friction.copy()
        return self._gears.update()

    def set_hands(self, hands: Iterable[Hand]) -> None:
        """Replace hands and walls; their records start empty."""
        self.hands = [AppliedForce(hand) for hand in hands]
        for record in self.hands:
            self.ground_truth.frame(record.hand.at)

    def pull(self, body: int, force: Array, torque: Array, point: Array) -> None:
        """Add a force and a torque at a world point to a body, for this physics step."""
        applied = self.mj_data.qfrc_applied
        mujoco.mj_applyFT(self.mj_model, self.mj_data, force, torque, point, body, applied)

    def _make_gears(self, friction: Literal["coulomb"] | Friction) -> Gears | None:
        """Return the object that sets the friction of the joints, None if friction is constant."""
        if isinstance(friction, Friction):
            dof, servo = self._bank.addresses
            return Gears(self.mj_model, self.mj_data, friction, dof, servo)
        if friction != "coulomb":
            raise ConfigError(f"friction is 'coulomb' or a sim.Friction, got {friction!r}")
        return None

    def _is_passive(self) -> bool:
        """Return True if MuJoCo can run a whole period without Python between the steps.

        `torque` is then the torque of the period's last step.
        """
        scene = bool(self._fixtures) and all(getattr(f, "passive", False) for f in self._fixtures)
        return scene and not (self.hands or self._bank.needs_drive or self._gears)

    def _step(self) -> None:
        """Run one physics step: servos, positions, external forces at these positions, motion."""
        data = self.mj_data
        self._bank.drive()
        if self._gears is not None:
            self._gears.update()
        for fixture in self._fixtures:
            fixture.before(self)
        mujoco.mj_step1(self.mj_model, data)
        data.qfrc_applied[:] = 0.0
        for record in self.hands:
            force, torque, point = record.hand.force(self.ground_truth, data.time)
            self.pull(self.ground_truth.frame(record.hand.at).body, force, torque, point)
            record.add(force, torque)
        for fixture in self._fixtures:
            fixture.during(self)
        mujoco.mj_step2(self.mj_model, data)
        self._bank.count()
        for fixture in self._fixtures:
            fixture.after(self)

    def _forward(self) -> None:
        """Update the frames to the present joint positions."""
        mujoco.mj_kinematics(self.mj_model, self.mj_data)
        mujoco.mj_comPos(self.mj_model, self.mj_data)

    def _vector(self, value: ArrayLike, name: str) -> Array:
        """Check a joint vector."""
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise ShapeError(
                f"{name} must be {self.n} numbers, got {format_value(value)}"
            ) from None
        if array.shape != (self.n,):
            raise ShapeError(f"{name} has shape {array.shape}, expected ({self.n},)")
        if not np.isfinite(array).all():
            raise ConfigError(f"{name} is not finite: {array.tolist()}")
        return array


def _split_scene(scene: Iterable[Hand | Fixture]) -> tuple[list[Hand], list[Fixture]]:
    """Separate hands (force laws) from fixtures (things with bodies).

    Raises:
        TypeError: `scene` is not iterable, or an item is neither a hand nor a fixture.
    """
    hands: list[Hand] = []
    fixtures: list[Fixture] = []
    try:
        items: list[Any] = list(scene)
    except TypeError:
        raise TypeError(
            f"scene must be a list of hands and fixtures, got {format_value(scene)}"
        ) from None
    for i, item in enumerate(items):
        if hasattr(item, "add"):
            fixtures.append(item)
        elif hasattr(item, "at"):
            hands.append(item)
        else:
            known = "a hand (Drag, Push, Wall …) nor a fixture (door(), Surface …) of pliant.sim"
            raise TypeError(f"scene[{i}] is neither {known}, got {format_value(item)}")
    return hands, fixtures
