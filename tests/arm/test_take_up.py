"""Torque on while the positions of some joints do not arrive."""

from types import SimpleNamespace

import numpy as np
import pytest
from bare_arm import bare_arm

import pliant
from pliant.arm._startup import stiffness_mismatch

START = [0.0, -0.3, 0.3, 0.9, 0.0]  # [rad]


class Hidden:
    """A simulated SO-101 that lacks readings of some joints, `when` to `until` [s] after torque on.

    Attributes:
        fastest: Largest speed of the tool [m/s].
        highest, start: Largest and initial height of the tool [m].
    """

    def __init__(self, when, until, names=None):
        self.arm = pliant.connect("so101", backend="sim", q=START, handle_signals=False)
        self.plant = self.arm.drive.plant
        self.fastest, self.highest, self.start = 0.0, -np.inf, float(self.plant.tool[2, 3])
        drive, clock, began = self.arm.drive, self.arm.clock, None
        read, enable, advance = drive.read, drive.enable, clock._advance

        def hidden():
            sample = read()
            if began is None or not when <= clock.now() - began < until:
                return sample
            lost = np.isin(drive.names, drive.names if names is None else names)
            return sample.replace(ok=sample.ok & ~lost)

        def enabled(*orders):
            nonlocal began
            began = clock.now()
            enable(*orders)

        def watched():
            advance()
            twist = self.plant.ground_truth.frame("tool").twist()
            self.fastest = max(self.fastest, float(np.linalg.norm(twist[:3])))
            self.highest = max(self.highest, float(self.plant.tool[2, 3]))

        drive.read, drive.enable, clock._advance = hidden, enabled, watched


@pytest.mark.parametrize("names", [None, ["elbow_flex"]], ids=["all", "one"])
@pytest.mark.parametrize("when", [0.0, 0.1, 0.5, 1.1])
def test_silent_joints_keep_their_orders_and_are_named(when, names):
    hidden = Hidden(when, np.inf, names)
    with pytest.raises(pliant.ServoTimeoutError, match=r"no position of .*elbow_flex.* for 0\.5 s"):
        hidden.arm.enable()
    # An arm that ignores missing readings would rise by 0.2 m at 1.2 m/s.
    assert hidden.highest - hidden.start < 0.005  # [m], measured 0.001
    assert hidden.fastest < 0.1  # [m/s], measured 0.03
    hidden.arm.disable_torque()


def test_a_short_silence_only_delays():
    hidden = Hidden(0.1, 0.4)
    hidden.arm.enable()
    assert np.isfinite(hidden.arm.leads[1:3]).all()
    assert hidden.highest - hidden.start < 0.005  # [m]
    assert hidden.fastest < 0.1  # [m/s]
    hidden.arm.disable_torque()


@pytest.mark.parametrize("ratios", [(-0.094, 1.0), (-0.094, 0.42), (1.0, 0.42)])
def test_a_joint_that_pushes_opposite_to_its_weight_is_not_called_soft(ratios):
    """The leads of two joints are those of servos with these ratios of true to assumed k_p."""
    arm = bare_arm("so101")
    weight, kp = np.array([0.0, 1.0, 1.0, 0.0, 0.0]), np.asarray(arm.servos.kp)
    leads = np.zeros(5)
    leads[1:3] = weight[1:3] / kp[1:3] / np.array(ratios)
    io = SimpleNamespace(servos=arm.servos, model=arm.model, gravity=lambda: weight)
    text = stiffness_mismatch(io, leads)
    assert ("shoulder_lift pushes opposite to what its weight needs" in text) is (ratios[0] < 0.0)
    assert ("elbow_flex 0.42 x the assumed k_p" in text) is (ratios[1] < 1.0)
    assert "-0.0" not in text
