"""Value classes such as `Settings`: immutable, keyword-only, comparable, picklable, `repr`."""

from __future__ import annotations

import copy
import pickle
import string
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pliant
from pliant import (
    Axis,
    Compensation,
    NullSpace,
    Payload,
    Pose,
    Servos,
    Settings,
    Task,
    TorqueLimits,
    Tracking,
)
from pliant.functional import PaperOptions

ROOM = {
    kind.__name__: kind
    for kind in (
        Axis,
        Compensation,
        NullSpace,
        PaperOptions,
        Payload,
        Pose,
        Servos,
        Settings,
        Task,
        TorqueLimits,
        Tracking,
    )
}


def number(low, high):
    return st.floats(low, high, allow_nan=False)


def sides(low, high):
    return st.one_of(number(low, high), st.tuples(number(low, high), number(low, high)))


def maybe(strategy):
    return st.one_of(st.none(), strategy)


@st.composite
def axes(draw):
    fields = {
        "soft": draw(sides(0, 10)),
        "firm": draw(maybe(sides(0, 20))),
        "hold": draw(maybe(number(0, 50))),
        "yields": draw(st.sampled_from(["both", "+", "-"])),
        "adaptation": draw(number(0, 0.999)),
        "soft_until": draw(maybe(number(0, 1))),
        "firm_from": draw(maybe(number(1e-3, 1))),
        "profile": draw(st.sampled_from(["hardening", "constant", "softening"])),
        "max_velocity": draw(maybe(st.one_of(number(1e-3, 10), st.just(float("inf"))))),
        "soft_step_limit": draw(maybe(number(1e-3, 10))),
    }
    if fields["firm"] is not None:
        low, high = (np.broadcast_to(fields[key], 2) for key in ("soft", "firm"))
        fields["soft"] = tuple(float(x) for x in np.minimum(low, high))
    if fields["soft_until"] is not None and fields["firm_from"] is not None:
        fields["firm_from"] += fields["soft_until"]
    return Axis(**fields)


joint_values = st.lists(number(0.1, 3.0), min_size=7, max_size=7)


@st.composite
def some(draw, group, **fields):
    """Return a group of settings with a random choice of fields."""
    names = draw(st.sets(st.sampled_from(sorted(fields))))
    return group(**{name: draw(fields[name]) for name in sorted(names)})


@st.composite
def some_settings(draw):
    fields = {
        "task": draw(st.sampled_from(["xyz rpy", Task("xyz rpy", frame="tool")])),
        "axes": draw(st.dictionaries(st.sampled_from(Task().names), axes())),
        "law": draw(st.sampled_from(["cap", "paper"])),
        "rate": draw(number(1, 1000)),
        "gravity": draw(st.booleans()),
        "max_tool_speed": draw(maybe(st.one_of(number(1e-3, 1), st.just((None, 2.0))))),
        "accept_high_adaptation": draw(st.booleans()),
    }
    groups = {
        "tracking": some(
            Tracking,
            gain=st.one_of(number(0, 100), st.lists(number(0, 100), min_size=6, max_size=6)),
            damping=maybe(st.one_of(number(0, 10), st.just((0.02, 0.15, 0.15)))),
        ),
        "null_space": some(
            NullSpace,
            gain=maybe(number(0, 100)),
            posture=maybe(joint_values),
            max_speed=maybe(number(0, 10)),
        ),
        "compensation": some(Compensation, friction=number(0, 1), delay=number(0, 1)),
        "torque_limits": some(TorqueLimits, margin=number(0, 1), floor=maybe(joint_values)),
        "paper_options": some(
            PaperOptions,
            follow=st.sampled_from([None, "free", "hold"]),
            limits=st.sampled_from(["demand", "sum"]),
            kq=st.one_of(number(0, 10), st.just(np.eye(7))),
            gravity_use=st.sampled_from(["both", "goal", "limits"]),
            lead_limit=maybe(st.one_of(number(1e-3, 1), st.just(float("inf")))),
            raw_deviation=st.booleans(),
        ),
    }
    names = draw(st.sets(st.sampled_from(sorted([*fields, *groups]))))
    if draw(st.booleans()):
        springs = Axis(stiffness=draw(sides(0, 1e3)), damping=draw(maybe(sides(0, 40))))
        return Settings(
            law="impedance",
            axes={"x": springs},
            null_space=NullSpace(stiffness=draw(number(0, 60))),
        )
    fields |= {name: draw(groups[name]) for name in sorted(names & groups.keys())}
    return Settings(**{name: fields[name] for name in names})


