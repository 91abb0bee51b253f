"""Simulated arm: `Plant` runs the MuJoCo physics of servos, bus and scene.

`read()` returns the readings of the bus, `write()` sends goals and torque limits, `advance()` runs
the physics of one control period.
"""

from __future__ import annotations

import math
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
from pliant.sim.ground_truth import TOOL, WRIST, ZERO, GroundTruth
from pliant.sim.hand import AppliedForce

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike

    from pliant._core import Servos
    from pliant._typing import Array, Mask
    from pliant.sim._model_builder import Build, OffChain
    from pliant.sim._servos import Overload
    from pliant.sim.hand import Hand


class Fixture(Protocol):
    """Interface of scene objects with bodies in the physics model, such as a door.

    Hands and walls are not fixtures: they have no bodies and only exert forces. A subclass
    overrides the methods that it needs.
    """

    def add(self, build_spec: Build) -> None:
        """Add bodies and constraints to the MuJoCo specification, before it is compiled."""

    def place(self, plant: Plant) -> None:
        """Place the bodies relative to the tool; `Plant.reset` calls this method."""

    def before(self, plant: Plant) -> None:
        """Prepare a physics step, for example by a prescribed motion of a body."""
        return

    def during(self, plant: Plant) -> None:
        """Add external forces to `mj_data.qfrc_applied` in a physics step.

        MuJoCo has computed positions and velocities of the step, but not the accelerations.
        """
        return

    def after(self, plant: Plant) -> None:
        """Record results after a physics step."""
        return


