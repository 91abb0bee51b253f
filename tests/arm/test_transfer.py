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
    (100.0, {}, 465,
     [289.4341, -177.3696, 894.7839, 500.6174, 1.705443, 0.8707053, 0.09183272, -0.04416346]),
    (100.0, {'load': 0.25, 'ratio': 0.6}, 524,
     [458.8803, -290.4545, 1421.222, 1190.364, 1.912297, 1.868004, 0.2656692, -0.1666749]),
    (100.0, {'load': -0.15, 'ratio': 1.5, 'delay': 0.006}, 1035,
     [595.7229, -339.4932, 969.6917, 2044.185, 0.6855364, 1.912297, 0.02880192, -0.007479884]),
    (100.0, {'stop': 0.2995}, 634,
     [345.6609, -242.8616, 883.3068, 726.7631, 1.17, 0.8707053, NAN, -0.05204852]),
    (100.0, {'stop': 0.28, 'load': 0.3}, 522,
     [453.0477, -277.7795, 1409.443, 987.008, 1.912297, 1.714254, 0.1743131, -0.1030464]),
    (100.0, {'taken': (True, False)}, 219,
     [127.6548, -90.06164, 376.4667, 159.3196, 1.17, 0.6412297, 0.08859907, -0.04031937]),
    (300.0, {'taken': BOTH}, 150,
     [87.43479, -54.8549, 260.2876, 140.9446, 1.17, 0.6412297, 0.08859907, -0.04429953]),
    (100.0, {'known': True, 'ratio': 1.05}, 163,
     [95.01247, -59.60899, 286.065, 156.7807, 1.17, 0.6412297, 0.08859907, -0.04429953]),
    (100.0, {'known': True, 'ratio': 1.2}, 548,
     [340.4698, -208.8186, 911.1451, 474.3417, 1.464205, 0.7284465, 0.076799, -0.03711487]),
    (100.0, {'known': True, 'load': 0.2}, 745,
     [551.4763, -344.4598, 1908.291, 1627.474, 1.912297, 1.830287, 0.1523581, -0.08878546]),
    (100.0, {'light': 0.1, 'load': 0.1}, 819,
     [555.1705, -285.5564, 1999.827, 634.3306, 1.912297, 0.6166185, 0.1209868, -0.01991967]),
    (100.0, {'light': -0.4, 'load': 0.06, 'taken': (True, False)}, 742,
     [441.3808, -205.8693, 1257.69, 157.5119, 1.171841, 0.2087841, 0.1098071, 0.0106071]),
    (100.0, {'cost': 0.02, 'delay': 0.01, 'load': 0.3}, 143,
     [118.568, -73.12142, 396.1415, 316.7286, 1.912297, 1.912297, 0.1764626, -0.1045415]),
    (400.0, {'step': 0.005, 'load': 0.3}, 1060,
     [888.2074, -550.5375, 2884.603, 1897.185, 1.912297, 1.402151, 0.1694035, -0.1077929]),
    (100.0, {'silent': range(20, 40), 'load': 0.2}, 923,
     [700.8814, -439.5504, 2360.9, 1846.572, 1.912297, 1.68509, 0.1524651, -0.08856006]),
    (100.0, {'silent': range(120, 140), 'load': 0.2}, 714,
     [526.1106, -329.0228, 1839.894, 1518.709, 1.912297, 1.749364, 0.152578, -0.08998152]),
    (100.0, {'ratio': 40.0}, 634,
     [345.6609, -213.7661, 881.192, 499.0364, 1.17, 0.6412297, NAN, -0.0004682628]),
    (100.0, {'silent': range(120, 210)}, 787,
     [461.3926, -277.6691, 1298.741, 677.8714, 1.246492, 0.6412297, 0.08705314, -0.04923561]),
    (100.0, {'load': 0.2, 'silent': range(5, 95)}, 1246,
     [881.8678, -521.3903, 3385.595, 3054.166, 1.912297, 1.912297, 0.1419418, -0.08827095]),
]  # fmt: skip
#: By the first silent reading: last goals and limits, and the number of commands.
HELD = {
    3: [-0.4064009, -0.2437995, 1.094, 0.599, 128],
    30: [0.428499, -0.2630052, 1.673926, 0.9979731, 155],
    200: [0.4464672, -0.2859813, 1.740615, 1.053575, 325],
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