@given(some_settings())
def test_settings_round_trip(settings):
    assert eval(repr(settings), ROOM) == settings
    assert pickle.loads(pickle.dumps(settings)) == settings
    assert copy.deepcopy(settings) == copy.copy(settings) == settings.replace() == settings


VALUES = [
    Axis(),
    Axis(soft=(1.0, 2.0), firm=3.0, yields="+", max_velocity=float("inf")),
    Task("x z pitch", frame=[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], length=0.3),
    Servos(kp=[100.0, 50.0], max_torque=5.0, limit_type="pwm", no_load_speed=[6.0, 7.0]),
    Servos(kp=100.0, max_torque=5.0),
    Servos(
        kp=[9.0, 8.0], max_torque=5.0, load_friction=0.2, stribeck=[0.1, 0.0], stribeck_speed=2.0
    ),
    Payload(0.5, (0.0, 0.1, 0.2)),
    Pose.from_rpy([0.1, 0.2, 0.3], [0.4, 0.5, 0.6]),
]


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_other_values_round_trip(value):
    assert eval(repr(value), ROOM) == value
    assert pickle.loads(pickle.dumps(value)) == value
    assert copy.deepcopy(value) == value
    assert value != 3
    assert type(value).__module__ == "pliant"


def test_repr_shows_what_is_not_the_default():
    assert repr(Settings()) == "Settings()"
    text = repr(
        Settings(
            rate=200, axes={"y": Axis(soft=2)}, null_space=NullSpace(max_speed=None), task="xyz"
        )
    )
    assert text == "Settings(task=Task(axes='xyz'), axes={'y': Axis(soft=2.0)}, rate=200.0)"
    assert repr(Task("all")) == "Task()"


def test_they_are_frozen():
    for value in (Settings(), Axis(), Task(), VALUES[3]):
        name = {"Settings": "rate", "Axis": "adaptation", "Task": "axes", "Servos": "kp"}[
            type(value).__name__
        ]
        with pytest.raises(AttributeError):
            setattr(value, name, 1.0)
    with pytest.raises(ValueError, match="read-only"):
        VALUES[3].kp[0] = 1.0
    with pytest.raises(TypeError):
        Settings().axes["y"] = Axis()


def test_fields_read_as_given():
    settings = Settings(
        axes={"y yaw": Axis(soft=2.0, firm=(3.0, 4.0))},
        tracking=Tracking(gain=[1, 2, 3, 4, 5, 6], damping=(0.02, 0.15, 0.2), goal_slew=None),
        max_tool_speed=0.1,
        max_tool_acceleration=None,
        null_space=NullSpace(posture=np.zeros(7, dtype=np.float32)),
        paper_options=PaperOptions(gravity_use="limits"),
    )
    assert settings.axes["yaw"] == settings.axes["y"]
    assert settings.axes["y"].soft == (2.0, 2.0)
    assert settings.axes["y"].firm == (3.0, 4.0)
    assert settings.axes["x"] == Axis()
    assert isinstance(settings.axes, MappingProxyType)
    assert settings.tracking.gain == [1, 2, 3, 4, 5, 6]
    assert settings.tracking.damping == (0.02, 0.15, 0.2)
    assert settings.max_tool_speed == (0.1, 0.4)
    assert settings.max_tool_acceleration == (float("inf"),) * 2
    assert settings.tracking.goal_slew == float("inf")
    assert settings.null_space.posture.dtype == np.float64
    assert settings.gravity is True
    assert settings.paper_options.gravity_use == "limits"
    assert PaperOptions(kq=np.eye(6)).kq == np.eye(6).tolist()
    with pytest.raises(pliant.ShapeError, match=r"tracking\.gain has shape \(6, 6\)"):
        Tracking(gain=np.eye(6))
    assert Task("yaw x").names == ("x", "yaw")
    assert len(Task("x z pitch")) == 3
    servos = Servos(kp=[100, 50], max_torque=5)
    assert servos.max_torque.tolist() == [5.0, 5.0]
    assert len(servos) == 2
    assert servos.no_load_speed is None


def test_replace_changes_only_what_it_names():
    settings = Settings.soft("y", rate=200.0)
    other = settings.replace(rate=50.0)
    assert other.axes == settings.axes
    assert other.rate == 50.0
    assert settings.rate == 200.0
    assert Axis(soft=1.0).replace(firm=5.0) == Axis(soft=1.0, firm=5.0)
    assert settings.replace(axes={}) == Settings(rate=200.0)


