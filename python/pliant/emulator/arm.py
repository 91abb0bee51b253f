"""Emulated arm: emulated servos on the joints of a simulated arm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, Servos
from pliant.emulator.device import Device
from pliant.emulator.emulator import Emulator
from pliant.emulator.models import find
from pliant.emulator.motion import profile_reference

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike

    from pliant._core import Model
    from pliant.emulator.hand import JointHand
    from pliant.emulator.servo import Drive, Servo
    from pliant.sim import Plant

#: Keywords of `pliant.sim.Plant` that an emulated arm rejects: they set properties of servos and
#: bus, which the emulator provides.
REJECTED = frozenset(
    [
        "servos",
        "rate",
        "delay",
        "encoder_step",
        "encoder_flicker",
        "noise",
        "read_loss",
        "write_loss",
        "bus_outage",
        "overload",
    ]
)


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Mounting of a servo on a joint: ``count = zero + sign · gear_ratio · q / step``.

    ``q`` is the joint angle [rad], ``step`` the angle of one encoder count [rad].

    Attributes:
        joint: Name of the joint, on or off the chain (a gripper).
        model: Servo model.
        id: Id on the bus.
        sign: 1, or -1 if counts fall as the joint angle rises.
        zero: Count at joint angle 0; by default the middle of the servo's range.
        gear_ratio: Turns of the servo per turn of the joint.
        secondary: Id and sign of a second servo of the same model on the same joint.
        port: Port of the servo.
        registers: EEPROM values that differ from the factory values.
        kp: Stiffness of the joint [N·m/rad] with the value `gain` of the servo's gain register and
            the supply voltage `voltage` [V]; with another gain or voltage it changes as that of the
            model. None: the stiffness of the model.
        gain, voltage: Gain and voltage at which `kp` holds; None: those when the servo is new.
        friction: Dry friction of the joint [N·m]; None: that of the servo model.
        damping: Viscous damping of the gears, at the joint [N·m·s/rad]; None: that of the model.
    """

    joint: str
    model: str
    id: int
    sign: int = 1
    zero: int | None = None
    gear_ratio: float = 1.0
    secondary: tuple[int, int] | None = None
    port: str = "main"
    registers: Mapping[str, int] = field(default_factory=dict)
    kp: float | None = None
    gain: int | None = None
    voltage: float | None = None
    friction: float | None = None
    damping: float | None = None

    def __post_init__(self) -> None:
        """Raise `ConfigError` if a sign, the gear ratio or a servo parameter is out of range."""
        for sign in (self.sign, self.secondary[1] if self.secondary else 1):
            if sign not in {-1, 1}:
                raise ConfigError(f"mount of {self.joint!r}: a sign is 1 or -1, got {sign!r}")
        if not self.gear_ratio > 0.0:
            raise ConfigError(
                f"mount of {self.joint!r}: gear_ratio must be above 0, got {self.gear_ratio!r}"
            )

        for name in ("kp", "gain", "voltage", "friction", "damping"):
            value = getattr(self, name)
            is_positive = name in {"kp", "gain", "voltage"}
            if value is not None and not (value > 0.0 if is_positive else value >= 0.0):
                bound = "above 0" if is_positive else "at least 0"
                raise ConfigError(f"mount of {self.joint!r}: {name} must be {bound}, got {value!r}")

    @property
    def ids(self) -> list[tuple[int, int]]:
        """Id and sign of each servo of this mount."""
        return [(self.id, self.sign), *([self.secondary] if self.secondary else [])]

    def devices(self) -> list[Device]:
        """Return the emulated servos of this mount: one, or two with `secondary`."""
        return [Device(self.model, id, port=self.port, **self.registers) for id, _ in self.ids]


