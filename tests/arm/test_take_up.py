"""Torque on while the positions of some joints do not arrive."""

from types import SimpleNamespace

import numpy as np
import pytest
from bare_arm import bare_arm

import pliant
from pliant import robots
from pliant._core import SUPPORT
from pliant.arm._checks import longest_command_age
from pliant.arm._messages import MESSAGES
from pliant.arm._shutdown import UNKNOWN_TIME, _wait_for_silent
from pliant.arm._startup import (
    ATTEMPTS,
    check_reading_time,
    check_within_limits,
    full_lead,
    initial_commands,
    may_lie_on,
    stiffness_mismatch,
    stiffness_ratio,
    wait_for_all,
)
from pliant.arm._transfer import MIN_BALANCE, RISE, SINK, _DisturbanceObserver, _WeightTransfer

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


def test_joints_that_have_torque_keep_goals_that_their_limits_can_hold():
    """The goals of joints 0 to 2 are known, the goal of joint 3 is not; joint 4 has no torque."""
    arm = bare_arm("so101")
    kp, usable = np.asarray(arm.servos.kp), np.asarray(arm.servos.max_torque)
    weight, on = np.array([0.1, -0.2, 0.3, 3.0, 0.4]), np.array([True, True, True, True, False])
    q, goals = np.full(5, 0.2), np.array([0.25, 3.0, -3.0, np.nan, 0.5])
    limits = np.array([0.5, 0.4, 9.0, np.nan, 0.1])
    io = SimpleNamespace(
        servos=arm.servos,
        q=q,
        gravity=lambda: weight,
        stored_commands=lambda: (goals, limits),
    )
    goal, limit, lead, carried = initial_commands(io, on)
    assert carried.tolist() == [True, True, True, False, False]
    # A goal beyond twice the limit over k_p would not push harder.
    assert goal[:3] == pytest.approx(
        [0.25, 0.2 + 2 * limits[1] / kp[1], 0.2 - 2 * usable[2] / kp[2]]
    )
    assert limit[:3] == pytest.approx([limits[0], limits[1], usable[2]])
    assert goal[3:] == pytest.approx([0.2 + 0.1, 0.2])
    assert lead == pytest.approx([0.0, 0.0, 0.0, 0.0, weight[4] / kp[4]])


@pytest.mark.parametrize("is_known", [True, False])
def test_joints_of_unknown_stiffness_start_with_less_torque_and_a_longer_lead(is_known):
    """Joints 0 and 1 have torque, but their registers are not known; the others have none."""
    arm = bare_arm("so101")
    servos = arm.servos.replace(stiffness_known=is_known)
    kp, friction, usable = (
        np.asarray(getattr(servos, name)) for name in ("kp", "friction", "max_torque")
    )
    weight, q = np.array([0.4, -0.01, 0.5, -0.5, 99.0]) * usable, np.full(5, 0.2)
    on, unknown = np.array([True, True, False, False, False]), np.full(5, np.nan)
    io = SimpleNamespace(
        servos=servos, q=q, gravity=lambda: weight, stored_commands=lambda: (unknown, unknown)
    )
    goal, limit, lead, taken = initial_commands(io, on)
    assert not taken.any()
    size = np.abs(weight)
    most = SUPPORT * size + 2.0 * friction if is_known else size + 0.5 * friction
    assert limit == pytest.approx(np.minimum(most, usable))
    first = (1.0 if is_known else 2.0) * weight / kp
    assert abs(first[0]) > 0.1 > abs(first[1])
    assert goal - q == pytest.approx([0.1, first[1], 0.0, 0.0, 0.0])
    expected = weight / kp if is_known else full_lead(weight, kp)
    assert lead == pytest.approx(np.where(on, 0.0, expected))


def test_a_full_lead_has_a_margin_and_a_bound():
    torque, kp = np.array([1.0, -1.0, 0.0, 9.0, -9.0]), np.array([10.0, 20.0, 10.0, 10.0, 10.0])
    # The lead is twice torque / assumed stiffness, plus 0.03 rad for the motion, at most 0.8 rad.
    assert full_lead(torque, kp) == pytest.approx([0.23, -0.13, 0.0, 0.8, -0.8])


