"""Simulated arms whose stiffness, friction or load differ from what the arm is told."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the arms are simulated: extra sim")

import pliant
from experiments.lifecycle import FaultyDrive, postures
from pliant import config, robots
from pliant.arm import Arm
from pliant.arm._startup import measured_servos
from pliant.loop import capture_leads
from pliant.sim import Plant

#: True stiffness over the one of the file. The mixed one is drawn for each joint.
RATIOS = {"a third": 3.0, "2.5 times": 0.4, "mixed": None}


class Session:
    """A simulated arm with torque on; it is let go as torque comes on.

    Args:
        ratio: True stiffness over the one that the arm is told (n,); None: drawn.
        known: True if the arm is told that this stiffness is known.
        friction: True friction over the one that the arm is told.
        load: Mass at the tool [kg], of which the arm is not told.
        q: Positions at which torque comes on (n,) [rad]; None: those of `seed`.

    Attributes:
        rise, sink: Largest motion of the tool as torque came on [m].
        time: Duration of torque on [s].
    """

    def __init__(self, name, ratio, seed, *, known=True, friction=1.0, load=0.0, q=None):
        model = robots.load(name)
        if ratio is None:
            ratio = np.random.default_rng(seed).uniform(0.5, 2.5, model.n)
        self.ratio = np.broadcast_to(ratio, model.n)
        options = {"payload": (load, np.zeros(3))} if load else {}
        self.plant = Plant(model, delay=(1, 1), kp_scale=ratio, friction_scale=friction, **options)
        self.plant.reset(postures(1, seed=seed, robot=name, load=load)[0] if q is None else q)
        table = self.plant.table.replace(stiffness_known=known)
        drive = FaultyDrive(self.plant, table)
        self.arm = Arm(model, drive, handle_signals=False)
        begin, start, height = drive.clock.now(), self.plant.tool[2, 3], []
        drive.clock.on_tick = lambda: height.append(self.plant.tool[2, 3])
        self.arm.enable()
        self.time = drive.clock.now() - begin
        self.rise, self.sink = max(height) - start, start - min(height)

    def hold(self, settings=None, *, duration=2.0, push=0.0):
        """Return the positions of the tool in a loop at one target, from its start (ticks, 3) [m].

        After 0.5 s, the tool gets the velocity `push` along x, y and z [m/s].
        """
        arm, start, target, away = self.arm, self.plant.tool[:3, 3].copy(), None, []
        settings = settings or pliant.Settings(task="xyz")
        controller = pliant.Controller(arm.model, settings, servos=arm.servos)
        for i, tick in enumerate(pliant.Loop(arm, controller, duration=duration)):
            target = arm.model.forward_kinematics(tick.q) if target is None else target
            if i == 50 and push:
                inverse = np.linalg.pinv(arm.model.jacobian(self.plant.q)[:3])
                self.plant.mj_data.qvel[: arm.model.n] += inverse @ np.full(3, push)
            tick.step(target)
            away.append(self.plant.tool[:3, 3] - start)
        return np.array(away)


@pytest.mark.parametrize("seed", [0, 1, 4])
@pytest.mark.parametrize("stated", RATIOS)
@pytest.mark.parametrize("name", ["arm7", "so101", "koch"])
def test_a_stiffness_that_is_stated_wrongly_does_not_lift_or_drop_the_arm(name, stated, seed):
    """If it is believed, the arms rise by up to 31, sink by up to 67 and then move by 25 mm."""
    session = Session(name, RATIOS[stated], seed)
    assert session.rise < 0.012
    assert session.sink < 0.020
    assert np.abs(session.hold()[:, 2]).max() < 0.010


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


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0, None])
@pytest.mark.parametrize(
    ("name", "load"), [("arm7", 0.0), ("arm7", 0.3), ("so101", 0.05), ("koch", 0.0), ("koch", 0.05)]
)
def test_torque_on_measures_the_stiffness_of_joints_that_carry_weight(name, load, ratio):
    found = []
    for seed in (1, 3, 4, 7):
        session = Session(name, ratio, seed, known=False, load=load)
        arm, table = session.arm, session.plant.table
        weight = np.abs(arm.model.gravity(session.plant.q)) + 1e-9
        clear = weight > 4.0 * np.asarray(table.friction)
        # Soft servos are believed stiffer, by a load that friction may hide.
        hidden = np.where(session.ratio < 1.0, 1.0 + 2.0 * table.friction / weight, 1.0)
        measured = np.asarray(arm.servos.kp) / table.kp
        assert np.all((measured / session.ratio / hidden)[clear] < 1.5)
        found += [*(measured / session.ratio)[clear]]
        assert not arm.servos.stiffness_known
        assert arm.model.servos == arm.servos
    assert len(found) > 1
    assert min(found) > 0.75


def measured(*ratios):
    """Return k_p of the servos that have these measured ratios, over the assumed k_p (n,)."""
    model = robots.load("so101")
    # So much weight that friction hides no load.
    io = SimpleNamespace(servos=model.servos, model=model, q=np.zeros(5), load=0.0)
    io.gravity = lambda: np.full(5, 1e9)
    return np.asarray(measured_servos(io, np.array(ratios)).kp) / np.asarray(io.servos.kp)


def test_a_servo_without_weight_is_assumed_to_be_like_the_others_if_these_agree():
    unknown = np.nan
    for ratios, expected in (
        ((unknown,) * 5, (1.0, 1.0, 1.0, 1.0, 1.0)),
        ((unknown, 2.0, 2.4, 2.2, unknown), (2.2, 2.0, 2.4, 2.2, 2.2)),
        ((unknown, 0.5, 0.6, unknown, unknown), (0.55, 0.5, 0.6, 0.55, 0.55)),
        # They do not agree.
        ((unknown, 2.0, 0.6, unknown, unknown), (1.0, 2.0, 0.6, 1.0, 1.0)),
        # One of them says little about the others.
        ((unknown, 2.25, unknown, unknown, unknown), (1.5, 2.25, 1.5, 1.5, 1.5)),
        # Friction explains a ratio near 1, and no servo is 10 times as stiff or pushes downward.
        ((unknown, 1.24, 0.81, unknown, unknown), (1.0, 1.0, 1.0, 1.0, 1.0)),
        ((unknown, 10.0, 2.5, unknown, unknown), (2.5, 2.5, 2.5, 2.5, 2.5)),
        ((unknown, 0.01, -1.0, unknown, unknown), (0.4**0.5, 0.4, 0.4**0.5, 0.4**0.5, 0.4**0.5)),
    ):
        assert measured(*ratios) == pytest.approx(np.array(expected)), ratios


@pytest.mark.parametrize("load", [0.0, 0.03, 0.05])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_torque_on_measures_the_load(ratio, load):
    for seed in (0, 1, 2):
        assert Session("koch", ratio, seed, known=False, load=load).arm.load == pytest.approx(
            load, abs=0.016
        )


def test_what_is_known_is_not_measured():
    arm = Session("so101", 1.0, 1).arm
    assert arm.load == 0.0
    assert arm.servos == robots.load("so101").servos


def test_an_arm_that_lies_on_its_table_is_not_measured():
    """Its table carries a part of the weight, so that its servos seem stiffer."""
    with pliant.connect("koch", backend="sim", q=config.load("koch").life.rest_q) as arm:
        assert [*arm.servos.kp] == [*arm.drive.servos.kp[:5]]
        assert np.isfinite(arm.leads).any()
        assert np.isnan(arm._free_leads).all()
        arm.disable_torque()


@pytest.mark.parametrize(("ratio", "load"), [(0.5, 0.0), (2.0, 0.0), (0.5, 0.05), (1.0, 0.05)])
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_a_soft_arm_stays_where_it_is(name, ratio, load):
    """By the stiffness of the table and the weight of the model it moves by up to 0.5 m."""
    settings = pliant.Settings.soft("x y z", task="xyz")
    for seed in (1, 3, 5):
        away = Session(name, ratio, seed, known=False, load=load).hold(settings, duration=4.0)
        assert np.abs(away).max() < 0.030, seed


@pytest.mark.parametrize("axes", ["x y", "x y z"])
@pytest.mark.parametrize("ratio", [2.0, 2.5])
@pytest.mark.parametrize("name", ["so101", "koch"])
def test_axes_that_yield_do_not_oscillate_after_a_push(name, ratio, axes):
    """By the stiffness of the table they do, by 50 to 90 mm."""
    session = Session(name, ratio, 1, known=False, friction=0.5)
    away = session.hold(pliant.Settings.soft(axes, task="xyz"), duration=6.0, push=0.15)
    assert np.ptp(away[-150:], axis=0).max() < 0.002


def test_the_load_adds_to_the_payload_of_the_model_once():
    session = Session("koch", 1.0, 1, known=False, load=0.05)
    arm = session.arm
    controller = pliant.Controller(arm.model, pliant.Settings(task="xyz"), arm.servos)
    for _ in range(2):
        for tick in pliant.Loop(arm, controller, duration=0.1):
            tick.step(arm.model.forward_kinematics(tick.q))
        assert controller.payload == pliant.Payload(arm.load)
    controller.set_payload(0.02)
    for tick in pliant.Loop(arm, controller, duration=0.1):
        tick.step(arm.model.forward_kinematics(tick.q))
    assert controller.payload == pliant.Payload(0.02)


def test_the_load_and_a_payload_of_the_model_have_a_common_centre_of_mass():
    model = robots.load("koch", payload=(0.02, (0.03, 0.0, 0.0)))
    arm = SimpleNamespace(
        model=model,
        servos=model.servos.replace(stiffness_known=False),
        load=0.04,
        _free_leads=np.zeros(model.n),
        _leads_q=np.zeros(model.n),
        _leads_mass=None,
        _loaded=[],
    )
    controller = pliant.Controller(model, pliant.Settings(task="xyz"), arm.servos)
    capture_leads(arm, controller)
    assert controller.payload.mass == pytest.approx(0.06)
    assert controller.payload.com == pytest.approx([0.01, 0.0, 0.0])


def test_a_lead_that_raises_its_joint_at_last_does_not_raise_it_further():
    """Without the reduction by half of the friction, the arm rises by up to 12 mm."""
    for seed in (0, 1, 2, 3):
        away = Session("so101", 0.5, seed, known=False).hold(pliant.Settings.firm(task="xyz"))
        assert away[:, 2].max() < 0.004


@pytest.mark.parametrize(("name", "load"), [("koch", 0.1), ("koch", 0.2), ("so101", 0.1)])
def test_hand_guiding_carries_the_load_that_torque_on_measured(name, load):
    """Without it, hand guiding is refused, or the arm falls."""
    for seed in (0, 1, 4):
        session = Session(name, 1.0 if seed < 3 else 2.0, seed, known=False, load=load)
        guiding, height = pliant.HandGuiding(session.arm.model, session.arm.servos), []
        for tick in pliant.Loop(session.arm, guiding, duration=12.0):
            tick.step()
            height.append(session.plant.tool[2, 3])
        assert guiding.payload == pliant.Payload(session.arm.load)
        assert guiding.ready
        assert abs(height[-1] - height[0]) < 0.025, seed


def test_leads_follow_a_payload_that_is_set_after_torque_on():
    """With the leads of the loaded arm, it would rise by up to 0.2 m once the load is put down."""
    model = robots.load("koch")
    q, kp = np.array([0.0, -0.5, 0.5, 0.5, 0.0]), np.asarray(model.servos.kp)
    unit = np.asarray(robots.load("koch", payload=(1.0, np.zeros(3))).gravity(q)) - model.gravity(q)
    leads = (model.gravity(q) + 0.1 * unit) / kp
    arm = SimpleNamespace(
        model=model,
        servos=model.servos.replace(stiffness_known=False),
        load=0.1,
        _free_leads=np.where(np.arange(5) == 3, np.nan, leads),
        _leads_q=q,
        _leads_mass=None,
        _loaded=[],
    )
    controller = SimpleNamespace(payload=None, found=None)
    controller.capture_gravity = lambda q, goal: setattr(controller, "found", goal - q)
    controller.set_payload = lambda *values: setattr(controller, "payload", pliant.Payload(*values))
    capture_leads(arm, controller)
    assert controller.payload.mass == pytest.approx(0.1)
    assert controller.found == pytest.approx(leads, abs=1e-6)
    for mass in (0.0, 0.05):
        controller.set_payload(mass)
        capture_leads(arm, controller)
        assert controller.payload.mass == mass
        assert controller.found == pytest.approx(leads + (mass - 0.1) * unit / kp, abs=1e-6)
    # The load is added once, also if the payload is that of the model again.
    controller.payload = None
    capture_leads(arm, controller)
    assert controller.payload is None


def test_a_load_on_the_table_does_not_lift_the_arm():
    options = {"backend": "sim", "kp_scale": 2.0, "payload": (0.1, np.zeros(3))}
    rest = config.load("koch").life.rest_q
    with pliant.connect("koch", q=rest, handle_signals=False, **options) as arm:
        assert arm.load == 0.0
        settings = pliant.Settings.soft("x y z", task="xyz")
        controller, height = pliant.Controller(arm.model, settings, arm.servos), []
        target = arm.model.forward_kinematics(arm.read().q)
        for tick in pliant.Loop(arm, controller, duration=2.0):
            tick.step(target)
            height.append(arm.drive.plant.tool[2, 3])
        arm.disable_torque()
    assert max(height) - height[0] < 0.005