@dataclass(slots=True)
class Coupling:
    """Connection of an emulated servo to its joint: shaft angle = ``offset + ratio · q``.

    Attributes:
        servo: The servo.
        ratio: Shaft angle per joint angle q.
        offset: Shaft angle at joint angle 0 [rad].
        reference: Goal angle of the servo's velocity profile [rad]; None for a motor without power.
        share: Share of the joint's torque that this servo exerts, 0 to 1.
        slope: Present torque loss per speed (back-EMF) [N·m·s/rad].
        damping: Viscous damping of the servo's gears, at its shaft [N·m·s/rad].
    """

    servo: Servo
    ratio: float
    offset: float
    reference: float | None = None
    share: float = 0.0
    slope: float = 0.0
    damping: float = 0.0


class ArmPhysics:
    """Physics of the emulated servos of an arm, computed by a `pliant.sim.Plant`.

    Stiffness and damping of the joints follow the servos' registers at every call of `step`.
    Friction of the chain, scene and payload come from the plant. A joint with torque off moves
    freely, without back-EMF. Servos on one joint share its torque in proportion to their torque
    limits.

    Attributes:
        plant: The simulated arm.
        dt: Physics step of the plant [s].
    """

    def __init__(self, plant: Plant, mounts: Sequence[Mount], *, held: bool = False) -> None:
        """Connect the mounts to the plant.

        Args:
            plant: The simulated arm, in its initial pose.
            mounts: A servo for every joint of the chain.
            held: True: the arm is held until all joints of the chain have torque.

        Raises:
            ConfigError: A joint is unknown, has two mounts, or a chain joint has none.
        """
        self.plant, self.mounts, self.dt, self._held = plant, list(mounts), plant.dt, held
        self._chain = list(plant.model.joint_names)
        self._extra = [name for name in plant.read().extra if name not in self._chain]
        names = [mount.joint for mount in self.mounts]
        for name in names:
            if name not in self._chain + self._extra or names.count(name) > 1:
                what = "twice" if names.count(name) > 1 else "but there is no such joint"
                known = ", ".join(self._chain + self._extra)
                raise ConfigError(f"joint {name!r} is mounted, {what}; the arm has {known}")
        missing = [name for name in self._chain if name not in names]
        if missing:
            raise ConfigError(f"no servo is mounted on {', '.join(missing)}")

    def bind(self, servos: Sequence[Servo]) -> None:
        """Connect the servos, in the order of the mounts; set their shafts to the arm's pose."""
        self._joints: dict[str, list[Coupling]] = {}
        # MuJoCo's indices of position, speed and actuator of each joint: a look-up by name is slow.
        model = self.plant.mj_model
        self._addresses = {
            mount.joint: (
                int(model.joint(mount.joint).qposadr[0]),
                int(model.joint(mount.joint).dofadr[0]),
                int(model.actuator(mount.joint).id),
            )
            for mount in self.mounts
        }
        rest = iter(servos)
        for mount in self.mounts:
            couplings = []
            for _, sign in mount.ids:
                servo = next(rest)
                zero = (servo.model.max_position + 1) // 2 if mount.zero is None else mount.zero
                ratio = sign * servo.direction * mount.gear_ratio
                damping = servo.model.motor.damping
                couplings.append(Coupling(servo, ratio, servo.angle_of(zero), damping=damping))
            self._joints[mount.joint] = couplings
            self._apply_mount(mount, couplings)
        self._set_inertia()
        self._update_shafts()

    def _apply_mount(self, mount: Mount, couplings: list[Coupling]) -> None:
        """Give the servos of a joint the stiffness, damping and friction of its mount."""
        if mount.kp is not None:
            nominal = 0.0
            for coupling in couplings:
                servo = coupling.servo
                gain = servo.get(servo.gain_register) if mount.gain is None else mount.gain
                volts = servo.supply if mount.voltage is None else mount.voltage
                nominal += servo.model_stiffness(gain, volts) * coupling.ratio**2
            for coupling in couplings:
                coupling.servo.stiffness_scale = mount.kp / nominal
        if mount.damping is not None:
            share = mount.damping / len(couplings)
            for coupling in couplings:
                coupling.damping = share / coupling.ratio**2
        if mount.friction is not None and mount.joint not in self._chain:
            _, dof, _ = self._addresses[mount.joint]
            self.plant.mj_model.dof_frictionloss[dof] = mount.friction

    def _set_inertia(self) -> None:
        """Set the load inertia of each servo from the inertia of the arm in its present pose.

        Current-controlled servos compute their damping from it.
        """
        from pliant.sim._mujoco import mujoco

        model, data = self.plant.mj_model, self.plant.mj_data
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        for name, couplings in self._joints.items():
            dof = model.joint(name).dofadr[0]
            for coupling in couplings:
                rotor = coupling.servo.model.motor.inertia
                inertia = float(full[dof, dof]) / len(couplings) / coupling.ratio**2
                coupling.servo.load.inertia = max(inertia - rotor, 0.0)

    def step(self, count: int) -> None:
        """Apply the servos' motor requests to the plant, and run `count` physics steps.

        Afterwards, copy the new angles, speeds and torques of the joints to the servos' shafts.
        """
        goals, limits = self.plant.q, np.zeros(self.plant.n)
        extra: dict[str, tuple[float, float]] = {}
        if self._held and not self._all_powered():
            self._update_shafts()
            return
        self._held = False
        for name, couplings in self._joints.items():
            drives = [coupling.servo.drive() for coupling in couplings]
            goal, limit = self._combine(name, couplings, drives, count * self.dt)
            if name in self._chain:
                goals[self._chain.index(name)] = goal
                limits[self._chain.index(name)] = limit
            else:
                extra[name] = (goal, limit)
        self.plant.write(goals, limits, extra)
        self.plant.advance(count)
        self._update_shafts()

    def _all_powered(self) -> bool:
        """Return True if every joint of the chain has torque."""
        return all(
            drive.goal is not None and drive.ceiling > 0.0
            for name in self._chain
            for drive in (coupling.servo.drive() for coupling in self._joints[name])
        )

    def _combine(
        self, name: str, couplings: list[Coupling], drives: list[Drive], seconds: float
    ) -> tuple[float, float]:
        """Set stiffness and damping of a joint; return its goal [rad] and torque limit [N·m].

        Args:
            name: Joint name.
            couplings: Connections of the joint to its servos.
            drives: Motor request of each of these servos.
            seconds: Duration of the step [s].
        """
        stiffness = damping = goal_torque = kv = limit = 0.0
        for coupling, drive in zip(couplings, drives, strict=True):
            square = coupling.ratio**2
            damping += (coupling.damping + drive.slope) * square
            coupling.reference = profile_reference(
                drive, coupling.reference, coupling.servo.shaft.angle, seconds
            )
            if coupling.reference is None:
                continue
            stiffness += drive.stiffness * square
            kv += drive.kv * square
            limit += drive.ceiling * abs(coupling.ratio)
            goal_torque += (
                drive.stiffness * square * (coupling.reference - coupling.offset) / coupling.ratio
            )
        model, (position, dof, actuator) = self.plant.mj_model, self._addresses[name]
        model.dof_damping[dof] = damping
        model.actuator_gainprm[actuator, 0] = stiffness
        model.actuator_biasprm[actuator, 1:3] = -stiffness, -kv
        total = sum(drive.ceiling for drive in drives)
        for coupling, drive in zip(couplings, drives, strict=True):
            coupling.share = drive.ceiling / total if total > 0.0 else 0.0
            coupling.slope = drive.slope
        if stiffness > 0.0:
            return goal_torque / stiffness, limit
        return float(self.plant.mj_data.qpos[position]), limit

    def _update_shafts(self) -> None:
        """Convert angle, speed and torque of the joints, and store them in the servos' shafts."""
        plant, data = self.plant, self.plant.mj_data
        q, dq, torque = plant.q, plant.dq, plant.torque
        for name, couplings in self._joints.items():
            if name in self._chain:
                i = self._chain.index(name)
                angle, speed, effort = float(q[i]), float(dq[i]), float(torque[i])
            else:
                at, dof, actuator = self._addresses[name]
                angle, speed = float(data.qpos[at]), float(data.qvel[dof])
                effort = float(data.actuator_force[actuator])
            for coupling in couplings:
                shaft = coupling.servo.shaft
                shaft.angle = coupling.offset + coupling.ratio * angle
                shaft.speed = coupling.ratio * speed
                shaft.torque = coupling.share * effort / coupling.ratio
                shaft.torque -= coupling.slope * shaft.speed