class Reader:
    """Arm of two joints: each reading takes the next of the `durations` [s]; the last one repeats.

    The second joint answers from reading number `answers` on.
    """

    def __init__(self, *durations, answers=1):
        self.durations, self.answers, self.readings, self.time = durations, answers, 0, 0.0
        self.clock, self.joints, self.positions = self, SimpleNamespace(names=("a", "b")), self
        self.position, self.waits = np.zeros(2), []

    def reset(self):
        self.position = np.full(2, np.nan)

    def now(self):
        return self.time

    def wait_until(self, deadline):
        self.waits.append(round(deadline - self.time, 6))
        self.time = deadline

    def sample(self):
        self.time += self.durations[min(self.readings, len(self.durations) - 1)]
        self.readings += 1
        self.position = np.array([0.0, 0.0 if self.readings >= self.answers else np.nan])


def test_torque_waits_until_every_joint_has_answered():
    reader = Reader(0.004, 0.003, answers=3)
    assert wait_for_all(reader, 100.0) == pytest.approx(0.003)
    assert reader.waits == [0.01, 0.01]
    silent = Reader(0.004, answers=99)
    with pytest.raises(pliant.ServoTimeoutError, match="no answer from b: torque stays off"):
        wait_for_all(silent, 100.0)
    assert silent.readings == ATTEMPTS


@pytest.mark.parametrize(
    ("first", "others", "required", "outcome", "readings"),
    [
        (0.009, [9.0], True, None, 0),
        (9.0, [0.009], True, None, 1),
        (9.0, [9.0, 0.009], True, None, 2),
        (0.02, [0.03, 0.02], True, "warned", 2),
        (0.9, [0.5], True, "refused", 2),
        (0.9, [0.5], False, "warned", 2),
    ],
)
def test_the_fastest_of_three_readings_decides(first, others, required, outcome, readings):
    reader = Reader(*others)
    if outcome == "refused":
        with pytest.raises(
            pliant.ServoError, match=r"takes 500 ms, .* or reduce the rate, .* to 1 Hz"
        ):
            check_reading_time(reader, first, 100.0, required=required)
    else:
        text = check_reading_time(reader, first, 100.0, required=required)
        assert (text is None) == (outcome is None)
        assert text is None or f"takes {1e3 * min([first, *others]):.0f} ms" in text
    assert reader.readings == readings


@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_a_reading_may_take_most_of_the_age_of_a_command(rate):
    longest = 0.7 * longest_command_age(rate)
    assert check_reading_time(Reader(9.0), longest - 1e-3, rate, required=True)
    with pytest.raises(pliant.ServoError, match=f"at most {1e3 * longest:.0f} ms are allowed"):
        check_reading_time(Reader(9.0), longest + 1e-3, rate, required=True)


@pytest.mark.parametrize("on", [False, True])
def test_joints_outside_their_limits_are_named_with_the_remedy(on):
    model = bare_arm("so101").model
    io = SimpleNamespace(model=model, q=np.array(model.upper))
    check_within_limits(io, np.zeros(5, dtype=bool))
    io.q = io.q + np.array([0.0, 1.0, 0.0, 1.0, 0.0])
    with pytest.raises(
        pliant.ServoError, match=r"^shoulder_lift stands at .*; wrist_flex stands at"
    ) as caught:
        check_within_limits(io, np.array([on, False, False, False, False]))
    assert ("support the arm" in str(caught.value)) is on


class Silent:
    """An arm whose joint `elbow` answers after a time, in ticks of 10 ms; None: never."""

    def __init__(self, answers=None):
        self.ticks, self.answers, self.clock = 0, answers, self

    def now(self):
        return 0.01 * self.ticks

    def wait_until(self, deadline):
        assert deadline == pytest.approx(self.now() + 0.01)
        self.ticks += 1

    def sample(self):
        if self.ticks % 2:
            raise pliant.ServoError("a lost reply")

    def resume_silent(self):
        return np.array([True]) if self.ticks == self.answers else None

    def unknown_joints(self):
        return ["elbow"]


def test_a_descent_waits_for_a_silent_joint_for_a_limited_time():
    answering, aborted, silent = Silent(100), Silent(), Silent()
    assert _wait_for_silent(answering, 100.0, lambda: False) == [True]
    assert answering.ticks == 100
    assert _wait_for_silent(aborted, 100.0, lambda: aborted.ticks >= 7) is None
    assert aborted.ticks == 7
    with pytest.raises(pliant.ServoFaultError, match=r"no answer from elbow.*torque stays"):
        _wait_for_silent(silent, 100.0, lambda: False)
    assert silent.now() == pytest.approx(UNKNOWN_TIME, abs=0.011)


def standing(arm, weight, load=0.0):
    """Return an arm that stands still and needs the torques `weight` (n,) [N·m], without `load`."""
    return SimpleNamespace(
        servos=arm.servos, model=arm.model, q=np.zeros(5), load=load, gravity=lambda: weight
    )


