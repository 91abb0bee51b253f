"""Models and settings as text in a log, and back."""

import numpy as np
import pytest

import pliant
import pliant.robots
from pliant.log import serialization


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"payload": (0.2, [0.0, 0.01, 0.05])},
        {"payload": pliant.Payload(0.2, [0.0, 0.01, 0.05]), "gravity": np.array([0.0, 1.0, -9.0])},
        {"locked": {"gripper": 0.3}, "limits": {"elbow_flex": (-0.5, 0.7)}, "tip": "tool"},
    ],
)
def test_a_model_is_made_again(options):
    model = pliant.robots.so101(**options)
    text = serialization.write({"model": serialization.describe(model)})
    again = serialization.model(serialization.read(text)["model"])
    q = np.linspace(-0.4, 0.4, 5)
    assert again.joint_names == model.joint_names
    np.testing.assert_array_equal(again.lower, model.lower)
    np.testing.assert_array_equal(again.forward_kinematics(q), model.forward_kinematics(q))
    np.testing.assert_array_equal(again.gravity(q), model.gravity(q))
    assert again.servos == model.servos


def test_a_file_that_has_changed_is_not_read_again(tmp_path):
    file = tmp_path / "arm.urdf"
    text, options = pliant.robots.so101().source
    file.write_text(text, encoding="utf-8")
    model = pliant.Model.from_urdf(file, base="base", tip="tool")
    file.unlink()
    assert model.source == (text, {"base": "base", "tip": "tool"})
    model.source[1]["tip"] = "other"
    assert model.source[1]["tip"] == "tool"
    assert options["tip"] == "tool"


def test_settings_keep_every_bit():
    arguments = {
        "settings": pliant.Settings(
            task=pliant.Task(axes="xyz", frame=np.eye(3)),
            axes={"y": pliant.Axis(soft=0.1 / 3.0, firm=(15.0, 0.1 + 0.2), adaptation=0.9)},
            null_space=pliant.NullSpace(posture=[0.1] * 5),
            law="impedance",
        ),
        "servos": pliant.robots.koch().servos,
        "axes": ("x", "y"),
    }
    result = serialization.read(serialization.write(arguments))
    assert result["settings"] == arguments["settings"]
    assert result["servos"] == arguments["servos"]
    for preset in (
        pliant.Settings.door(),
        pliant.Settings.wipe(press=5.0),
        pliant.Settings.paper(),
    ):
        assert serialization.read(serialization.write(preset)) == preset


@pytest.mark.parametrize("text", ["", "{", '{"type": "Popen", "fields": {}}', '{"fields": 1}'])
def test_invalid_values_are_refused(text):
    with pytest.raises(pliant.ConfigError, match="description"):
        serialization.read(text)