class Plant:
    """Simulated arm with torque-limited position servos and imperfections of servos and bus.

    The torque of a servo is ``clip(kp (goal - q) - kv dq, ±limit)`` [N·m]. Gear friction, damping
    and back-EMF act in addition, so a joint with limit 0 still resists motion. A command stays in
    force until the next command arrives.

    Args:
        model: The robot; the world frame is its base frame.
        servos: Servo table of the chain; by default the table of the model, or estimates from its
            effort limits.
        extra_servos: Servo tables with one entry of off-chain joints, by joint name; by default
            estimates from the joints' effort limits.
        dt: Physics step [s].
        rate: Control rate [Hz]; a period must be a whole number of physics steps.
        delay: Delays from sampling to read(), and from write() to the servo [ticks]; a tick is one
            call of advance().
        encoder_step: Angle of an encoder count [rad]; readings and goals are rounded to whole
            counts.
        encoder_flicker: Random error of a reading [counts], added or subtracted with probability
            1/4 each.
        noise: Standard deviation of white noise on the readings before rounding [rad].
        deadband: Position error below which a servo exerts no torque [rad]; a larger error is
            reduced by this amount.
        read_loss: Probability that a reading is lost.
        write_loss: Probability that a write is lost.
        bus_outage: Start and end of an outage of the bus in both directions [s].
        kp_scale: Ratio of true to tabulated stiffness, scalar or (n,).
        friction_scale: Ratio of true to tabulated friction.
        damping_scale: Ratio of true to tabulated damping, including back-EMF.
        payload: Mass [kg] and centre (3,) in the tool frame [m] of a load unknown to the
            controller.
        overload: Overload protection of the servos; None: no protection.
        friction: Dry friction of the gears: `coulomb` is the constant friction of the servo table;
            a `Friction` depends on speed and load.
        friction_creep: Creep of a joint that dry friction should hold, in [0.001, 1]: the joint
            moves at about 1 ms · friction_creep · torque / inertia. MuJoCo's default is 1; 0.1 is
            closer to real gears.
        off_chain: `held` gives each gripper joint a servo, `welded` fixes it.
        scene: Hands, walls and fixtures (doors).
        seed: Seed of all random generators; equal seeds give equal runs.

    Attributes:
        model: The robot.
        n: Number of joints of the chain.
        rate, period, dt: Control rate [Hz], control period and physics step [s].
        steps: Physics steps per control period.
        gains: True servo parameters, with `kp_scale` and the other scales.
        table: Servo table of the chain without the scales, for a controller.
        extra_tables: Servo table with one entry of each off-chain joint that has a servo, by name.
        tabulated: Servo parameters that follow from `table`, without the scales.
        write_delay: Delay from write() to the servos [s].
        hands: Record of each hand, in the order of the scene.
        mj_model, mj_data, spec: MuJoCo objects, for pictures.

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
        model: Model,
        servos: Any | None = None,
        *,
        extra_servos: Mapping[str, Servos] | None = None,
        dt: float = checks.STEP,
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
        """Build the simulation and reset it: joints in the middle of their ranges, or at 0."""
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
            # A creep of 0 is not possible: MuJoCo's friction constraint is soft.
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
        self._applied = self.mj_data.qfrc_applied
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
        """Last command sent: goals (n,) [rad] and limits (n,) [N·m]."""
        return self._bus.sent

    def read(self) -> State:
        """Return the reading that the bus delivers in this tick, delayed and rounded to counts.

        If the reading was lost, the last one is returned again.
        """
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
            limit: Torque limits (n,) [N·m], symmetric, at least 0, clipped to the usable torque;
                None keeps the last limits.
            extra: Goal [rad] and limit [N·m] of off-chain joints by name.

        Raises:
            ShapeError: A vector does not have n entries. Nothing is sent.
            ConfigError: A value is not finite, a limit is negative, or a joint is unknown. Nothing
                is sent.
        """
        goal = self._vector(goal, "goal")
        limit = self._bus.sent.limit if limit is None else self._vector(limit, "limit")
        if min(limit.tolist()) < 0.0:
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
        """Run the physics for one control period, or `n_steps` physics steps; sample the joints.

        Every call counts as one tick of the bus, independent of the number of physics steps.

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
            self._run(steps)
        self._bank.close()
        for record in self.hands:
            record.end(steps)
        if not _is_finite(self.mj_data.qpos):
            raise PliantError(
                f"the simulation diverged at t = {self.time:.3f} s with dt {self.dt:g} s"
            )
        self._forward()
        self._bus.sample(self.q, self._bank.angles(), self.time)

    def reset(self, q: ArrayLike) -> State:
        """Set the arm at rest at q, with q as goals, usable torques as limits, and time 0.

        Doors and walls are placed relative to the tool in this pose. Random generators restart.

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
        """Mean torque of the servos over the last control period (n,) [N·m], within their limits.

        In a scene with only passive fixtures it is the torque in the last physics step.
        """
        return self._bank.torque.copy()

    @property
    def tripped(self) -> Mask:
        """Mask (n,) of the servos whose overload protection has tripped."""
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
        """Doors and other fixtures of the scene, in the order given."""
        return tuple(self._fixtures)

    @property
    def friction(self) -> Array:
        """Largest dry friction of the joints in the present state (n,) [N·m]."""
        if self._gears is None:
            return self.gains.friction.copy()
        return self._gears.update()

    def set_hands(self, hands: Iterable[Hand]) -> None:
        """Replace the hands and walls of the scene; the records of their forces start empty."""
        self.hands = [AppliedForce(hand) for hand in hands]
        for record in self.hands:
            self.ground_truth.frame(record.hand.at)

    def pull(self, body: int, force: Array, torque: Array, point: Array) -> None:
        """Apply a force and a torque to a body in the present physics step.

        Args:
            body: MuJoCo's index of the body.
            force: Force (3,) in base axes [N].
            torque: Torque (3,) in base axes [N·m].
            point: Point of application (3,) in the base frame [m].
        """
        mujoco.mj_applyFT(self.mj_model, self.mj_data, force, torque, point, body, self._applied)

    def _make_gears(self, friction: Literal["coulomb"] | Friction) -> Gears | None:
        """Return the object that updates the joints' dry friction; None if friction is constant."""
        if isinstance(friction, Friction):
            dof, servo = self._bank.addresses
            return Gears(self.mj_model, self.mj_data, friction, dof, servo)
        if friction != "coulomb":
            raise ConfigError(f"friction is 'coulomb' or a sim.Friction, got {friction!r}")
        return None

    def _is_passive(self) -> bool:
        """Return True if MuJoCo can run a whole period without Python between physics steps.

        The attribute `torque` is then the torque in the last physics step, not the mean.
        """
        fixtures = self._fixtures
        has_passive_scene = bool(fixtures) and all(getattr(f, "passive", False) for f in fixtures)
        return has_passive_scene and not (self.hands or self._bank.needs_drive or self._gears)

    def _run(self, steps: int) -> None:
        """Run physics steps, including hands, fixtures, friction model and dead bands."""
        model, data, bank, truth = self.mj_model, self.mj_data, self._bank, self.ground_truth
        gears, fixtures, applied = self._gears, self._fixtures, self._applied
        if not (self.hands or fixtures or bank.needs_drive or gears):
            applied.fill(0.0)
            bank.run(steps)
            return
        # A step takes 20 µs: look names up once per period.
        step1, step2, apply = mujoco.mj_step1, mujoco.mj_step2, mujoco.mj_applyFT
        hands = [
            (record.hand.force, record.add, truth.frame(record.hand.at).body)
            for record in self.hands
        ]
        for _ in range(steps):
            if bank.needs_drive:
                bank.drive()
            if gears is not None:
                gears.update()
            for fixture in fixtures:
                fixture.before(self)
            step1(model, data)
            applied.fill(0.0)
            for act, add, body in hands:
                force, torque, point = act(truth, data.time)
                if force is ZERO and torque is ZERO:
                    continue
                apply(model, data, force, torque, point, body, applied)
                add(force, torque)
            for fixture in fixtures:
                fixture.during(self)
            step2(model, data)
            bank.count()
            for fixture in fixtures:
                fixture.after(self)

    def _forward(self) -> None:
        """Update the poses of all frames to the present joint positions."""
        mujoco.mj_kinematics(self.mj_model, self.mj_data)
        mujoco.mj_comPos(self.mj_model, self.mj_data)

    def _vector(self, value: ArrayLike, name: str) -> Array:
        """Validate a joint vector and return it as a new array (n,)."""
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise ShapeError(
                f"{name} must be {self.n} numbers, got {format_value(value)}"
            ) from None
        if array.shape != (self.n,):
            raise ShapeError(f"{name} has shape {array.shape}, expected ({self.n},)")
        if not _is_finite(array):
            raise ConfigError(f"{name} is not finite: {array.tolist()}")
        return array


def _is_finite(array: Array) -> bool:
    """Return True if all numbers are finite; for so few, Python is quicker than NumPy."""
    return all(map(math.isfinite, array.tolist()))


def _split_scene(scene: Iterable[Hand | Fixture]) -> tuple[list[Hand], list[Fixture]]:
    """Separate the hands (force laws) from the fixtures (objects with bodies).

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
            known = "a hand (Drag, Push, Wall …) nor a fixture (door(), drawer() …) of pliant.sim"
            raise TypeError(f"scene[{i}] is neither {known}, got {format_value(item)}")
    return hands, fixtures