def mismatch(io, leads, **options):
    return stiffness_mismatch(io, stiffness_ratio(io, leads, **options))


def test_a_stiffness_is_judged_by_leads_that_are_large_enough():
    arm = bare_arm("so101")
    kp, friction = arm.servos.kp[1], arm.servos.friction[1]
    step = np.asarray(arm.servos.encoder_step)[1]

    def is_warned(weight, lead):
        weights, leads = np.zeros(5), np.zeros(5)
        weights[1], leads[1] = weight, lead
        io = standing(arm, weights)
        return mismatch(io, leads) is not None

    # Rows about the ratio of stiffness (two), friction, encoder step, share of the expected lead.
    for accepted, warned in (
        ((1.0, 1.0 / kp / 1.45), (1.0, 1.0 / kp / 1.55)),
        ((1.0, 1.45 / kp), (1.0, 1.55 / kp)),
        ((2.9 * friction, 9.0 * friction / kp), (3.1 * friction, 9.0 * friction / kp)),
        ((0.8, 2.9 * step), (0.8, 3.1 * step)),
        ((1.9, 0.019 * 1.9 / kp), (1.9, 0.021 * 1.9 / kp)),
    ):
        assert not is_warned(*accepted), accepted
        assert is_warned(*warned), warned


def test_a_load_is_not_taken_for_soft_servos():
    arm = bare_arm("so101")
    q, kp = np.zeros(5), np.asarray(arm.servos.kp)
    weight = np.asarray(arm.model.gravity(q))
    loaded = robots.load("so101", payload=(0.3, (0.0, 0.0, 0.0)))
    leads = np.asarray(loaded.gravity(q)) / kp
    assert "elbow_flex" in mismatch(standing(arm, weight), leads)
    assert mismatch(standing(arm, weight, load=0.3), leads) is None


def test_an_arm_that_lies_on_its_table_is_not_called_stiff(monkeypatch):
    """After a descent the arm lies on the table, which carries part of its weight."""
    texts, post = [], MESSAGES.post

    def record(text, *arguments, **options):
        texts.append(text)
        return post(text, *arguments, **options)

    monkeypatch.setattr(MESSAGES, "post", record)
    options = {"backend": "sim", "handle_signals": False, "q": [0.0, -0.5, 0.5, 0.8, 0.0]}
    with pliant.connect("so101", **options) as arm:
        arm.lower()
        arm.enable()
        lying = arm.read().q
        share = arm.leads[2] * arm.servos.kp[2] / arm.model.gravity(lying)[2]
        arm.disable_torque()
    assert share < 0.5, "the table carries most of the weight of the forearm"
    assert not any("stiffer or softer" in text for text in texts)
    assert may_lie_on(arm.table, arm._points, lying)
    assert not may_lie_on(arm.table, arm._points, np.array([0.0, -0.3, 0.3, 0.9, 0.0]))
    assert not may_lie_on(None, arm._points, lying)


def test_only_a_lead_that_is_too_large_tells_about_the_servos_of_a_supported_arm():
    arm = bare_arm("so101")
    weights, kp = np.array([0.0, 1.0, 0.0, 0.0, 0.0]), np.asarray(arm.servos.kp)
    io = standing(arm, weights)
    for share, is_warned in ((0.2, False), (-0.5, False), (2.0, True)):
        leads = share * weights / kp
        assert mismatch(io, leads) is not None
        assert (mismatch(io, leads, is_supported=True) is not None) is is_warned


@pytest.mark.parametrize("dt", [0.004, 0.02])
def test_errors_of_the_disturbance_observer_have_three_equal_poles(dt):
    """The errors of displacement, speed and disturbance decay without oscillation."""
    pole, columns = 30.0, []
    for error in np.eye(3):
        observer = _DisturbanceObserver(0.0, np.zeros(1))
        observer._squares = np.inf  # long after the start
        observer.x, observer.v, observer.d = (np.array([value]) for value in error)
        observer.update(dt, np.zeros(1), pole)
        columns.append(np.concatenate([observer.x, observer.v, observer.d]))
    expected = np.poly([np.exp(-pole * dt)] * 3)
    assert np.poly(np.transpose(columns)) == pytest.approx(expected, abs=1e-9)