class ArmEmulator(Emulator):
    """Emulator whose servos move a simulated arm; `emulate` makes one.

    Attributes:
        plant: The simulated arm, with its true state, scene and simulated hands.
    """

    def __init__(
        self, plant: Plant, mounts: Sequence[Mount], *, held: bool = False, **options: Any
    ) -> None:
        """Mount the servos on the plant; see `ArmPhysics` for `held`, `Emulator` for `options`."""
        self.plant = plant
        devices = [device for mount in mounts for device in mount.devices()]
        super().__init__(devices, physics=ArmPhysics(plant, mounts, held=held), **options)


def emulate(
    model: Model,
    mounts: Sequence[Mount],
    q: ArrayLike,
    *,
    plant: Mapping[str, Any] | None = None,
    held: bool = False,
    hand: JointHand | None = None,
    **options: Any,
) -> ArmEmulator:
    """Make an emulator whose servos move a simulated arm (needs the extra `sim`).

    Args:
        model: The robot.
        mounts: A servo for every joint of the chain, and for off-chain joints as needed.
        q: Initial joint positions (n,) [rad].
        plant: Keywords of `pliant.sim.Plant`: `scene`, `payload`, `friction`, `deadband`, `dt`, ...
            Keywords of servos and bus (`delay`, `read_loss`, ...) are rejected, because the
            emulated servos and bus take their place.
        held: True: the arm is held until all joints of the chain have torque; otherwise it falls
            from the start.
        hand: Simulated hand that moves the joints, also without torque. `held` has no effect if
            the hand holds the arm up from the start (`interval` is None).
        **options: Keywords of `Emulator`: `timing`, `faults`, `clock`, `baud`, `log`.

    Returns:
        The emulator, not yet started.

    Raises:
        ConfigError: A joint has no servo or two, or an option is not allowed here.
    """
    from pliant.sim import Plant

    keywords = dict(plant or {})
    for name in keywords:
        if name in REJECTED:
            raise ConfigError(f"{name!r} of an emulated arm comes from its servos and its bus")
    if hand is not None:
        keywords["scene"] = [*keywords.get("scene", ()), hand]
    arm = Plant(model, _servos(model, mounts), **keywords)
    arm.reset(q)
    waits = hand is None or hand.interval is not None
    return ArmEmulator(arm, mounts, held=held and waits, **options)


def _servos(model: Model, mounts: Sequence[Mount]) -> Servos:
    """Return the servo parameters of the chain: those of the mounts, else of the servo models."""
    by_joint = {mount.joint: mount for mount in mounts}
    missing = [name for name in model.joint_names if name not in by_joint]
    if missing:
        raise ConfigError(f"no servo is mounted on {', '.join(missing)}")
    torque, friction, damping, armature = [], [], [], []
    for name in model.joint_names:
        mount = by_joint[name]
        motor, pair, gear = find(mount.model).motor, len(mount.ids), mount.gear_ratio
        torque.append(pair * gear * motor.stall * 1.5)
        modelled = pair * gear * motor.friction, pair * gear**2 * motor.damping
        friction.append(modelled[0] if mount.friction is None else mount.friction)
        damping.append(modelled[1] if mount.damping is None else mount.damping)
        armature.append(pair * gear**2 * motor.inertia)
    # `kp` is a placeholder that `ArmPhysics` replaces at every step. `max_torque` is 1.5 times the
    # stall torque, so that it does not bind at a higher supply voltage.
    return Servos(
        kp=[1.0] * len(torque),
        max_torque=torque,
        friction=friction,
        damping=damping,
        armature=armature,
    )
