"""Damaged texts, messages and pickles: an explained error or something that works.

Logs are in tests/log, servo packets in tests/emulator and tests/servo; the core has targets of its
own in fuzz/.
"""

from __future__ import annotations

import json
from copy import deepcopy
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import pliant
from pliant import config
from pliant.cli._targets import Target
from pliant.config.lerobot import read_calibration
from pliant.config.loader import builtin_text
from pliant.teach import Motion
from pliant.view import messages

MODEL = pliant.robots.so101()
#: Hypothesis runs many inputs per test; each overwrites the file in the folder of the test.
FOLDER = {"suppress_health_check": [HealthCheck.function_scoped_fixture], "deadline": None}

NUMBERS = st.one_of(
    st.floats(), st.integers(), st.sampled_from([10**400, -(10**400), 1e308, 5e-324, 2**31, 2**63])
)
VALUES = st.recursive(
    st.one_of(st.none(), st.booleans(), NUMBERS, st.text(max_size=12)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=5), st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=8,
)


def places(data, path=()):
    """Return the path of every entry of nested lists and tables."""
    items = enumerate(data) if isinstance(data, list) else data.items()
    for key, value in items:
        yield (*path, key)
        if isinstance(value, list | dict):
            yield from places(value, (*path, key))


@st.composite
def changed(draw, data, *, removed=True):
    """Return `data` with one to three entries replaced or, if allowed, removed."""
    data = deepcopy(data)
    for _ in range(draw(st.integers(1, 3))):
        found = list(places(data))
        if not found:
            break
        *path, last = draw(st.sampled_from(found))
        owner = data
        for key in path:
            owner = owner[key]
        if not removed or draw(st.integers(0, 3)):
            owner[last] = draw(VALUES)
        else:
            del owner[last]
    return data


MOTOR = {"id": 1, "drive_mode": 0, "homing_offset": -12, "range_min": 900, "range_max": 3100}
CALIBRATION = {"shoulder_pan": MOTOR, "gripper": {**MOTOR, "id": 2}}
TIMES = np.linspace(0.0, 0.4, 5).tolist()
MOTION = {
    "format": "pliant motion 1",
    "note": "",
    "start": [0.1, 0.0, 0.2],
    "joints": list(MODEL.joint_names),
    "extra": ["gripper"],
    "samples": [[time, *(0.1 * time,) * 5, 1.0] for time in TIMES],
}


def test_the_undamaged_files_are_read(tmp_path):
    file = tmp_path / "one.json"
    file.write_text(json.dumps(CALIBRATION))
    assert len(read_calibration(file)) == 2
    file.write_text(json.dumps(MOTION))
    assert Motion.load(file).duration == pytest.approx(0.4)


@settings(max_examples=150, **FOLDER)
@given(changed(CALIBRATION))
def test_calibrations(tmp_path, data):
    (tmp_path / "one.json").write_text(json.dumps(data))
    try:
        motors = read_calibration(tmp_path / "one.json")
    except pliant.ConfigError as error:
        assert "one.json" in str(error)  # noqa: PT017
    else:
        assert all(0.0 <= motor.middle <= 2**31 for motor in motors.values())


@settings(max_examples=150, **FOLDER)
@given(changed(MOTION))
def test_motions(tmp_path, data):
    (tmp_path / "one.json").write_text(json.dumps(data))
    try:
        motion = Motion.load(tmp_path / "one.json").for_model(MODEL)
    except pliant.PliantError as error:
        assert len(str(error)) > 10  # noqa: PT017
    else:
        for time in (0.0, 0.3 * motion.duration, motion.duration):
            assert np.isfinite(motion.at(time)).all()


@settings(max_examples=150, **FOLDER)
@given(st.binary(max_size=200))
@example(b"[" * 100_000)
@example(b"\xff\xfe{}")
def test_bytes_that_are_no_file(tmp_path, content):
    (tmp_path / "one.json").write_bytes(content)
    (tmp_path / "one.toml").write_bytes(content)
    for read, name in ((read_calibration, "one.json"), (Motion.load, "one.json")):
        with pytest.raises(pliant.ConfigError, match=r"one\.json"):
            read(tmp_path / name)
    with pytest.raises(pliant.ConfigError, match=r"one\.toml"):
        config.load(tmp_path / "one.toml")


LINES = builtin_text("so101").splitlines()
SCALARS = st.one_of(
    st.sampled_from(
        ["nan", "inf", "-inf", "true", "''", "[]", "{}", "1e308", "-1", "0", "9" * 400]
    ),
    st.floats().map(repr),
    st.integers().map(str),
    st.text(st.characters(codec="ascii", exclude_characters="'\n\r"), max_size=12).map(
        lambda text: f"'{text}'"
    ),
)


