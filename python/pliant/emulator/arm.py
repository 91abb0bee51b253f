"""An emulated arm: emulated servos on the joints of a simulated arm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, Servos
from pliant.emulator.device import Device
from pliant.emulator.emulator import Emulator
from pliant.emulator.models import find
from pliant.emulator.motion import walk

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike

    from pliant.emulator.servo import Drive, Servo
    from pliant.sim import Plant
    from pliant.sim._model_builder import Robot


@dataclass(frozen=True, kw_only=True)
class Mount:
    """Mounting of a servo on a joint: ``count = zero + sign · gear_ratio · q / count size``.

    Attributes:
        joint: Name of the joint, on or off the chain (a gripper).
        model: Servo model.
        id: Id on the bus.
        sign: 1, or -1 if counts fall as the joint angle rises.
        zero: Count at joint angle 0; default its middle.
        gear_ratio: Turns of the servo per turn of the joint.
        secondary: Id and sign of a second servo of the same model on the same joint.
        port: Port of the servo.
        registers: EEPROM values that differ from a new servo's.
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

    def __post_init__(self) -> None:
        """Check signs and gear."""
        for sign in (self.sign, self.secondary[1] if self.secondary else 1):
            if sign not in {-1, 1}:
                raise ConfigError(f"mount of {self.joint!r}: a sign is 1 or -1, got {sign!r}")
        if not self.gear_ratio > 0.0:
            raise ConfigError(
                f"mount of {self.joint!r}: gear_ratio must be above 0, got {self.gear_ratio!r}"
            )

    @property
    def ids(self) -> list[tuple[int, int]]:
        """Id and sign of its servos."""
        return [(self.id, self.sign), *([self.secondary] if self.secondary else [])]

    def devices(self) -> list[Device]:
        """Return the servos of this mount."""
        return [Device(self.model, id, port=self.port, **self.registers) for id, _ in self.ids]


@dataclass(slots=True)
class Coupling:
    """One live servo on its joint: shaft angle = ``offset + ratio · q``.

    Attributes:
        servo: The servo.
        ratio, offset: Of the shaft relative to the joint.
        reference: Present reference of the servo's own profile [rad].
        share: Share of the joint's torque.
        slope: Present torque loss per speed [N·m·s/rad].
    """

    servo: Servo
    ratio: float
    offset: float
    reference: float | None = None
    share: float = 0.0
    slope: float = 0.0


class ArmPhysics:
    """Drives a `pliant.sim.Plant` from the servos' registers.

    Stiffness and damping of the plant's servos follow the emulated ones, tick by tick; friction,
    scene and payload are the plant's own. A joint with torque off swings free, without back-EMF.
    Servos on one joint share its torque in proportion to their ceilings.

    Attributes:
        plant: The simulated arm.
        dt: Its physics step [s].
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
                there = ", ".join(self._chain + self._extra)
                raise ConfigError(f"joint {name!r} is mounted, {what}; the arm has {there}")
        missing = [name for name in self._chain if name not in names]
        if missing:
            raise ConfigError(f"no servo is mounted on {', '.join(missing)}")

    def bind(self, servos: Sequence[Servo]) -> None:
        """Set the shafts to the arm's pose; servos come in the order of the mounts."""
        self._joints: dict[str, list[Coupling]] = {}
        rest = iter(servos)
        for mount in self.mounts:
            couplings = []
            for _, sign in mount.ids:
                servo = next(rest)
                zero = (servo.model.top + 1) // 2 if mount.zero is None else mount.zero
                ratio = sign * servo.direction * mount.gear_ratio
                couplings.append(Coupling(servo, ratio, servo.angle_of(zero)))
            self._joints[mount.joint] = couplings
        self._set_inertia()
        self._scatter()

    def _set_inertia(self) -> None:
        """Set the carried inertia of current-controlled servos, for their own damping."""
        from pliant.sim._mujoco import mujoco

        model, data = self.plant.mj_model, self.plant.mj_data
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        for name, couplings in self._joints.items():
            at = model.joint(name).dofadr[0]
            for coupling in couplings:
                own = coupling.servo.model.motor.inertia
                carried = float(full[at, at]) / len(couplings) / coupling.ratio**2
                coupling.servo.load.inertia = max(carried - own, 0.0)

    def step(self, count: int) -> None:
        """Apply the servos' drives to the plant, run it, and read the shafts back."""
        goals, limits = self.plant.q, np.zeros(self.plant.n)
        extra: dict[str, tuple[float, float]] = {}
        if self._held and not self._carried():
            self._scatter()
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
        self._scatter()

    def _carried(self) -> bool:
        """Return True if every joint of the chain has torque."""
        return all(
            drive.goal is not None and drive.ceiling > 0.0
            for name in self._chain
            for drive in (coupling.servo.drive() for coupling in self._joints[name])
        )

    def _combine(
        self, name: str, couplings: list[Coupling], drives: list[Drive], seconds: float
    ) -> tuple[float, float]:
        """Return goal and limit of a joint, and set its stiffness and damping."""
        stiffness = damping = pull = kv = limit = 0.0
        for coupling, drive in zip(couplings, drives, strict=True):
            square = coupling.ratio**2
            motor = coupling.servo.model.motor
            damping += (motor.damping + drive.slope) * square
            coupling.reference = walk(
                drive, coupling.reference, coupling.servo.shaft.angle, seconds
            )
            if coupling.reference is None:
                continue
            stiffness += drive.stiffness * square
            kv += drive.kv * square
            limit += drive.ceiling * abs(coupling.ratio)
            pull += (
                drive.stiffness * square * (coupling.reference - coupling.offset) / coupling.ratio
            )
        model = self.plant.mj_model
        model.dof_damping[model.joint(name).dofadr[0]] = damping
        actuator = model.actuator(name)
        actuator.gainprm[0], actuator.biasprm[1], actuator.biasprm[2] = stiffness, -stiffness, -kv
        total = sum(drive.ceiling for drive in drives)
        for coupling, drive in zip(couplings, drives, strict=True):
            coupling.share = drive.ceiling / total if total > 0.0 else 0.0
            coupling.slope = drive.slope
        here = float(self.plant.mj_data.joint(name).qpos[0])
        return (pull / stiffness if stiffness > 0.0 else here), limit

    def _scatter(self) -> None:
        """Write angle, speed and torque of the joints to the shafts."""
        plant = self.plant
        q, dq, torque = plant.q, plant.dq, plant.torque
        for name, couplings in self._joints.items():
            if name in self._chain:
                at = self._chain.index(name)
                angle, speed, effort = float(q[at]), float(dq[at]), float(torque[at])
            else:
                joint = plant.mj_data.joint(name)
                angle, speed = float(joint.qpos[0]), float(joint.qvel[0])
                effort = float(plant.mj_data.actuator(name).force[0])
            for coupling in couplings:
                shaft = coupling.servo.shaft
                shaft.angle = coupling.offset + coupling.ratio * angle
                shaft.speed = coupling.ratio * speed
                shaft.torque = coupling.share * effort / coupling.ratio
                shaft.torque -= coupling.slope * shaft.speed


