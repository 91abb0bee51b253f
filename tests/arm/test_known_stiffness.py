"""Torque on and first loop of simulated arms whose stiffness or friction is stated wrongly."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arms are simulated: extra sim")

import pliant
from experiments.lifecycle import FaultyDrive, postures
from pliant import robots
from pliant.arm import Arm
from pliant.sim import Plant

#: True stiffness over the one of the file. The mixed one is drawn for each joint.
RATIOS = {"a third": 3.0, "2.5 times": 0.4, "mixed": None}


class Session:
    """A simulated arm with torque on; it is let go as torque comes on.

    Args:
        ratio: True stiffness over the one that the arm is told (n,); None: drawn.
        known: True if the arm is told that this stiffness is known.
        friction: True friction over the one that the arm is told.

    Attributes:
        rise, sink: Largest motion of the tool as torque came on [m].
        time: Duration of torque on [s].
    """

    def __init__(self, name, ratio, seed, *, known=True, friction=1.0):
        model = robots.load(name)
        if ratio is None:
            ratio = np.random.default_rng(seed).uniform(0.5, 2.5, model.n)
        self.plant = Plant(model, delay=(1, 1), kp_scale=ratio, friction_scale=friction)
        self.plant.reset(postures(1, seed=seed, robot=name, load=0.0)[0])
        table = self.plant.table.replace(stiffness_known=known)
        drive = FaultyDrive(self.plant, table)
        self.arm = Arm(model, drive, handle_signals=False)
        begin, start, height = drive.clock.now(), self.plant.tool[2, 3], []
        drive.clock.on_tick = lambda: height.append(self.plant.tool[2, 3])
        self.arm.enable()
        self.time = drive.clock.now() - begin
        self.rise, self.sink = max(height) - start, start - min(height)

    def hold(self):
        """Return the largest vertical motion of the tool in 2 s of a loop at one target [m]."""
        arm, start, target, away = self.arm, self.plant.tool[2, 3], None, [0.0]
        controller = pliant.Controller(arm.model, pliant.Settings(task="xyz"), servos=arm.servos)
        for tick in pliant.Loop(arm, controller, duration=2.0):
            target = arm.model.forward_kinematics(tick.q) if target is None else target
            tick.step(target)
            away.append(abs(self.plant.tool[2, 3] - start))
        return max(away)


@pytest.mark.parametrize("seed", [0, 1, 4])
@pytest.mark.parametrize("stated", RATIOS)
@pytest.mark.parametrize("name", ["arm7", "so101", "koch"])
def test_a_stiffness_that_is_stated_wrongly_does_not_lift_or_drop_the_arm(name, stated, seed):
    """If it is believed, the arms rise by up to 31, sink by up to 67 and then move by 25 mm."""
    session = Session(name, RATIOS[stated], seed)
    assert session.rise < 0.012
    assert session.sink < 0.020
    assert session.hold() < 0.010


@pytest.mark.parametrize("name", ["arm7", "so101", "koch"])
@pytest.mark.parametrize("ratio", [0.95, 1.0, 1.05])
def test_a_stiffness_that_is_known_takes_a_second(name, ratio):
    session = Session(name, ratio, 1)
    assert session.arm.servos.stiffness_known
    assert session.time < 2.0
    assert session.rise < 0.004


@pytest.mark.parametrize(("seed", "ratio"), [(3, 1.0), (5, 2.5), (12, 1.0)])
def test_a_light_arm_with_half_the_friction_is_balanced(seed, ratio):
    """If the balance always assumes a load of 0.1 kg, the arm rises by 19 to 29 mm."""
    assert Session("koch", ratio, seed, known=False, friction=0.5).rise < 0.010
