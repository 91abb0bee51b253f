"""The session of `pliant servos doctor --measure` with emulated servos of an unknown model.

The servos are stronger than assumed, and the arm carries a load that the model lacks; the file of
measurements must show both.
"""

import getpass
import io
import json
import platform
import re
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mismatch import Mismatch, Parameters

pytest.importorskip("mujoco", reason="the simulated arm needs the extra sim")
pytest.importorskip("rustypot", reason="servo buses need the extra servo")

import pliant
from pliant import config
from pliant.arm import Arm
from pliant.cli import main
from pliant.cli._console import Keyboard
from pliant.cli._measurements import UNITS, Measurements
from pliant.cli.servos._measure import MIN_READING, G, Session, grams
from pliant.config import factory
from pliant.emulator import ManualClock, models
from pliant.sim import Drag, ForceProfile

#: Model number of the unknown servo, ratio of its torque to that of the STS3215, and load at the
#: tool that the model lacks [kg].
NUMBER, TORQUE_RATIO, LOAD = 2825, 1.3, 0.08
#: Mass that the person hangs on the tool [kg], and start pose, with space below the tool [rad].
WEIGHT, POSE = 0.1, [0.0, -1.0, 0.7, 0.5, 0.0]
DOCS = Path(__file__).parents[2] / "docs" / "first_measurements.md"


class Person:
    """Simulated person: pushes the arm with a scale, hangs a weight on it, and answers questions.

    Attributes:
        shown: Questions and errors that were shown.
        skipped: Parts of the questions that the person answers with `skip`.
        stop: Part of the question at which the person presses Ctrl-C.
    """

    def __init__(self, bus, skipped=(), stop=None):
        self.bus, self.skipped, self.stop, self.shown = bus, skipped, stop, []
        self.scale = []

    def say(self, text):
        self.shown.append(text)
        self.start, self.acting = self.bus.time, False

    def discard(self):
        """Do nothing: this person types no answer before the question."""

    def line(self):
        question, plant, time = self.shown[-1], self.bus.plant, self.bus.time - self.start
        if self.stop is not None and self.stop in question:
            raise KeyboardInterrupt
        if any(fragment in question for fragment in self.skipped):
            return "skip\n"
        if "torque comes on" in question:
            return "\n"
        if match := re.search(r"yields along (.).*for (\d+) cm", question):
            return self.push(plant, match, 1.0 if "+y" in question else -1.0, time)
        if "weigh a weight" in question:
            if not self.acting:
                self.acting = True
                always = ForceProfile(start=0.0, rise=0.0, end=1e9)
                hand = Drag(axis="z", distance=-9.0, limit=WEIGHT * G, damping=0.0, at="tool")
                plant.set_hands([replace(hand, course=always)])
            return f"{WEIGHT * 1e3:.0f}\n" if time > 2.0 else None
        if "take the weight off" in question:
            plant.set_hands([])
        return "\n" if time > 0.2 else None

    def push(self, plant, match, sign, time):
        if not self.acting:
            self.acting, self.scale = True, []
            course = ForceProfile(start=plant.time + 0.5, rise=3.0, end=plant.time + 3.6)
            distance = sign * (float(match[2]) * 0.01 + 0.01)
            hand = Drag(axis=match[1], distance=distance, limit=40.0, at="tool", course=course)
            plant.set_hands([hand])
        if 2.5 < time < 3.5:
            self.scale.append(np.abs(plant.hands[0].force).max())
        if time < 5.0:
            return None
        plant.set_hands([])
        return f"{np.mean(self.scale) / G * 1e3:.0f}\n"


