"""All commands: groups in the help, suggestions for typos, and one meaning per flag."""

import re
import tomllib
import warnings
from collections import defaultdict
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="commands load the extra sim")
pytest.importorskip("rustypot", reason="commands load the extra servo")

import tyro

from pliant import config
from pliant.cli import COMMANDS, GROUPS, PREFIXES, main
from pliant.cli.identify import _servo_lines
from pliant.config import factory
from pliant.identify import Identification
from pliant.identify._excitation import Excitation
from pliant.identify._regression import Delay, Solution

#: Commands that start other programs; their flags are not checked here.
EXPERIMENTS = set(GROUPS.get("experiments", {}))


def arguments(command):
    """Return the arguments of a command: flags by name, positional arguments by placeholder."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        parser = tyro.extras.get_parser(
            import_module(COMMANDS[command][0]).run,
            config=(tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes),
        )
    for action in parser._actions:
        name = next((o for o in action.option_strings if o.startswith("--")), action.metavar)
        if name != "--help":
            yield str(name), action


def meaning(action):
    """Return placeholder and first sentence of the help of an argument, without the default."""
    text = re.sub(r"\s*\((default: .*|required)\)\s*$", "", action.help or "")
    return str(action.metavar), re.split(r"(?<=[^.])\.(?:\s|$)", text)[0].strip()


def test_a_flag_means_the_same_everywhere():
    meanings = defaultdict(dict)
    for command in COMMANDS.keys() - EXPERIMENTS:
        for name, action in arguments(command):
            meanings[name].setdefault(meaning(action), []).append(command)
    shared = {"ARM", "LOG", "--backend", "--port", "--soft", "--duration", "--output", "--log"}
    assert shared <= {name for name, known in meanings.items() if sum(map(len, known.values())) > 1}
    assert {name: known for name, known in meanings.items() if len(known) > 1} == {}


def test_a_port_is_a_serial_port_and_a_page_has_another_flag():
    for command in COMMANDS.keys() - EXPERIMENTS:
        for name, action in arguments(command):
            if name == "--port":
                assert action.metavar == "DEVICE", command
            assert name not in {"--page", "--out", "--to", "--seconds", "--robot", "-o"}, command


def test_help_shows_the_groups(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    for title, group in GROUPS.items():
        block = out.partition(f"\n{title}:\n")[2].partition("\n\n")[0]
        assert [re.split(r"\s{2,}", line.strip()) for line in block.splitlines()] == [
            [name, summary] for name, (_, summary) in group.items()
        ]


@pytest.mark.parametrize("prefix", PREFIXES)
@pytest.mark.parametrize("flags", [[], ["--help"]])
def test_a_first_word_alone_lists_its_commands(prefix, flags, capsys):
    assert main([prefix, *flags]) == 0
    out = capsys.readouterr().out
    for name in COMMANDS:
        assert (f"\n  {name} " in out) == name.startswith(f"{prefix} ")


@pytest.mark.parametrize(
    ("argv", "suggestion"),
    [
        ("doctor so101", "servos doctor"),
        ("scna", "servos scan"),
        ("report run.mcap", "log report"),
        ("servos docter so101", "servos doctor"),
        ("log infos run.mcap", "log info"),
        ("reply so101 wave.json", "replay"),
    ],
)
def test_an_unknown_command_gets_a_suggestion(argv, suggestion, capsys):
    assert main(argv.split()) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"did you mean `pliant {suggestion}`?" in error


def test_arms_lists_the_ready_arms(capsys):
    assert main(["arms"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line.strip()}
    assert set(config.list_arms()) <= set(rows)
    assert "5 + gripper" in rows["so101"]
    assert "STS3215-7.4V" in rows["so101"]


@pytest.mark.parametrize("name", config.list_arms())
def test_arms_prints_a_file_that_can_be_used(name, capsys, tmp_path):
    assert main(["arms", name]) == 0
    file = tmp_path / "my_arm.toml"
    file.write_text(capsys.readouterr().out, encoding="utf-8")
    assert config.load(str(file)).model_dump() == config.load(name).model_dump()


def test_an_arm_that_is_not_ready_gets_a_suggestion(capsys):
    assert main(["arms", "so10"]) == 2
    error = capsys.readouterr().err
    assert "did you mean so10" in error
    assert "vx300s" in error


def parse_printed(lines):
    """Parse the TOML lines that `pliant identify` prints for the configuration file."""
    return tomllib.loads(lines.partition("\n\n")[2])


@pytest.fixture
def so101(tmp_path, capsys):
    """Return the path of a user's configuration file of an SO-101."""
    assert main(["arms", "so101"]) == 0
    file = tmp_path / "mine.toml"
    file.write_text(capsys.readouterr().out, encoding="utf-8")
    return file


