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
    (100.0, {}, 447,
     [278.9297, -170.7233, 861.2143, 505.2012, 1.781935, 0.9471972, 0.09085235, -0.04351425]),
    (100.0, {'load': 0.25, 'ratio': 0.6}, 565,
     [496.3534, -313.9749, 1545.726, 1315.725, 1.912297, 1.890639, 0.2798428, -0.1648122]),
    (100.0, {'load': -0.15, 'ratio': 1.5, 'delay': 0.006}, 1015,
     [577.8594, -330.3423, 904.3138, 1994.107, 0.6503025, 1.912297, 0.02467711, -0.01220626]),
    (100.0, {'stop': 0.2995}, 634,
     [345.6609, -244.4586, 863.7684, 778.4924, 1.17, 0.9471972, NAN, -0.05912171]),
    (100.0, {'stop': 0.28, 'load': 0.3}, 524,
     [454.4606, -277.1858, 1416.852, 1033.593, 1.912297, 1.898703, 0.1758143, -0.1016711]),
    (100.0, {'taken': (True, False)}, 221,
     [128.8206, -90.72177, 379.9874, 161.2641, 1.17, 0.7177215, 0.08859907, -0.04181937]),
    (300.0, {'taken': (True, True)}, 150,
     [87.43479, -54.8549, 260.2876, 140.9446, 1.17, 0.6412297, 0.08859907, -0.04429953]),
    (100.0, {'known': True, 'ratio': 1.05}, 125,
     [72.86233, -45.71241, 219.375, 120.2306, 1.17, 0.6412297, 0.08859907, -0.04429953]),
    (100.0, {'known': True, 'ratio': 1.2}, 555,
     [345.2931, -211.9908, 913.9214, 508.0264, 1.454853, 0.807138, 0.07762123, -0.03627487]),
    (100.0, {'known': True, 'load': 0.2}, 623,
     [469.1286, -291.5905, 1556.786, 1245.462, 1.912297, 1.754706, 0.1484456, -0.08946393]),
    (100.0, {'light': 0.1, 'load': 0.1}, 426,
     [315.7428, -154.1313, 805.4659, 235.7401, 1.801986, 0.5299262, 0.1127339, -0.02704187]),
    (100.0, {'light': -0.4, 'load': 0.06, 'taken': (True, False)}, 825,
     [493.073, -228.6656, 1382.639, 186.8008, 1.142243, 0.2103529, 0.102738, 0.009107104]),
    (100.0, {'cost': 0.02, 'delay': 0.01, 'load': 0.3}, 157,
     [129.6092, -79.8005, 436.5767, 356.0144, 1.912297, 1.912297, 0.1760734, -0.1101397]),
    (400.0, {'step': 0.005, 'load': 0.3}, 920,
     [806.4117, -490.3336, 2467.093, 1590.765, 1.912297, 1.42041, 0.1712363, -0.1073599]),
    (100.0, {'silent': range(20, 40), 'load': 0.2}, 895,
     [685.0624, -427.5393, 2252.264, 1805.206, 1.912297, 1.767672, 0.15264, -0.08867744]),
    (100.0, {'silent': range(120, 140), 'load': 0.2}, 635,
     [474.7554, -295.4275, 1600.8, 1251.58, 1.912297, 1.663952, 0.1466714, -0.09017874]),
    (100.0, {'ratio': 40.0}, 634,
     [345.6609, -213.763, 879.8863, 499.0364, 1.17, 0.6412297, NAN, -0.0004360939]),
    (100.0, {'silent': range(120, 210)}, 777,
     [456.1714, -273.3254, 1235.398, 664.9897, 1.17, 0.6412297, 0.09389114, -0.04373161]),
    (100.0, {'load': 0.2, 'silent': range(5, 95)}, 1075,
     [769.1771, -443.496, 2889.735, 2553.973, 1.912297, 1.912297, 0.1521539, -0.0887422]),
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
