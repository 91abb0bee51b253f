"""A simulated arm behind the interface of a real one: read() what the bus reports, write() goals and torque limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant import ConfigError, ShapeError
from pliant.sim import spec as spec_module
from pliant.sim._mujoco import mujoco
from pliant.sim.gains import per_joint, resolve
from pliant.sim.imperfections import Encoder, Latch, Line, Overload, delays, share
from pliant.sim.state import Felt, Order, State
from pliant.sim.truth import TOOL, WRIST, Truth

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from pliant.sim.gains import Kind
    from pliant.sim.hand import Hand
    from pliant.sim.scene import Fixture

    Array = NDArray[np.float64]


class Plant:
    """A simulated arm with torque-limited position servos, their faults and the bus's.

    A servo is ``clip(kp (goal - q) - kv dq, ±limit)``; gear friction, damping and back-EMF act outside the limit, so no
    limit makes a joint free. The limit is applied in every physics step; a command holds until the next one arrives.

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
        model: spec_module.Robot,
        servos: Any | None = None,
        *,
        dt: float = 0.001,
        rate: float = 100.0,
        delay: tuple[int, int] = (0, 0),
        count: ArrayLike = 0.0,
        flicker: int = 0,
        noise: ArrayLike = 0.0,
        deadband: ArrayLike = 0.0,
        backlash: ArrayLike = 0.0,
        read_loss: float = 0.0,
        write_loss: float = 0.0,
        silent: tuple[float, float] | None = None,
        kp_scale: ArrayLike = 1.0,
        friction_scale: ArrayLike = 1.0,
        damping_scale: ArrayLike = 1.0,
        payload: tuple[float, Sequence[float]] | None = None,
        speed_limit: ArrayLike | None = None,
        kind: Kind | None = None,
        overload: Overload | None = None,
        off_chain: spec_module.OffChain = "held",
        scene: Iterable[Hand | Fixture] = (),
        seed: int = 0,
    ) -> None:
        """Build the arm; it stands in the middle of its ranges until reset.

        Args:
            model: The robot; the world frame is its base frame.
            servos: Servo table; default the model's own, or guesses from its efforts.
            dt: Physics step [s].
            rate: Control rate [Hz]; a period must be a whole number of physics steps.
            delay: Ticks from sampling to read(), and from write() to the servo.
            count: Encoder count [rad]; readings and goals are rounded to it.
            flicker: Counts by which readings toggle at random.
            noise: Standard deviation of the readings before rounding [rad].
            deadband: Error below which a servo gives no torque [rad]; beyond, it counts from the band's edge.
            backlash: Full play between gear and link [rad]; the encoder sits on the link.
            read_loss: Share of readings lost.
            write_loss: Share of writes lost.
            silent: From when to when the bus carries nothing at all [s].
            kp_scale: True over tabulated stiffness.
            friction_scale: True over tabulated friction.
            damping_scale: True over tabulated damping.
            payload: Mass [kg] and centre (3,) in the tool frame [m] of a load the controller does not know.
            speed_limit: Speed at which servos walk to their goals [rad/s], None for at once.
            kind: `current` or `duty`, overriding the table.
            overload: Self-protection of the servos, None for none.
            off_chain: `held` gives a gripper actuators of its own, `welded` freezes it.
            scene: Hands and fixtures (doors, walls).
            seed: Of all chance; equal seeds give equal runs.

        Raises:
            ConfigError, ShapeError: An argument is out of range; the message names it.
        """
        if not (np.isfinite(dt) and 0.0 < dt <= 0.01):
            raise ConfigError(f"dt must be in (0, 0.01] s, got {dt!r}")
        if not (np.isfinite(rate) and rate > 0.0):
            raise ConfigError(f"rate must be positive [Hz], got {rate!r}")
        self.steps = round(1.0 / (rate * dt))
        if self.steps < 1 or abs(self.steps * rate * dt - 1.0) > 1e-9:
            raise ConfigError(
                f"a control period of 1/{rate:g} s is no whole number of physics steps of {dt:g} s"
            )
        n = self.n = int(model.n)
        self.model, self.rate, self.period, self.dt = model, float(rate), 1.0 / rate, float(dt)
        self.gains = resolve(model, servos, kind).scaled(kp_scale, friction_scale, damping_scale)
        self._deadband = per_joint(deadband, n, "deadband", low=0.0)
        self._speed = (
            None if speed_limit is None else per_joint(speed_limit, n, "speed_limit", low=0.0)
        )
        self._delay = delays(delay)
        self._loss = share(read_loss, "read_loss"), share(write_loss, "write_loss")
        self._encoder_args = {"count": count, "flicker": flicker, "noise": noise}
        self._silent, self._overload, self._seed = silent, overload, seed
        play = per_joint(backlash, n, "backlash", low=0.0)

        self._fixtures = [item for item in scene if hasattr(item, "add")]
        built = spec_module.build(
            model,
            self.gains,
            dt=self.dt,
            off_chain=off_chain,
            payload=_load(payload),
            backlash=play if play.any() else None,
        )
        for fixture in self._fixtures:
            fixture.add(built)
        self.spec = built.spec
        try:
            self.mj_model: mujoco.MjModel = built.spec.compile()
        except ValueError as error:
            raise ConfigError(
                f"MuJoCo refuses the model {built.spec.modelname!r}: {error}"
            ) from error
        self.mj_data = mujoco.MjData(self.mj_model)
        self._find(built)
        self.truth = Truth(
            self.mj_model, self.mj_data, {TOOL: model.tip, WRIST: _last_moving(model)}
        )
        self._tool, self._wrist = self.truth.frame(TOOL), self.truth.frame(WRIST)
        self.set_hands(item for item in scene if not hasattr(item, "add"))
        middle = np.where(
            np.isfinite(model.lower) & np.isfinite(model.upper),
            (model.lower + model.upper) / 2,
            0.0,
        )
        self.reset(middle)

    # The bus: what hardware has too.

    def read(self) -> State:
        """Return what the bus reports in this tick: delayed, rounded, or repeated when it was lost."""
        return self._state

    def write(
        self,
        goal: ArrayLike,
        limit: ArrayLike | None = None,
        extra: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        """Send goals and torque limits; they reach the servos after the write delay and hold until the next.

        Args:
            goal: Joint goals (n,) [rad].
            limit: Torque limits (n,) [N·m], symmetric, at least 0, cut at the usable torque; None keeps the last.
            extra: Goal [rad] and limit [N·m] of off-chain joints by name.

        Raises:
            ShapeError, ConfigError: Wrong shape, not finite, a negative limit, an unknown joint. Nothing is sent.
        """
        goal = self._vector(goal, "goal")
        limit = self._sent.limit if limit is None else self._vector(limit, "limit")
        if np.any(limit < 0.0):
            raise ConfigError(f"limit must be at least 0 N·m, got {limit.min():g}")
        pairs = dict(self._sent.extra)
        for name, pair in (extra or {}).items():
            if name not in self._held:
                known = ", ".join(self._held) or "none"
                raise ConfigError(f"no off-chain joint {name!r} to write to; there are: {known}")
            angle, most = (float(v) for v in pair)
            if not (np.isfinite(angle) and most >= 0.0):
                raise ConfigError(
                    f"extra[{name!r}] must be a finite goal and a limit of at least 0, got {pair!r}"
                )
            pairs[name] = (angle, most)
        self._sent = self._pending = Order(
            self.encoder.round(goal), np.minimum(limit, self.gains.torque), pairs
        )

    def advance(self, n_steps: int | None = None) -> None:
        """Run the physics for one control period (or `n_steps` physics steps) and take the next sample.

        Raises:
            ConfigError: The physics diverged, which only a bad model does.
        """
        steps = self.steps if n_steps is None else int(n_steps)
        self._apply(self._writes.pass_on(self._pending, silent=self._is_silent()))
        self._pending = None
        torque = np.zeros(self.n)
        for felt in self.hands:
            felt.force, felt.torque = np.zeros(3), np.zeros(3)
        for _ in range(steps):
            self._step()
            torque += self.mj_data.actuator_force[self._servo]
        if not np.isfinite(self.mj_data.qpos).all():
            raise ConfigError(
                f"the simulation diverged at t = {self.time:.3f} s; try a smaller dt than {self.dt:g} s"
            )
        for felt in self.hands:
            felt.force /= steps
            felt.torque /= steps
        #: Mean torque of the servos over the last period (n,) [N·m], inside their limits.
        self.torque = torque / steps
        self._forward()
        self._sample()

    def reset(self, q: ArrayLike) -> State:
        """Put the arm at rest at q (n,) [rad], servo goals at q, limits at the usable torque, and start time at 0.

        Doors and walls are placed relative to the tool of this pose.

        Raises:
            ShapeError, ConfigError: q has the wrong shape or is not finite.
        """
        q = self._vector(q, "q")
        data = self.mj_data
        mujoco.mj_resetData(self.mj_model, data)
        data.qpos[self._qpos] = q
        for name, (joint, _, rest) in self._held.items():
            data.qpos[self.mj_model.jnt_qposadr[joint]] = rest
            self._follow(name, rest)
        streams = [np.random.default_rng(s) for s in np.random.SeedSequence(self._seed).spawn(3)]
        self.encoder = Encoder(self.n, rng=streams[0], **self._encoder_args)
        rests = {name: (rest, float(most)) for name, (_, most, rest) in self._held.items()}
        order = Order(q.copy(), self.gains.torque.copy(), rests)
        self._sent, self._pending = order, None
        self._writes: Line[Order] = Line(
            order, delay=self._delay[1], loss=self._loss[1], rng=streams[2]
        )
        self._latch = Latch(self.n, self._overload)
        self.torque = np.zeros(self.n)
        self._reference = q.copy()
        self._apply(order)
        self._forward()
        for fixture in self._fixtures:
            fixture.place(self)
        self._forward()
        self.truth.remember()
        self.set_hands(felt.hand for felt in self.hands)
        first = State(q.copy(), time=0.0, extra=self._angles())
        self._reads: Line[State] = Line(
            first, delay=self._delay[0], loss=self._loss[0], rng=streams[1]
        )
        self._sample()
        return self._state

    # The truth: what only a simulation has.

    @property
    def q(self) -> Array:
        """True joint positions (n,) [rad]."""
        q = self.mj_data.qpos[self._qpos]
        if self._play.size:
            q[self._play_of] += self.mj_data.qpos[self._play]
        return q

    @property
    def dq(self) -> Array:
        """True joint velocities (n,) [rad/s]."""
        dq = self.mj_data.qvel[self._dof]
        if self._play.size:
            dq[self._play_of] += self.mj_data.qvel[self._play_dof]
        return dq

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
    def tripped(self) -> NDArray[np.bool_]:
        """Which servos have cut their torque by overload (n,)."""
        return self._latch.tripped.copy()

    def set_hands(self, hands: Iterable[Hand]) -> None:
        """Replace the hands; their records start empty."""
        #: What each hand did, in the order given.
        self.hands = [Felt(hand) for hand in hands]

    def _step(self) -> None:
        """One physics step: inner servo, positions, outer forces at these positions, then the step itself."""
        data = self.mj_data
        self._drive()
        for fixture in self._fixtures:
            fixture.before(self)
        mujoco.mj_step1(self.mj_model, data)
        if self.hands or self._fixtures:
            data.qfrc_applied[:] = 0.0
        for felt in self.hands:
            force, torque, point = felt.hand.force(self.truth, data.time)
            self.pull(self.truth.frame(felt.hand.at).body, force, torque, point)
            felt.force += force
            felt.torque += torque
            felt.peak_force = max(felt.peak_force, float(np.sqrt(force @ force)))
            felt.peak_torque = max(felt.peak_torque, float(np.sqrt(torque @ torque)))
        for fixture in self._fixtures:
            fixture.during(self)
        mujoco.mj_step2(self.mj_model, data)
        for fixture in self._fixtures:
            fixture.after(self)

    def pull(self, body: int, force: Array, torque: Array, point: Array) -> None:
        """Add a force and a torque at a world point to a body, for this physics step."""
        mujoco.mj_applyFT(
            self.mj_model, self.mj_data, force, torque, point, body, self.mj_data.qfrc_applied
        )

    def _drive(self) -> None:
        """What happens inside the servo between two writes: walking to the goal, dead band, play."""
        if self._speed is not None:
            most = self._speed * self.dt
            self._reference += np.clip(self._goal - self._reference, -most, most)
        elif not (self._play.size or self._dead):
            return
        else:
            self._reference = self._goal
        ctrl = self._reference.copy()
        if self._dead:
            error = ctrl - self.q
            ctrl -= np.clip(error, -self._deadband, self._deadband)
        if self._play.size:
            ctrl[self._play_of] -= self.mj_data.qpos[self._play]
        self.mj_data.ctrl[self._servo] = ctrl

    def _apply(self, order: Order) -> None:
        """Let a command take effect: limits first, so that a far goal never meets an old high limit."""
        limit = self._latch.limit(order.limit, self.torque, self.gains.torque, self.period)
        force = self.mj_model.actuator_forcerange
        force[self._servo, 0], force[self._servo, 1] = -limit, limit
        self._goal = order.goal
        self.mj_data.ctrl[self._servo] = order.goal
        for name, (goal, most) in order.extra.items():
            index = self.mj_model.actuator(name).id
            force[index] = (-most, most)
            self.mj_data.ctrl[index] = goal

    def _sample(self) -> None:
        """Take this tick's reading."""
        now = State(self.encoder.read(self.q), time=self.time, extra=self._angles())
        arrived = self._reads.pass_on(now, silent=self._is_silent())
        self._state = State(arrived.q.copy(), None, arrived.time, self._reads.fresh, arrived.extra)

    def _is_silent(self) -> bool:
        return self._silent is not None and self._silent[0] <= self.time < self._silent[1]

    def _forward(self) -> None:
        """Bring frames up to the present joint positions."""
        mujoco.mj_kinematics(self.mj_model, self.mj_data)
        mujoco.mj_comPos(self.mj_model, self.mj_data)

    def _angles(self) -> dict[str, float]:
        adr = self.mj_model.jnt_qposadr
        return {
            name: float(self.mj_data.qpos[adr[joint]]) for name, (joint, _, _) in self._held.items()
        }

    def _follow(self, driver: str, angle: float) -> None:
        """Start the followers of an off-chain joint where it puts them."""
        for joint in self.model.joints:
            if joint.mimic is not None and self.model.joints[joint.mimic.joint].name == driver:
                adr = self.mj_model.joint(joint.name).qposadr[0]
                self.mj_data.qpos[adr] = joint.mimic.offset + joint.mimic.multiplier * angle

    def _find(self, built: spec_module.Build) -> None:
        """Look up the numbers of everything in the compiled model."""
        joints = [self.mj_model.joint(name) for name in built.chain]
        self._qpos = np.array([j.qposadr[0] for j in joints])
        self._dof = np.array([j.dofadr[0] for j in joints])
        self._servo = np.array([self.mj_model.actuator(name).id for name in built.chain])
        plays = [self.mj_model.joint(name) for name in built.backlash]
        self._play = np.array([j.qposadr[0] for j in plays], dtype=int)
        self._play_dof = np.array([j.dofadr[0] for j in plays], dtype=int)
        names = [f"play:{name}" for name in built.chain]
        self._play_of = np.array([names.index(name) for name in built.backlash], dtype=int)
        self._dead = bool(self._deadband.any())
        self._held: dict[str, tuple[int, float, float]] = {}
        for name, rest in built.held.items():
            most = float(self.mj_model.actuator(name).forcerange[1])
            self._held[name] = (int(self.mj_model.joint(name).id), most, rest)

    def _vector(self, value: ArrayLike, name: str) -> Array:
        """Check a joint vector."""
        array = np.array(value, dtype=np.float64)
        if array.shape != (self.n,):
            raise ShapeError(f"{name} has shape {array.shape}, expected ({self.n},)")
        if not np.isfinite(array).all():
            raise ConfigError(f"{name} is not finite: {array.tolist()}")
        return array


def _load(payload: Any) -> tuple[float, Array] | None:
    """Check an unknown load."""
    if payload is None:
        return None
    mass, com = (payload.mass, payload.com) if hasattr(payload, "mass") else payload
    com = np.asarray(com, dtype=np.float64)
    if not (np.isfinite(mass) and mass >= 0.0) or com.shape != (3,) or not np.isfinite(com).all():
        raise ConfigError(f"payload must be a mass >= 0 kg and a centre (3,) m, got {payload!r}")
    return float(mass), com


def _last_moving(model: spec_module.Robot) -> str:
    """Name of the last link the chain moves: its origin is the wrist centre."""
    link = next(i for i, item in enumerate(model.links) if item.name == model.tip)
    while model.links[link].parent_joint is not None:
        joint = model.joints[model.links[link].parent_joint]
        if joint.q_index is not None:
            break
        link = joint.parent
    return str(model.links[link].name)