@st.composite
def toml(draw):
    """Return the ready file of the SO-101 with one to three lines changed."""
    lines = list(LINES)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(lines) - 1))
        key, equals, _ = lines[at].partition("=")
        match draw(st.integers(0, 4)):
            case 0:
                lines[at] = ""
            case 1:
                lines.insert(at, draw(st.sampled_from(lines)))
            case 2:
                lines.insert(at, f"{draw(st.sampled_from(['rate', 'x', 'law', 'soft']))} = 1")
            case _ if equals:
                lines[at] = f"{key}= {draw(SCALARS)}"
            case _:
                lines[at] = draw(st.text(max_size=20))
    return "\n".join(lines)


@settings(max_examples=150, deadline=None)
@given(toml())
def test_configurations(text):
    try:
        read = config.parse(text, source="arm.toml")
        model = read.model()
        pliant.Controller(model, read.settings())
    except pliant.PliantError as error:
        assert len(str(error)) > 10  # noqa: PT017


@pytest.mark.parametrize("text", ["a = " + "[" * 100_000, "a = " + "{a = " * 50_000])
def test_a_configuration_that_is_nested_too_deeply(text):
    with pytest.raises(pliant.ConfigError, match=r"arm\.toml is not TOML: it is nested too deeply"):
        config.parse(text, source="arm.toml")


def test_a_number_of_too_many_digits_in_a_configuration():
    with pytest.raises(pliant.ConfigError, match=r"arm\.toml is not TOML: .*digits"):
        config.parse("a = " + "9" * 5000, source="arm.toml")


@settings(max_examples=150, deadline=None)
@given(
    st.one_of(
        st.text(max_size=60),
        VALUES.map(json.dumps),
        st.dictionaries(
            st.sampled_from(["position", "wxyz", "xyzw", "q", "x"]),
            st.one_of(VALUES, st.lists(NUMBERS, min_size=3, max_size=5)),
            max_size=3,
        ).map(json.dumps),
    )
)
def test_lines_of_targets(line):
    try:
        target = Target.parse(line, MODEL)
    except pliant.ConfigError as error:
        assert len(str(error)) < 600  # noqa: PT017
    else:
        pose = target.pose(MODEL, MODEL.forward_kinematics(np.zeros(5)))
        assert np.isfinite(pose).all()


MESSAGES = [
    messages.Target(np.eye(4).tolist()),
    messages.Push([0.1, 0.0, 0.0], [0.0, 0.0, 0.0], 0.5),
    messages.Grab(2, [0.1, 0.0, 0.1], [0.1, 0.1, 0.1]),
]


@st.composite
def page_message(draw):
    """Return a message with one field replaced, or with a number of one of its lists replaced."""
    message = draw(st.sampled_from(MESSAGES))
    values = {field.name: getattr(message, field.name) for field in fields(message)}
    return type(message)(**draw(changed(values, removed=False)))


@settings(max_examples=150, deadline=None)
@given(page_message())
@example(messages.Push([10**400, 0, 0]))
@example(messages.Target((1e300 * np.eye(4)).tolist()))
@example(messages.Target([[1e300, 1e300, 0, 0], [1e300, -1e300, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]))
@example(messages.Grab(1, ["x", 0, 0], [0, 0, 0]))
def test_messages_of_the_page(message):
    try:
        match message:
            case messages.Target():
                assert np.isfinite(messages.check_target(message, MODEL)).all()
            case messages.Push():
                messages.check_push(message, (0.9, 0.5))
                assert np.abs(np.array(message.force, dtype=float)).max() <= 0.91
            case messages.Grab():
                messages.check_grab(message)
    except pliant.ConfigError as error:
        assert len(str(error)) < 400  # noqa: PT017


@pytest.fixture(scope="module")
def running():
    """Return a controller after some steps, a measured position and a target."""
    controller = pliant.Controller(MODEL, pliant.Settings.soft("y", task="xyz"), MODEL.servos)
    q = np.array([0.1, 0.4, 0.2, 0.3, 0.1])
    target = MODEL.forward_kinematics(q)
    for _ in range(3):
        controller.step(q, target)
    return controller, q, target


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_pickles_with_other_numbers(running, data):
    controller, q, target = running
    make, (model, told, servos, numbers) = controller.__reduce__()
    numbers = list(numbers)
    state = numbers[-1] = numbers[-1].copy()
    for _ in range(data.draw(st.integers(0, 4))):
        state[data.draw(st.integers(0, len(state) - 1))] = data.draw(st.floats())
    if data.draw(st.booleans()):
        at = data.draw(st.integers(0, len(numbers) - 1))
        numbers[at] = data.draw(VALUES)
    try:
        other = make(model, told, servos, tuple(numbers))
        command = other.step(q, target)
    except (pliant.PliantError, TypeError, ValueError, OverflowError) as error:
        assert len(str(error)) > 5  # noqa: PT017
    else:
        assert np.isfinite(command.goal).all()
        assert (command.torque_limit >= 0.0).all()
        assert (command.torque_limit <= MODEL.servos.max_torque).all()
