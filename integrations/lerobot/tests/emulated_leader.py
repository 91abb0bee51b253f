"""Emulated leader; the emulator's process imports this module by its name."""

from pliant.config import Config
from pliant.config.factory import make_emulator
from pliant.emulator import ArmEmulator, JointHand, wave

#: Joint positions in the middle of the motion, with the tool above the table [rad].
MIDDLE = (0.0, -0.3, 0.3, 0.6, 0.0)


def swinging(file: Config) -> ArmEmulator:
    """Return an emulated arm without torque, which a simulated hand moves to and fro."""
    model = file.model()
    hand = JointHand(wave(model, dict(zip(model.joint_names, MIDDLE, strict=True))))
    return make_emulator(file, q=MIDDLE, hand=hand)
