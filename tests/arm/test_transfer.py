"""Commands of a transfer of the weight to the servos of two joints, compared with recorded ones.

The plant in this file simulates the joints with friction, stops and encoders, in milliseconds.
`python tests/arm/test_transfer.py` prints the rows again, after an intended change.
"""

from types import SimpleNamespace

import numpy as np
import pytest

import pliant
from pliant.arm._transfer import transfer_weight

WEIGHT, LEVER = np.array([0.9, -0.45]), np.array([0.3, -0.21])
#: Inertia without a load [kg·m²]: with coupling, but dominant on the diagonal.
INERTIA = np.array([[0.05, 0.006], [0.006, 0.03]])
DT = 0.0005


class Pair:
    """Two joints on servos; also the `ArmIO`, model and clock of the transfer.

    Args:
        load: Load at the tool [kg].
        ratio: True stiffness over the assumed one.
        stop: Lower stop of the first joint [rad].
        step: Encoder step [rad].
        taken: Mask of the joints whose torque is on.
        known: True if the stiffness is known.
        light: Factor on the weight of the second joint.
        delay: Age of a reading [s].
        cost: Duration of a reading [s].
        silent: Range of readings without the second joint.
    """

    def __init__(
        self,
        *,
        load=0.0,
        ratio=1.0,
        stop=-np.inf,
        step=0.0015,
        taken=(False, False),
        known=False,
        light=1.0,
        delay=0.002,
        cost=0.001,
        silent=range(0),
    ):
        servos = pliant.Servos.of(["STS3215-7.4V"] * 2)
        self.servos = servos.replace(stiffness_known=known)
        self.kp, self.friction = ratio * np.asarray(servos.kp), np.asarray(servos.friction)
        self.model = self.clock = self
        self.gravity_vector, self.joint_names = np.array([0.0, 0.0, -9.81]), ("first", "second")
        self.weight = WEIGHT * [1.0, light]
        self.true_weight = self.weight + load * 9.81 * LEVER
        self.inverse = np.linalg.inv(INERTIA + load * np.outer(LEVER, LEVER))
        self.stop, self.step, self.silent = stop, step, silent
        self.age, self.cost, self.readings = delay, cost, 0
        self.time, self.x, self.v = 0.0, np.array([0.3, -0.2]), np.zeros(2)
        self.taken = np.array(taken)
        self.start = self.q = self.measured()
        self.goal = self.q + np.where(self.taken, self.weight / self.kp, 0.0)
        self.limit = np.where(self.taken, 1.2, 0.0) * np.abs(self.weight)
        self.sent, self.ramped = [], None
        self.joints = SimpleNamespace(chain=slice(None))
        self.positions = SimpleNamespace(time=np.zeros(2))

    def measured(self):
        return np.round(self.x / self.step) * self.step

    def gravity(self):
        return self.weight.copy()

    def jacobian(self, q):
        return np.vstack([np.zeros((2, 2)), LEVER, np.zeros((3, 2))])

    def inertia(self, q):
        return INERTIA.copy()

    def delay(self, now):
        return self.age

    def now(self):
        return self.time

    def wait_until(self, deadline):
        while self.time < deadline:
            self.time += DT
            torque = np.clip(self.kp * (self.goal - self.x), -self.limit, self.limit)
            free = self.v + DT * self.inverse @ (torque - self.true_weight - 0.06 * self.v)
            brake = DT * np.diag(self.inverse) * self.friction
            self.v = np.sign(free) * np.maximum(np.abs(free) - brake, 0.0)
            self.x = self.x + DT * self.v
            if self.x[0] < self.stop:
                self.x[0], self.v[0] = self.stop, 0.0

    def sample(self):
        self.wait_until(self.time + self.cost)
        self.readings += 1
        ok = np.array([True, self.readings not in self.silent])
        self.q = np.where(ok, self.measured(), self.q)
        self.positions.time = np.where(ok, self.time, self.positions.time)
        return ok

    def without_torque(self):
        return []

    def send(self, goal, limit):
        self.goal, self.limit = goal.copy(), limit.copy()
        self.sent.append(np.concatenate([goal, limit]))

    def ramp_limits(self, limit):
        self.ramped = limit

    def run(self, rate):
        """Return the number of commands, and sums of goals and limits, last limits and leads."""
        leads = transfer_weight(self, self, self.start, self.taken, rate)
        # Later commands weigh more, so that an exchange of two of them changes the sums.
        sums = np.linspace(1.0, 2.0, len(self.sent)) @ np.array(self.sent)
        return len(self.sent), np.concatenate([sums, self.ramped, leads])


