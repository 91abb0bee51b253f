"""Drives of users that raise errors of their own: the arm comes down, or keeps its torque."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arm's tests run on the simulator: extra sim")

import pliant
from pliant.arm import Arm
from pliant.drive import ServoStatus
from pliant.sim import Plant, SimDrive

ERRORS = [pliant.ServoError("unplugged"), OSError(5, "Input/output error"), ValueError("a bug")]


class FaultyDrive(SimDrive):
    """A simulated arm whose methods raise an error.

    Attributes:
        errors: The error that each method raises, by its name.
        calls: Number of calls of these methods that fail; later ones succeed.
        status: Result of `poll_status`.
    """

    def __init__(self, plant):
        super().__init__(plant)
        self.errors, self.calls, self.status = {}, np.inf, None

    def _fail(self, name):
        if name in self.errors and self.calls > 0:
            self.calls -= 1
            raise self.errors[name]

    def read(self):
        self._fail("read")
        return super().read()

    def write(self, goal, limit, velocity=None):
        self._fail("write")
        super().write(goal, limit, velocity)

    def poll_status(self):
        self._fail("poll_status")
        return self.status


@pytest.fixture
def arm():
    plant = Plant(pliant.robots.load("so101"), dt=0.002)
    plant.reset([0.2, -0.5, 0.6, 0.5, 0.1])
    arm = Arm(plant.model, FaultyDrive(plant), handle_signals=False)
    arm.enable()
    return arm


def height(arm):
    return arm.drive.plant.tool[2, 3]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_arm_whose_drive_takes_no_goals_keeps_its_torque(arm, error):
    start = height(arm)
    arm.drive.errors = {"write": error}
    message = "the bus is gone" if isinstance(error, pliant.ServoError) else str(error)
    with pytest.raises(type(error)) as raised:
        arm.lower()
    assert message in str(raised.value)
    assert arm.drive.enabled.all()
    assert height(arm) == pytest.approx(start, abs=0.005)
    # A goal is accepted again: the next descent brings the arm down.
    arm.drive.errors = {}
    arm.enable()
    arm.lower()
    assert height(arm) < start - 0.2


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize(("name", "calls"), [("read", 10), ("write", 10), ("poll_status", np.inf)])
def test_errors_of_a_drive_do_not_keep_the_arm_up(arm, name, calls, error):
    start = height(arm)
    arm.drive.errors, arm.drive.calls = {name: error}, calls
    arm.lower()
    assert not arm.drive.enabled.any()
    assert height(arm) < start - 0.2


def test_a_status_of_an_unknown_joint_is_named(arm):
    arm.drive.status = ServoStatus("elbow", voltage=7.0)
    with pytest.raises(pliant.ConfigError, match=r"status of 'elbow', .*: shoulder_pan, "):
        arm.write(arm.read().q)
    arm.drive.status = None
    arm.disable_torque()


@pytest.mark.parametrize("is_stale", [True, False])
def test_readings_with_a_wrong_time_are_named(arm, is_stale):
    read, kept = arm.drive.read, arm.drive.read()
    arm.drive.read = lambda: kept if is_stale else (r := read()).replace(time=r.time + 100.0)
    controller = pliant.Controller(arm.model, pliant.Settings.soft("x", task="xyz"), arm.servos)
    target = arm.model.forward_kinematics(arm.read().q)

    def run():
        for tick in pliant.Loop(arm, controller):
            tick.step(target)

    with pytest.raises(pliant.ServoError, match=r"s old .*readings with a wrong time"):
        run()
    arm.drive.read = read
    arm.disable_torque()


@pytest.mark.parametrize("is_left_on", [True, False])
def test_an_arm_that_cannot_be_taken_over_keeps_its_owner(arm, monkeypatch, is_left_on):
    error = pliant.ServoError("not confirmed")
    if is_left_on:
        arm.leave_enabled()
    else:
        arm.drive.errors = {"write": error}
        with pytest.raises(pliant.ServoError, match="the bus is gone"):
            arm.lower()
        arm.drive.errors = {}

    def fail(goal, limit):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(arm.drive, "enable", fail)
        with pytest.raises(pliant.ServoError, match="not confirmed"):
            arm.enable()
    with pytest.raises(pliant.ServoError, match=r"left ON" if is_left_on else r"failed; .* ON in"):
        arm.lower()
    start = height(arm)
    arm.enable()
    arm.lower()
    assert height(arm) < start - 0.2
