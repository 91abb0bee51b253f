"""An emulated leader, made in a process of its own, which imports this module by its name."""

from pliant.config import Config
from pliant.config.factory import make_emulator
from pliant.emulator import ArmEmulator, JointHand, wave

#: Middle of the motion: the tool is free of the table.
MIDDLE = (0.0, -0.3, 0.3, 0.6, 0.0)


def swinging(file: Config) -> ArmEmulator:
    """Return an arm without torque that a hand swings."""
    model = file.model()
    hand = JointHand(wave(model, dict(zip(model.joint_names, MIDDLE, strict=True))))
    return make_emulator(file, q=MIDDLE, hand=hand)