@contextmanager
def arm_of_unknown_servos(monkeypatch, folder, load=LOAD):
    """Yield an emulated SO-101 with unknown servos, its closed arm, and its configuration."""
    known = models.MODELS["STS3215-7.4V"]
    motor = replace(known.motor, stall=TORQUE_RATIO * known.motor.stall)
    monkeypatch.setitem(models.MODELS, known.name, replace(known, number=NUMBER, motor=motor))
    text = config.loader.builtin_text("so101").replace(
        "{ model", f"{{ model_number = {NUMBER}, model"
    )
    simulated = config.parse(text, backend="emulator", folder=folder)
    payload = {"payload": (load, (0.0, 0.0, 0.0))}
    with factory.make_emulator(simulated, q=POSE, clock="steps", plant=payload) as bus:
        arm_config = config.parse(text, port=bus.port, folder=folder)
        drive = factory.make_bus(
            arm_config.model_copy(update={"loop": with_long_timeout(arm_config)}),
            {"main": bus.port},
        )
        drive.clock = ManualClock(bus)
        yield (
            bus,
            Arm(
                arm_config.model(),
                drive,
                rest_q=arm_config.life.rest_q,
                table=arm_config.robot.table,
                grippers=factory.gripper_configs(arm_config),
                handle_signals=False,
            ),
            arm_config,
        )


def with_long_timeout(arm_config):
    """Return the loop of a configuration, with a reply timeout for a loaded machine."""
    return arm_config.loop.model_copy(update={"reply_timeout_min": 0.1})


def run(bus, arm, arm_config, path, **person):
    """Run a session; return the texts that the person was shown, and the contents of the file."""
    human = Person(bus, **person)
    try:
        Session(arm, arm_config, Measurements(path), human, human.say).run()
    except KeyboardInterrupt:
        human.shown.append("Ctrl-C")
    return human.shown, json.loads(path.read_text("utf-8"))