def test_the_disturbance_observer_finds_a_load_from_rest_at_once():
    """The readings without noise are of a joint that falls from rest, with a brake after 20 ms."""
    d, u = np.array([-4.0]), np.array([3.0])
    observer = _DisturbanceObserver(0.0, np.zeros(1))
    observer.send(0.02, u)
    for k in range(1, 26):
        time = 0.004 * k
        braked = max(time - 0.02, 0.0)
        observer.update(time, 0.5 * d * time**2 + 0.5 * u * braked**2, 30.0)
    assert observer.d == pytest.approx(d, rel=0.05)
    assert observer.v == pytest.approx(d * 0.1 + u * 0.08, rel=0.05)
    x, v = observer.predict(0.15)
    assert v == pytest.approx(observer.v + (observer.d + u) * 0.05)
    assert x == pytest.approx(observer.x + observer.v * 0.05 + (observer.d + u) * 0.05**2 / 2)


def test_the_balance_of_an_arm_at_rest_takes_its_shortest_time():
    arm = bare_arm("so101", q=START)
    arm.open()
    io = arm._io
    io.sample()
    goal, limit, lead, taken = initial_commands(io, np.zeros(5, dtype=bool))
    io.orders = {name: (0.0, 0.1) for name in arm.grippers}
    io.start(goal, limit, lead)
    before = io.clock.now()
    transfer = _WeightTransfer(io, arm._points, io.q, taken, 100.0)
    torque = transfer._balance()
    assert MIN_BALANCE <= io.clock.now() - before < MIN_BALANCE + 0.02
    assert torque == pytest.approx(io.gravity(), abs=np.asarray(arm.servos.friction).max())


def test_the_balance_pushes_no_harder_than_for_the_largest_load():
    arm = bare_arm("so101", q=START)
    arm.open()
    arm._io.sample()
    q, model, friction = arm._io.q, arm.model, np.asarray(arm.servos.friction)
    transfer = _WeightTransfer(arm._io, arm._points, q, np.zeros(5, dtype=bool), 100.0)
    weight, h = np.asarray(model.gravity(q)), 1e-5
    heights = [
        [model.forward_kinematics(q + side * step)[2, 3] for side in (1.0, -1.0)]
        for step in h * np.eye(5)
    ]
    load = 0.6 * 9.81 * np.subtract(*np.transpose(heights)) / (2.0 * h)  # torque for 0.6 kg [N·m]
    beyond = 0.6 * np.abs(weight) + 2.0 * friction
    low, high = transfer._bounds
    usable = np.asarray(arm.servos.max_torque)
    assert low == pytest.approx(np.maximum(weight + np.minimum(load, 0.0) - beyond, -usable))
    assert high == pytest.approx(np.minimum(weight + np.maximum(load, 0.0) + beyond, usable))
    assert (low > -usable).sum() == 4
    for disturbance in (-1e6, 1e6):
        transfer._observer.d[:] = disturbance
        assert np.all((low <= transfer._control()) & (transfer._control() <= high))


def test_an_arm_moves_if_its_tool_sinks_or_rises_by_more_than_encoder_steps():
    arm = bare_arm("so101", q=START)
    arm.open()
    arm._io.sample()
    q = arm._io.q
    transfer = _WeightTransfer(arm._io, arm._points, q, np.zeros(5, dtype=bool), 100.0)
    lever = np.asarray(arm.model.jacobian(q))[2]  # height of the tool per joint angle [m/rad]
    direction = lever / (lever @ lever)
    for step in (0.0, 0.02):
        transfer._observer.step = np.full(5, step)
        margin = 0.5 * step * np.abs(lever).max()
        for height, moves in (
            (-SINK - margin - 1e-4, True),
            (-SINK - margin + 1e-4, False),
            (RISE + margin - 1e-4, False),
            (RISE + margin + 1e-4, True),
        ):
            transfer._x = height * direction
            assert transfer._is_moving() is moves


@pytest.mark.parametrize("ratios", [(-0.094, 1.0), (-0.094, 0.42), (1.0, 0.42)])
def test_a_joint_that_pushes_opposite_to_its_weight_is_not_called_soft(ratios):
    """The leads of two joints result from servos with these ratios of true to assumed k_p."""
    arm = bare_arm("so101")
    weight, kp = np.array([0.0, 1.0, 1.0, 0.0, 0.0]), np.asarray(arm.servos.kp)
    leads = np.zeros(5)
    leads[1:3] = weight[1:3] / kp[1:3] / np.array(ratios)
    io = standing(arm, weight)
    text = mismatch(io, leads)
    assert ("shoulder_lift pushes opposite to what its weight needs" in text) is (ratios[0] < 0.0)
    assert ("elbow_flex 0.42 x the assumed k_p" in text) is (ratios[1] < 1.0)
    assert "-0.0" not in text