def test_identify_gravity_moves_nothing_and_lowers_the_arm(so101, capsys, caplog):
    assert main(["identify", str(so101), "gravity", "--backend", "sim"]) == 0
    captured = capsys.readouterr()
    assert "do not touch the arm" in captured.out
    assert "the check passed" in captured.out
    assert parse_printed(captured.out) == {}
    assert "was lowered" in caplog.text


def test_identify_payload_prints_what_the_tool_carries(capsys, caplog):
    assert main(["identify", "so101", "payload", "--backend", "sim", "--span", "0.2"]) == 0
    captured = capsys.readouterr()
    assert "payload" in captured.out
    assert set(parse_printed(captured.out)) <= {"payload"}
    assert "was lowered" in caplog.text


@pytest.mark.filterwarnings("ignore:.*may exert.*:RuntimeWarning")
def test_identify_servos_prints_a_table_for_the_file(so101, capsys):
    assert main(["identify", str(so101), "servos", "--backend", "sim"]) == 0
    out = capsys.readouterr().out
    servo = parse_printed(out)["servo"]
    text = so101.read_text(encoding="utf-8")
    head, _, tail = text.partition("[servo]")
    gripper = "[gripper]" + tail.partition("[gripper]")[2]
    lines = out.partition("[servo]\n")[2].partition("\n\n")[0]
    so101.write_text(f"{head}[servo]\n{lines}\n\n{gripper}", encoding="utf-8")
    model = config.load(str(so101)).model()
    # Two joints without gravity load are not known within 10 % from these poses.
    unsure = re.findall(r"(\w+): k_p is not known within 10 %", out)
    assert unsure == ["shoulder_pan", "wrist_roll"]
    assert not model.servos.stiffness_known
    for i, joint in enumerate(model.joint_names):
        assert ("kp" in servo[joint]) is (joint not in unsure)
        assert servo[joint].get("kp", model.servos.kp[i]) == model.servos.kp[i]
        assert servo[joint]["friction"] == model.servos.friction[i]
    before = config.load("so101").model().servos
    assert abs(model.servos.kp / before.kp - 1.0).max() < 0.2
    # The other fields of a servo are unchanged.
    assert servo["shoulder_pan"] | {"id": 1, "gain": 16, "sign": -1} == servo["shoulder_pan"]


def make_identification(model, unsure=()):
    """Return an identification in which k_p is 1.2 times assumed, and unknown for `unsure`."""
    names, kp = model.joint_names, 1.2 * np.asarray(model.servos.kp)
    sigma = np.where(np.isin(names, unsure), 0.3, 0.02) * kp
    zeros = np.zeros(model.n)
    value = dict.fromkeys(("load", "motor", "goal_damping", "limit_damping"), zeros) | {
        "kp": kp, "friction": np.full(model.n, 0.05)
    }  # fmt: skip
    solution = Solution(
        value=value,
        sigma=dict.fromkeys(value, zeros) | {"kp": sigma},
        payload=np.zeros(4),
        payload_covariance=np.eye(4),
        force=np.zeros(2),
        force_covariance=np.eye(2),
        sigma_reduction=np.zeros(4),
        residual_ratio=1.0,
        rows=100,
    )
    rig = Excitation(model, model.servos, 0.01)
    return Identification.of(rig, zeros, solution, Delay(0.01, 0.001, zeros))


def parse_servo_lines(*arguments):
    """Return the table [servo] that `pliant identify` prints for these arguments, parsed."""
    return tomllib.loads("\n".join(_servo_lines(*arguments)))["servo"]


@pytest.mark.parametrize("name", ["Revolute 2", "a.b", 'a "name"', "Gelenk ä", "back\\slash"])
def test_the_servo_lines_are_toml_for_every_joint_name(so101, name):
    own = config.load(str(so101))
    found = make_identification(own.model())
    entries = {name: own.servo["shoulder_pan"]}
    renamed = own.model_copy(
        update={"servo": entries | {n: own.servo[n] for n in found.joint_names[1:]}}
    )
    found = replace(found, joint_names=(name, *found.joint_names[1:]))
    assert parse_servo_lines(renamed, found, {})[name]["id"] == 1