def is_limp(bus):
    """Return True if torque is off in all joints."""
    return not any(bus.servo(k).enabled for k in range(1, 6))


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Run a session without the identification.

    Returns:
        Contents of the file, its path, true k_p [N·m/rad], texts that were shown, and the port.
    """
    folder = tmp_path_factory.mktemp("session")
    path = folder / "arm.json"
    mismatch = Mismatch(plant=Parameters(payload=LOAD), assumed=Parameters(), compared=("payload",))
    with (
        pytest.MonkeyPatch.context() as patch,
        mismatch,
        arm_of_unknown_servos(patch, folder) as (bus, arm, arm_config),
    ):
        texts, data = run(bus, arm, arm_config, path, skipped=("swings every joint by 0.1",))
        assert is_limp(bus)
        bus.servo(2).put("torque_enable", 1)
        true_kp = bus.servo(2).drive().stiffness
        assert true_kp / arm.servos.kp[1] == pytest.approx(TORQUE_RATIO, rel=0.05)
        return data, path, true_kp, texts, bus.port


def test_the_weight_shows_a_wrong_stiffness_and_a_hidden_load(session):
    data, _, true_kp, _, _ = session
    weight = data["steps"]["weight"]
    measured = [joint for joint in weight["joints"] if joint["kp"] is not None]
    assert len(measured) >= 3
    for joint in measured:
        assert joint["kp"] == pytest.approx(true_kp, rel=0.08)
        assert joint["kp_assumed"] == pytest.approx(true_kp / TORQUE_RATIO, rel=0.05)
    assert weight["extra_mass"] == pytest.approx(LOAD, abs=0.01)


def test_the_scale_shows_that_the_servos_are_stronger_than_promised(session):
    pushes = session[0]["steps"]["push"]
    assert [(p["axis"], p["toward"]) for p in pushes] == [("y", "+"), ("y", "+"), ("x", "-")]
    # Friction cancels in the difference of two pushes along one axis.
    slope = (pushes[1]["measured"] - pushes[0]["measured"]) / (
        pushes[1]["promised"] - pushes[0]["promised"]
    )
    assert slope == pytest.approx(TORQUE_RATIO, rel=0.15)
    for push in pushes:
        error = push["measured"] - TORQUE_RATIO * push["promised"]
        assert abs(error) < 1.5 * push["friction_force"] + 0.3


def test_the_file_names_servos_latencies_and_the_ending(session):
    data, *_ = session
    assert [servo["model_number"] for servo in data["servos"]] == [NUMBER] * 6
    assert {servo["gain"] for servo in data["servos"]} == {16}
    assert set(data["steps"]) == {"bus", "push", "weight", "loop", "ending"}
    ending = data["steps"]["ending"]
    assert ending["drop"] > 0.05
    assert abs(ending["drop_after_torque_off"]) < 0.01
    assert data["steps"]["bus"]["read_lost"] == 0
    assert data["steps"]["loop"]["write_median"] > 0.0


def numbers(value, key=""):
    """Yield the key of each number in a part of the file: `value`, which has the key `key`."""
    if isinstance(value, dict):
        for name, item in value.items():
            yield from numbers(item, key if key == "counters" else name)
    elif isinstance(value, list):
        for item in value:
            yield from numbers(item, key)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key


def test_every_number_has_a_unit_and_a_line_in_the_document(session):
    data, *_ = session
    rows = re.findall(r"^\| (`.*?) \| (.+?) \|", DOCS.read_text("utf-8"), flags=re.MULTILINE)
    documented = {key for keys, _ in rows for key in re.findall(r"`(\w+)`", keys)}
    assert set(numbers(data)) | {"delay", "extra_mass_sigma", "damping"} <= documented
    assert data["units"] == UNITS


def test_the_file_has_no_private_data(session):
    _, path, _, _, port = session
    text = path.read_text("utf-8")
    for secret in (port, str(path.parent), str(Path.home()), platform.node(), getpass.getuser()):
        assert not re.search(rf"\b{re.escape(secret)}\b", text), secret


def test_every_step_says_first_what_arm_and_person_do(session):
    texts = session[3]
    assert len(texts) > 5
    assert all(re.match(r"Next: .*\. You: .*", text) for text in texts)


@pytest.mark.full
def test_identification_depends_on_the_stall_torque_of_the_table(tmp_path, monkeypatch):
    path = tmp_path / "arm.json"
    with arm_of_unknown_servos(monkeypatch, tmp_path) as (bus, arm, arm_config):
        _, data = run(bus, arm, arm_config, path, skipped=("yields along x",))
        true_kp = TORQUE_RATIO * arm.servos.kp[1]
    steps = data["steps"]
    pushes = steps["push"]
    slope = (pushes[1]["measured"] - pushes[0]["measured"]) / (
        pushes[1]["promised"] - pushes[0]["promised"]
    )
    identified = [joint["kp"] for joint in steps["servos"]["joints"][1:4]]
    by_weight = [joint["kp"] for joint in steps["weight"]["joints"][1:4]]
    assert np.median(identified) == pytest.approx(true_kp / TORQUE_RATIO, rel=0.12)
    assert slope * np.median(identified) == pytest.approx(true_kp, rel=0.15)
    assert by_weight == pytest.approx([true_kp] * 3, rel=0.08)


def test_ctrl_c_lowers_the_arm_and_the_next_session_continues(tmp_path, monkeypatch):
    path = tmp_path / "arm.json"
    skipped = ("swings", "yields along y")
    with arm_of_unknown_servos(monkeypatch, tmp_path, 0.0) as (bus, arm, arm_config):
        texts, data = run(bus, arm, arm_config, path, skipped=skipped, stop="is lowered")
        assert texts[-1] == "Ctrl-C"
        assert is_limp(bus)
        assert set(data["steps"]) == {"bus", "push", "loop"}
        pushes = data["steps"]["push"]
    with arm_of_unknown_servos(monkeypatch, tmp_path, 0.0) as (bus, arm, arm_config):
        texts, data = run(bus, arm, arm_config, path, skipped=("swings",))
        assert not any("yields along" in text for text in texts)
        assert data["steps"]["push"] == pushes
        assert "ending" in data["steps"]


def test_a_file_of_another_arm_is_not_continued(tmp_path, monkeypatch, session):
    path = tmp_path / "arm.json"
    data = json.loads(session[1].read_text("utf-8"))
    data["servos"][0]["firmware"] += 1
    path.write_text(json.dumps(data))
    with (
        arm_of_unknown_servos(monkeypatch, tmp_path) as (bus, arm, arm_config),
        pytest.raises(pliant.ConfigError, match="is of other servos"),
    ):
        run(bus, arm, arm_config, path)
    assert json.loads(path.read_text("utf-8")) == data


@pytest.mark.parametrize(
    "text",
    [
        '{"format": "pliant-measurements 1"}',
        '{"format": "pliant-measurements 2", "steps": {}, "servos": []}',
        '{"format": "pliant-measurements 1", "steps": {"weight": {"joints": 3}}, "servos": []}',
        '{"format": "pliant-measurements 1", "steps": 3, "servos": []}',
        '{"format": "pliant-measurements 1", "steps": {}, "servos": [1]}',
        '{"format": "pliant-measurements 1", "steps": ' + 9999 * "[",
    ],
)
def test_a_damaged_file_is_refused(text, tmp_path):
    (tmp_path / "arm.json").write_text(text)
    with pytest.raises(pliant.ConfigError, match=r"arm\.json cannot be continued"):
        Measurements(tmp_path / "arm.json")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("9000\n", r"9000 g is impossible: 1 to 3059 g here, 3 × the 10 N that the servos hold"),
        ("0\n", "0 g is impossible: 1 to"),
        ("-5\n", "-5 g is impossible"),
        ("nan\n", "nan g is impossible"),
        ("1e999\n", "inf g is impossible"),
        ("half a pound\n", "'half a pound' is not a number of grams"),
        ("\n", "'' is not a number of grams"),
    ],
)
def test_an_impossible_reading_is_refused_with_its_bound(line, message):
    with pytest.raises(pliant.ConfigError, match=message):
        grams(line, MIN_READING, 3.0, 10.0)
    assert grams(" 120 g\n", MIN_READING, 3.0, 10.0) == 120.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("servos doctor so101 --report a.json", "--report belongs to --measure"),
        ("servos doctor so101 --measure --watch", "give one"),
        ("servos doctor so101 --measure --backend sim", "backend 'sim' has none"),
        ("servos doctor so101 --measure --backend sim --report old.json", "is not a measurements"),
        ("identify so101 gravity --report a.json --backend sim", "--report belongs to servos"),
        ("identify so101 servos --report a.json --backend sim", "backend 'sim' has none"),
    ],
)
def test_flags_are_refused_before_torque_comes_on(
    arguments, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.json").write_text('{"servo": 1}')
    assert main(arguments.split()) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert [file.name for file in tmp_path.iterdir()] == ["old.json"]


def test_the_command_takes_its_answers_from_a_script(tmp_path, capsys, monkeypatch):
    path = tmp_path / "arm.json"
    argv = ["servos", "doctor", "so101", "--backend", "emulator", "--measure", "--report"]
    answers = "\nskip\n99999\nskip\nskip\nskip\nskip\n\n"
    monkeypatch.setattr("sys.stdin", io.StringIO(answers))
    assert main([*argv, str(path)]) == 0
    out = capsys.readouterr().out
    assert "99999 g is impossible" in out
    assert "drop after torque off, mm" in out
    data = json.loads(path.read_text("utf-8"))
    assert list(data["steps"]) == ["bus", "loop", "ending"]
    assert data["arm"]["backend"] == "emulator"


def test_the_end_of_the_answers_is_an_error(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("12\n"))
    keys, lines = Keyboard(), []

    def read_all():
        while True:
            lines.extend(line for line in [keys.line()] if line is not None)

    with pytest.raises(pliant.ConfigError, match="standard input ended"):
        read_all()
    assert lines == ["12\n"]
    assert not keys.pressed()
