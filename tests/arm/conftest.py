"""An arm on the simulator, and a drive that records its calls."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arm's tests run on the simulator: extra sim")

import pliant
from pliant.arm import Arm
from pliant.sim import Plant, SimDrive
from pliant.sim.postures import VERTICAL as GRASP


class Scribe(SimDrive):
    """A simulated arm that records its calls."""

    def __init__(self, plant):
        super().__init__(plant)
        self.diary = []
        self.silent = set()
        self.broken = False

    def read(self):
        if self.broken:
            raise pliant.ServoError("unplugged")
        sample = super().read()
        is_missing = np.isin(self.names, list(self.silent))
        sample.position[is_missing] = np.nan
        sample.ok[is_missing] = False
        return sample

    def write(self, goal, limit, velocity=None):
        if self.broken:
            raise pliant.ServoError("unplugged")
        self.diary.append(("write", goal.copy(), limit.copy()))
        super().write(goal, limit, velocity)

    def enable(self, goal, limit):
        self.diary.append(("enable", goal.copy(), limit.copy()))
        super().enable(goal, limit)

    def disable(self, names):
        self.diary.append(("disable", tuple(names), None))
        super().disable(names)

    def watchdog(self, seconds):
        self.diary.append(("watchdog", seconds, None))

    def verbs(self):
        """Return the names of the recorded calls; consecutive equal ones count once."""
        names = []
        for verb, *_ in self.diary:
            if not names or names[-1] != verb:
                names.append(verb)
        return names


@pytest.fixture
def make():
    """Make an arm in a posture, with options of the plant and of the arm."""

    def build(q=GRASP, robot="arm7", plant=None, **options):
        model = pliant.robots.load(robot)
        simulated = Plant(model, **{"dt": 0.002, **(plant or {})})
        if q is not None:
            simulated.reset(q)
        return Arm(model, Scribe(simulated), **{"handle_signals": False, **options})

    return build