class ArmEmulator(Emulator):
    """An emulator with a simulated arm behind it; made by `emulate`.

    Attributes:
        plant: The arm, with its true state, scene and hands.
    """

    def __init__(
        self, plant: Plant, mounts: Sequence[Mount], *, held: bool = False, **options: Any
    ) -> None:
        """Mount the servos on the plant; options as for `ArmPhysics` and `Emulator`."""
        self.plant = plant
        devices = [device for mount in mounts for device in mount.devices()]
        super().__init__(devices, physics=ArmPhysics(plant, mounts, held=held), **options)


def emulate(
    model: Robot,
    mounts: Sequence[Mount],
    q: ArrayLike,
    *,
    plant: Mapping[str, Any] | None = None,
    held: bool = False,
    **options: Any,
) -> ArmEmulator:
    """Make an emulator with a simulated arm behind it (extra `sim`).

    Args:
        model: The robot.
        mounts: A servo for every joint of the chain, and for off-chain joints as needed.
        q: Initial joint positions (n,) [rad].
        plant: Keywords of `pliant.sim.Plant`: `scene`, `payload`, `friction`, `backlash`, `dt`, ...
            Delay, losses and counts belong to the emulated bus and are rejected here.
        held: True: the arm is held until all joints of the chain have torque; otherwise it falls
            from the start.
        **options: Keywords of `Emulator`: `timing`, `faults`, `clock`, `baud`, `log`.

    Returns:
        The emulator, not yet started.

    Raises:
        ConfigError: A joint has no servo or two, or an option is not allowed here.
    """
    from pliant.sim import Plant

    keywords = dict(plant or {})
    for name in ("servos", "kind", "delay", "count", "read_loss", "write_loss", "overload", "rate"):
        if name in keywords:
            raise ConfigError(f"{name!r} of an emulated arm comes from its servos and its bus")
    arm = Plant(model, _servos(model, mounts), **keywords)
    arm.reset(q)
    return ArmEmulator(arm, mounts, held=held, **options)


def _servos(model: Robot, mounts: Sequence[Mount]) -> Servos:
    """Motor numbers of the chain's joints, from this package's own tables."""
    by_joint = {mount.joint: mount for mount in mounts}
    missing = [name for name in model.joint_names if name not in by_joint]
    if missing:
        raise ConfigError(f"no servo is mounted on {', '.join(missing)}")
    torque, friction, damping, armature = [], [], [], []
    for name in model.joint_names:
        mount = by_joint[name]
        motor, pair, gear = find(mount.model).motor, len(mount.ids), mount.gear_ratio
        torque.append(pair * gear * motor.stall * 1.5)
        friction.append(pair * gear * motor.friction)
        damping.append(pair * gear**2 * motor.damping)
        armature.append(pair * gear**2 * motor.inertia)
    # Stiffness is set tick by tick; the ceiling leaves room for a supply above the nominal one.
    return Servos(
        kp=[1.0] * len(torque),
        max_torque=torque,
        friction=friction,
        damping=damping,
        armature=armature,
    )