def test_a_group_changes_only_the_fields_that_it_was_given():
    door = Settings.door(null_space=NullSpace(max_torque=1.0), tracking=Tracking(gain=3.0))
    assert door.null_space == NullSpace(gain=1.0, max_torque=1.0)
    assert door.tracking == Tracking(gain=3.0)
    paper = Settings.paper(tracking=Tracking(gain=3.0).replace(damping=0.1))
    assert paper.tracking == Tracking(gain=3.0, damping=0.1, goal_slew=None)
    assert Settings.paper(tracking=Tracking(goal_slew=1.0)).tracking.goal_slew == 1.0
    slower = door.replace(tracking=Tracking(goal_slew=0.5))
    assert slower.tracking == Tracking(gain=3.0, goal_slew=0.5)
    # Setting a group sets all its fields, also those that the preset gives.
    assert Settings.door(null_space=Settings().null_space).null_space == NullSpace()
    # Copies and pickles remember which fields were given.
    for group in (
        copy.copy(Tracking(gain=3.0)),
        pickle.loads(pickle.dumps(Tracking(gain=3.0))),
    ):
        assert Settings.paper(tracking=group).tracking.goal_slew == float("inf")
    assert repr(Tracking(gain=4.0)) == "Tracking(gain=4.0)"
    assert repr(Settings(tracking=Tracking(gain=3.0))) == "Settings(tracking=Tracking(gain=3.0))"


def test_presets():
    assert Settings.firm() == Settings()
    paper = Settings.paper()
    assert paper.law == "paper"
    assert paper.gravity is False
    assert all(axis == Axis() for axis in paper.axes.values())
    door = Settings.door()
    assert [name for name, axis in door.axes.items() if axis.yields] == ["y", "yaw"]
    assert door.axes["y"].adaptation == 0.999
    assert door.accept_high_adaptation
    guiding = Settings.hand_guiding(task="xyz", axes={"z": Axis(hold=20.0)})
    assert [name for name, axis in guiding.axes.items() if axis.yields] == ["x", "y"]
    assert guiding.axes["z"] == Axis(hold=20.0)
    assert guiding.null_space.gain == 1.0
    soft = Settings.soft("y", axes={"x": Axis(hold=30.0)}, rate=200.0)
    assert soft.axes["y"] == Axis(yields="both", adaptation=0.9)
    assert soft.axes["x"].hold == 30.0
    assert soft.rate == 200.0
    with pytest.raises(pliant.ConfigError, match="'yaw' is not an axis of the task"):
        Settings.soft("yaw", task="xyz")


def test_presets_make_controllers(model):
    for settings in (
        Settings.paper(),
        Settings.firm(),
        Settings.door(),
        Settings.hand_guiding(),
        Settings.soft("y yaw"),
        Settings.soft("z", task="xyz"),
    ):
        assert pliant.Controller(model, settings).settings == settings