def test_the_servo_lines_have_the_gain_of_a_measured_stiffness(so101):
    own = config.load(str(so101))
    unset = {n: servo.model_copy(update={"gain": None}) for n, servo in own.servo.items()}
    unset["elbow_flex"] = unset["elbow_flex"].model_copy(update={"model": "XL430-W250"})
    own = own.model_copy(update={"servo": unset})
    found = make_identification(config.load(str(so101)).model())
    # Without a bus, a Feetech servo has the maker's gain. The file has no gain for a Dynamixel.
    for gains, expected in (({}, 32), (dict.fromkeys(found.joint_names, 16), 16)):
        servo = parse_servo_lines(own, found, gains)
        assert servo.pop("elbow_flex").get("gain") is None
        assert {entry["gain"] for entry in servo.values()} == {expected}


def test_a_stiffness_of_the_file_that_is_not_measured_keeps_its_gain(so101):
    own = config.load(str(so101))
    entry = own.servo["wrist_roll"].model_copy(update={"kp": 6.6, "gain": 16})
    own = own.model_copy(update={"servo": {**own.servo, "wrist_roll": entry}})
    found = make_identification(own.model(), ["wrist_roll"])
    servo = parse_servo_lines(own, found, dict.fromkeys(found.joint_names, 32))
    assert (servo["wrist_roll"]["kp"], servo["wrist_roll"]["gain"]) == (6.6, 16)
    assert servo["elbow_flex"]["gain"] == 32


@pytest.mark.parametrize("unsure", [[], ["wrist_roll"], ["shoulder_pan", "wrist_roll"]])
def test_only_an_identified_stiffness_is_written(so101, unsure):
    own = config.load(str(so101))
    model = own.model()
    names, kp = model.joint_names, 1.2 * np.asarray(model.servos.kp)
    found = make_identification(model, unsure)
    assert found.servos.stiffness_known is (not unsure)
    gains = dict.fromkeys(names, 32)
    disturbed = _servo_lines(own, replace(found, residual_ratio=2.1), {})
    assert disturbed == ["", "# no lines for the file: the residuals are too large"]
    lines = [line for line in _servo_lines(own, found, gains) if not line.startswith("#")]
    servo = tomllib.loads("\n".join(lines))["servo"]
    assert [name for name in names if "kp" not in servo[name]] == unsure
    assert all(servo[name]["gain"] == 32 for name in names), "kp belongs to this gain"
    # Friction is identified also where stiffness is not.
    assert all(servo[name]["friction"] == 0.05 for name in names)
    text = so101.read_text(encoding="utf-8")
    head, _, rest = text.partition("[servo]")
    gripper = "[gripper]" + rest.partition("[gripper]")[2]
    body = "\n".join(lines).partition("[servo]\n")[2]
    so101.write_text(f"{head}[servo]\n{body}\n\n{gripper}", encoding="utf-8")
    changed = config.load(str(so101)).model()
    assert changed.servos.stiffness_known is (not unsure)
    table = np.asarray(model.servos.kp)
    # k_p from the file's gain of 16 doubles with the present gain of 32.
    expected = np.where(np.isin(names, unsure), 2.0 * table, kp)
    np.testing.assert_allclose(changed.servos.kp, expected, rtol=1e-3)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["gravity", "--span", "0.1"], "--span belongs to servos and payload"),
        (["friction"], "invalid choice"),
        (["servos", "--span", "9"], "span [rad] must be in [0.05, 0.5], got 9"),
        (["servos", "--span", "3.0"], "span [rad] must be in [0.05, 0.5]"),
        (["servos", "--span", "0.0"], "span [rad] must be in [0.05, 0.5]"),
        (["payload", "--span", "1.0"], "span [rad] must be in [0.05, 0.5]"),
    ],
)
def test_identify_refuses_before_torque_comes_on(flags, message, capsys):
    assert main(["identify", "so101", *flags, "--backend", "sim"]) == 2
    captured = capsys.readouterr()
    assert message in captured.err


@pytest.mark.parametrize("arm", ["vx300s", "mine.toml"])
def test_a_scene_needs_a_built_in_arm(arm, capsys):
    assert main(["view", arm, "--scene", "free"]) == 2
    assert "--scene simulates one of arm7, so101, koch" in capsys.readouterr().err


@pytest.mark.parametrize("procedure", ["servos", "payload"])
def test_joints_do_not_swing_where_the_tool_would_meet_the_table(
    procedure, capsys, caplog, monkeypatch
):
    monkeypatch.setattr(factory, "start_pose", lambda config, _: np.array(config.life.rest_q))
    assert main(["identify", "so101", procedure, "--backend", "sim"]) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "the tool is 1 cm above the table, needed are 15 cm: hold it higher and start" in error
    assert "lowered" not in caplog.text, "torque has stayed off"