BOTH, NAN = (True, True), np.nan
#: Rate [Hz], options of `Pair`, and the result of `Pair.run`.
CASES = [
    (100.0, {}, 448,
     [279.5067, -171.0817, 864.0713, 506.6796, 1.781935, 0.9471972, 0.08822773, -0.04100009]),
    (100.0, {'load': 0.25, 'ratio': 0.6}, 566,
     [497.2172, -314.5162, 1548.619, 1318.656, 1.912297, 1.890639, 0.2754258, -0.1604557]),
    (100.0, {'load': -0.15, 'ratio': 1.5, 'delay': 0.006}, 1015,
     [577.8594, -330.3423, 904.3138, 1994.107, 0.6503025, 1.912297, 0.02467711, -0.01220626]),
    (100.0, {'stop': 0.2995}, 635,
     [346.0926, -244.8428, 865.6556, 779.9418, 1.17, 0.9471972, NAN, -0.05570579]),
    (100.0, {'stop': 0.28, 'load': 0.3}, 525,
     [455.1044, -277.6178, 1419.77, 1036.682, 1.912297, 1.898703, 0.1758143, -0.09915033]),
    (100.0, {'taken': (True, False)}, 221,
     [128.8206, -90.72177, 379.9874, 161.2641, 1.17, 0.7177215, 0.08859907, -0.04181937]),
    (300.0, {'taken': (True, True)}, 150,
     [87.43479, -54.8549, 260.2876, 140.9446, 1.17, 0.6412297, 0.08859907, -0.04429953]),
    (100.0, {'known': True, 'ratio': 1.05}, 125,
     [72.86233, -45.71241, 219.375, 120.2306, 1.17, 0.6412297, 0.08859907, -0.04429953]),
    (100.0, {'known': True, 'ratio': 1.2}, 556,
     [345.8447, -212.3352, 916.2436, 509.3064, 1.454853, 0.807138, 0.07517474, -0.03383422]),
    (100.0, {'known': True, 'load': 0.2}, 624,
     [469.7823, -292.015, 1559.751, 1248.235, 1.912297, 1.754706, 0.1458538, -0.08681784]),
    (100.0, {'light': 0.1, 'load': 0.1}, 427,
     [316.311, -154.4629, 808.4319, 236.5978, 1.801986, 0.5299262, 0.1127339, -0.02436042]),
    (100.0, {'light': -0.4, 'load': 0.06, 'taken': (True, False)}, 825,
     [493.073, -228.6656, 1382.639, 186.8008, 1.142243, 0.2103529, 0.102738, 0.009107104]),
    (100.0, {'cost': 0.02, 'delay': 0.01, 'load': 0.3}, 158,
     [130.3032, -80.25496, 439.4664, 359.0127, 1.912297, 1.912297, 0.173496, -0.1072879]),
    (400.0, {'step': 0.005, 'load': 0.3}, 921,
     [807.0464, -490.7761, 2470.022, 1593.008, 1.912297, 1.42041, 0.1712363, -0.1046208]),
    (100.0, {'silent': range(20, 40), 'load': 0.2}, 896,
     [685.7207, -427.9623, 2255.219, 1807.995, 1.912297, 1.767672, 0.1500465, -0.08608403]),
    (100.0, {'silent': range(120, 140), 'load': 0.2}, 636,
     [475.4103, -295.8541, 1603.755, 1254.188, 1.912297, 1.663952, 0.1441045, -0.0874778]),
    (100.0, {'ratio': 40.0}, 634,
     [345.6609, -213.763, 879.8863, 499.0364, 1.17, 0.6412297, NAN, -0.0004360939]),
    (100.0, {'silent': range(120, 210)}, 778,
     [456.7633, -273.6929, 1237.192, 665.9762, 1.17, 0.6412297, 0.09117873, -0.0412049]),
    (100.0, {'load': 0.2, 'silent': range(5, 95)}, 1076,
     [769.8483, -443.9365, 2892.63, 2556.919, 1.912297, 1.912297, 0.1521539, -0.08619026]),
]  # fmt: skip
#: By the first silent reading: last goals and limits, and the number of commands.
HELD = {
    3: [-0.4064009, -0.2437995, 1.094, 0.599, 128],
    30: [0.4270037, -0.2633363, 1.673978, 1.001672, 155],
    200: [0.4459321, -0.284936, 1.734636, 1.058656, 325],
}


@pytest.mark.parametrize(("rate", "options", "count", "numbers"), CASES)
def test_a_transfer_sends_the_recorded_commands(rate, options, count, numbers):
    found, values = Pair(**options).run(rate)
    assert found == count
    assert values == pytest.approx(numbers, rel=1e-6, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize("first", [3, 30, 200])
def test_a_silent_joint_ends_the_transfer_with_commands_that_hold(first):
    pair = Pair(load=0.2, silent=range(first, 999))
    with pytest.raises(pliant.ServoTimeoutError, match=r"^no position of second for 0\.5 s"):
        pair.run(100.0)
    # The lead of each goal needs no more torque than the limit allows.
    torque = pair.kp * (pair.goal - pair.q)
    assert np.all(np.abs(torque) < pair.limit + 1e-9)
    assert pair.ramped is None
    numbers = [*pair.goal, *pair.limit, len(pair.sent)]
    assert numbers == pytest.approx(HELD[first], rel=1e-6)


if __name__ == "__main__":
    for rate, options, *_ in CASES:
        count, numbers = Pair(**options).run(rate)
        text = ", ".join(f"{number:.7g}".replace("nan", "NAN") for number in numbers)
        print(f"    ({rate}, {options}, {count},\n     [{text}]),")