INVALID = {
    "an unknown field": (
        lambda: Settings(lwa="cap"),
        r"lwa: Settings has no such field; did you mean 'law'\?",
    ),
    "an unknown field of an axis": (
        lambda: Axis(sofft=1.0),
        r"did you mean 'soft'\? Fields: soft, firm",
    ),
    "an unknown field in replace": (lambda: Task().replace(axis="x"), r"did you mean 'axes'\?"),
    "an unknown word": (
        lambda: Settings(law="papr"),
        r"law: must be one of 'cap', 'impedance', 'paper', got 'papr' \(str\); did you mean "
        r"'paper'\?",
    ),
    "a number for a word": (
        lambda: Axis(yields=1),
        r"yields: must be one of 'both', '\+', '-', 'none', got 1",
    ),
    "text for a number": (lambda: Settings(rate="fast"), r"rate: must be a number, got 'fast'"),
    "a flag for a number": (
        lambda: Axis(adaptation=True),
        r"adaptation: must be a number, got "
        "True",
    ),
    "a number for a flag": (
        lambda: Settings(paper_options=PaperOptions(raw_deviation=1)),
        r"must be True or False, got 1",
    ),
    "a triple for a pair": (lambda: Axis(soft=(1, 2, 3)), r"soft: must be a number, or a pair"),
    "a gravity": (lambda: Settings(gravity="off"), r"gravity: must be True or False, got 'off'"),
    "an unknown field of a group": (
        lambda: Tracking(gian=1.0),
        r"gian: Tracking has no such field; did you mean 'gain'\?",
    ),
    "an unknown group": (lambda: Settings(trackin=Tracking()), r"did you mean 'tracking'\?"),
    "a field outside its group": (
        lambda: Settings(goal_slew=1.0),
        r"goal_slew: .*; use tracking=Tracking\(goal_slew=...\)",
    ),
    "another group": (
        lambda: Settings(tracking=NullSpace()),
        r"tracking: must be a Tracking such as Tracking\(gain=...\), got NullSpace\(\)",
    ),
    "a key twice": (
        lambda: Settings(axes={"y": Axis(), "xyz": Axis()}),
        r"axes: 'y' is named by both 'y' and 'xyz'",
    ),
    "no axis": (lambda: Settings(axes={"y": 2.0}), r"axes.y: must be an Axis, got 2.0"),
    "no mapping": (lambda: Settings(axes=["y"]), r"axes: must be a dict"),
    "an unknown key": (
        lambda: Settings(axes={"q": Axis()}),
        r"axes: 'q' is not an axis; use names",
    ),
    "an unknown task": (lambda: Task("xq"), r"task.axes: 'xq' is not an axis"),
    "a frame": (lambda: Task(frame="world"), r"frame: must be 'base', 'tool' or a 3x3"),
    "no rotation": (lambda: Task(frame=np.ones((3, 3))), r"task.frame: .*not a rotation"),
    "an axis without effect": (lambda: Axis(adaptation=0.5), r"Axis.adaptation: 0.5 has no effect"),
    "a risk": (
        lambda: Settings(accept_high_stifness=True),
        r"did you mean 'accept_high_stiffness'\?",
    ),
    "servos without torque": (lambda: Servos(kp=1.0), r"servos.max_torque: is required"),
    "duty without speed": (
        lambda: Servos(kp=1.0, max_torque=1.0, limit_type="pwm"),
        r"servos.no_load_speed: limit_type=\"pwm\" needs",
    ),
    "an unknown keyword of a model": (
        lambda: pliant.Model.from_urdf_str("", bsae="x"),
        r"bsae: no such keyword; did you mean 'base'\?",
    ),
}


@pytest.mark.parametrize("case", INVALID)
def test_invalid_settings_are_reported_with_a_remedy(case):
    call, message = INVALID[case]
    with pytest.raises(pliant.ConfigError, match=message) as error:
        call()
    assert error.value.key


def test_numbers_outside_their_bounds():
    for call, description in (
        (lambda: Axis(adaptation=1.0, soft=1.0), "Axis.adaptation"),
        (lambda: Settings(rate=0.0), "rate [Hz]"),
        (lambda: Settings(rate=None), "rate [Hz]"),
        (lambda: Tracking(gain=-1.0), "tracking.gain [1/s]"),
        (lambda: NullSpace(gain=-1.0), "null_space.gain [1/s]"),
        (lambda: Settings(rate=float("nan")), "rate [Hz]"),
        (lambda: Servos(kp=[1.0, -1.0], max_torque=1.0), "servos.kp[1]"),
        (lambda: Payload(-1.0), "payload.mass [kg]"),
    ):
        with pytest.raises(pliant.OutOfRangeError) as error:
            call()
        assert error.value.what == description
        assert error.value.bound
    with pytest.raises(pliant.ShapeError, match=r"servos.kp has shape \(2,\), expected \(3,\)"):
        Servos(kp=[1.0, 2.0], max_torque=[1.0, 2.0, 3.0])


@given(st.text(string.printable, max_size=12))
def test_no_axis_key_gets_past_the_reader(key):
    try:
        names = Task(key).names
    except pliant.ConfigError:
        return
    assert names
    assert set(names) <= set(Task().names)


def test_springs_belong_to_law_impedance():
    springs = {"y": Axis(stiffness=(100.0, 50.0), damping=5.0)}
    settings = Settings(law="impedance", axes=springs, null_space=NullSpace(stiffness=2.0))
    assert settings.axes["y"].stiffness == (100.0, 50.0)
    assert settings.axes["y"].damping == (5.0, 5.0)
    with pytest.raises(pliant.ConfigError, match=r'axes\.y\.stiffness: belongs to law="impedance"'):
        Settings(axes=springs)
    with pytest.raises(pliant.ConfigError, match=r"null_space\.stiffness: belongs to law"):
        Settings(law="paper", null_space=NullSpace(stiffness=2.0))
    with pytest.raises(pliant.ConfigError, match=r"has no inverse kinematics"):
        Settings(law="impedance", paper_options=PaperOptions(follow="hold"))
    with pytest.raises(pliant.OutOfRangeError, match=r"stiffness = -1 is outside"):
        Axis(stiffness=-1.0)
