"""`arm7` on emulated servos of each family, for the soak and fault experiments."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pliant import config
from pliant.arm import Arm
from pliant.config import factory
from pliant.config.factory import make_emulator
from pliant.emulator import ManualClock, Timing
from pliant.servo import ServoBus
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from collections.abc import Iterator

    from experiments.poses import Array
    from pliant.config import Config
    from pliant.emulator import ArmEmulator


#: Minimum reply timeout of the driver, by the wall clock [s]. A reply that a busy computer delays
#: longer counts as lost.
PATIENCE = 0.05


@dataclass(frozen=True, kw_only=True)
class Family:
    """Seven servos of one family for `arm7`.

    Attributes:
        title: Description in tables.
        models: Servo models in the order of the joints.
        volts: Supply voltage [V].
        gravity: Gravitational acceleration [m/s²]; reduced if the servos are too weak for the arm.
        zeros: Encoder count at joint angle 0, by joint; by default the middle of the range.
        limits: Line of the configuration file that keeps joints within the servos' travel; "" if
            no joint needs it.
    """

    title: str
    models: tuple[str, ...]
    volts: float
    gravity: float = 9.81
    zeros: dict[str, int] = field(default_factory=dict)
    limits: str = ""


JOINTS = (
    "shoulder_pitch",
    "shoulder_roll",
    "shoulder_yaw",
    "elbow_pitch",
    "wrist_yaw",
    "wrist_pitch",
    "wrist_roll",
)
FAMILIES: dict[str, Family] = {
    # Reduced gravity: the servos' stall torque of 2.9 N·m is too low for the arm at 9.81 m/s².
    "sts": Family(title="7 STS3215-12V", models=("STS3215-12V",) * 7, volts=12.0, gravity=3.0),
    "x": Family(
        title="4 XM540-W270, 2 XM430-W350, 1 XL430-W250",
        models=("XM540-W270",) * 4 + ("XM430-W350",) * 2 + ("XL430-W250",),
        volts=11.1,
    ),
    "p1": Family(
        title="4 EX-106+, 3 RX-64",
        models=("EX-106+",) * 4 + ("RX-64",) * 3,
        volts=18.5,
        zeros={"shoulder_pitch": 2562, "shoulder_roll": 2702, "elbow_pitch": 3217},
        limits="limits = { shoulder_pitch = [-2.7, 1.6], shoulder_yaw = [-2.15, 2.15] }",
    ),
}


def configuration(family: str, q: Array = VERTICAL) -> Config:
    """Return the configuration of `arm7` with servos of a family and rest pose q (n,) [rad]."""
    kind = FAMILIES[family]
    lines = [
        '[robot]\nbuiltin = "arm7"',
        f"gravity = [0.0, 0.0, {-kind.gravity}]\n{kind.limits}",
        f"[supply]\nvoltage = {kind.volts}",
        f"[life]\nrest_q = {q.tolist()}",
        '[[port]]\npath = "auto"\n[servo]',
    ]
    for number, (joint, model) in enumerate(zip(JOINTS, kind.models, strict=True), 1):
        zero = f", zero = {kind.zeros[joint]}" if joint in kind.zeros else ""
        lines.append(f'{joint} = {{ model = "{model}", id = {number}{zero} }}')
    return config.parse("\n".join(lines), source=family)


def emulator(family: str, *, q: Array = VERTICAL, **options: Any) -> ArmEmulator:
    """Return the emulator of `arm7` with servos of a family in pose q (n,) [rad], not yet started.

    By default its replies take as long as on a real bus; `options` are those of the emulator.
    """
    return make_emulator(configuration(family, q), q=q, **{"timing": Timing(wire=True), **options})


@contextmanager
def stepped(
    family: str,
    *,
    arm: dict[str, Any],
    chain: type[ServoBus] = ServoBus,
    q: Array = VERTICAL,
    patience: float = PATIENCE,
    **options: Any,
) -> Iterator[tuple[ArmEmulator, Arm]]:
    """Return a context that yields an emulator and a `pliant.Arm` that is connected to it.

    Both run in emulated time, which advances as fast as the computer allows.

    Args:
        family: Servo family: `sts`, `x` or `p1`.
        arm: Options of `pliant.Arm`.
        chain: Driver class of the servos.
        q: Initial pose of the arm (n,) [rad].
        patience: Minimum reply timeout, by the wall clock [s].
        **options: Options of `emulator`.
    """
    arm_config = configuration(family, q)
    with emulator(family, q=q, clock="steps", **options) as bus:
        drive = chain(
            factory.servo_specs(arm_config, bus.ports),
            reply_timeout_min=patience,
            clock=ManualClock(bus),
        )
        try:
            yield bus, Arm(arm_config.model(), drive, **{"handle_signals": False, **arm})
        finally:
            drive.close()
