"""`Model` from Python: attributes, and errors in a URDF file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pliant

URDF = Path(__file__).resolve().parents[1] / "data" / "golden" / "arm7.urdf"


def test_facts(model):
    assert model.name == "arm7"
    assert model.n == 7
    assert model.joint_names[3] == "elbow_pitch"
    assert (model.base, model.tip) == ("base", "tool")
    assert model.frames[0] == "base"
    assert model.prismatic == (False,) * 7
    assert model.reach == pytest.approx(0.71)
    assert model.gravity_vector.tolist() == [0.0, 0.0, -9.81]
    assert model.payload is None
    assert repr(model) == "<Model 'arm7': 7 joints, base to tool>"
    for array in (model.lower, model.upper, model.velocity_limit, model.effort_limit):
        assert array.shape == (7,)
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_tree(model):
    assert model.links is model.links
    assert [link.name for link in model.links] == list(model.frames)
    root = next(link for link in model.links if link.parent_joint is None)
    assert root.name == "base"
    moving = [joint for joint in model.joints if joint.q_index is not None]
    assert [joint.name for joint in sorted(moving, key=lambda j: j.q_index)] == list(
        model.joint_names
    )
    elbow = next(joint for joint in moving if joint.name == "elbow_pitch")
    assert elbow.kind == "revolute"
    assert model.links[elbow.child].parent_joint == model.joints.index(elbow)
    assert np.linalg.norm(elbow.axis) == pytest.approx(1.0)
    assert isinstance(elbow.origin, pliant.Pose)
    assert elbow.lower == model.lower[3]
    assert elbow.effort == model.effort_limit[3]
    assert elbow.mimic is None
    assert elbow.locked_at is None
    inertial = model.links[elbow.child].inertial
    assert inertial.mass > 0.0
    assert inertial.com.shape == (3,)
    assert inertial.rotation.shape == inertial.inertia.shape == (3, 3)


def test_options(servos):
    model = pliant.Model.from_urdf_str(
        URDF.read_text(encoding="utf-8"),
        tip="tool",
        locked={"wrist_roll": 0.3},
        payload=(0.5, [0.0, 0.0, 0.1]),
        gravity=np.array([0, 0, -1]),
        limits={"elbow_pitch": (-1.0, 0.0)},
        servos=pliant.Servos(kp=100.0, max_torque=5.0),
    )
    assert model.n == 6
    assert model.payload == pliant.Payload(0.5, (0.0, 0.0, 0.1))
    assert model.lower[3] == -1.0
    assert model.servos.kp.shape == (6,)
    assert next(j for j in model.joints if j.name == "wrist_roll").locked_at == 0.3
    with pytest.raises(pliant.ShapeError, match=r"servos.kp has shape \(7,\), expected \(6,\)"):
        pliant.Model.from_urdf(URDF, tip="tool", locked={"wrist_roll": 0.0}, servos=servos)
    assert pliant.Model.from_urdf(str(URDF), base=None, gravity=None).n == 7


def test_absent_limits_are_nan_and_infinite():
    text = """<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
    <joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>
    </robot>"""
    model = pliant.Model.from_urdf_str(text)
    assert model.lower.tolist() == [-np.inf]
    assert model.upper.tolist() == [np.inf]
    assert np.isnan(model.effort_limit).all()
    assert np.isnan(model.velocity_limit).all()
    assert model.joints[0].lower is None


def test_a_missing_file_raises_file_not_found_error(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file: '.*nowhere.urdf'"):
        pliant.Model.from_urdf(tmp_path / "nowhere.urdf")
    with pytest.raises(FileNotFoundError, match=r"this is XML text: use Model.from_urdf_str"):
        pliant.Model.from_urdf("<robot/>")
    with pytest.raises(pliant.UrdfError, match="cannot be read") as error:
        pliant.Model.from_urdf(tmp_path)
    assert error.value.source == str(tmp_path)
    with pytest.raises(TypeError):
        pliant.Model.from_urdf(3)


def test_faults_carry_their_place(tmp_path):
    file = tmp_path / "broken.urdf"
    file.write_text(
        URDF.read_text(encoding="utf-8").replace('mass value="', 'mass value="x'), encoding="utf-8"
    )
    with pytest.raises(pliant.UrdfError) as error:
        pliant.Model.from_urdf(file)
    assert error.value.source == str(file)
    assert error.value.line > 1
    assert f"{file}:{error.value.line}:{error.value.column}: " in str(error.value)


def test_a_missing_frame_lists_those_there_are():
    with pytest.raises(
        pliant.FrameNotFoundError, match=r"frame 'hand' not found.*gripper_link"
    ) as error:
        pliant.Model.from_urdf(URDF, tip="hand")
    assert error.value.frame == "hand"
    assert "gripper_link" in error.value.available


def test_all_exceptions_have_one_base_class():
    tree = {
        pliant.PliantError: Exception,
        pliant.UrdfError: pliant.PliantError,
        pliant.FrameNotFoundError: pliant.PliantError,
        pliant.OutOfRangeError: pliant.PliantError,
        pliant.ShapeError: pliant.PliantError,
        pliant.ConfigError: pliant.PliantError,
        pliant.ServoError: pliant.PliantError,
        pliant.ServoTimeoutError: pliant.ServoError,
        pliant.ServoFaultError: pliant.ServoError,
    }
    for kind, base in tree.items():
        assert kind.__bases__[0] is base
        assert kind.__module__ == "pliant"
        assert kind.__doc__
    assert issubclass(pliant.ShapeError, ValueError)
    assert pliant.ConfigError("from Python").key is None


def test_models_cannot_be_changed(model):
    with pytest.raises(AttributeError):
        model.n = 3
    with pytest.raises(TypeError):
        pliant.Model()


def test_other_servos_leave_the_model_alone():
    model = pliant.robots.so101()
    table = model.servos.replace(kp=9.0, stiffness_known=False)
    other = model.with_servos(table)
    assert other.servos.kp.tolist() == [9.0] * 5
    assert model.servos.kp.tolist() != [9.0] * 5
    assert other.forward_kinematics(np.zeros(5)).tolist() == (
        model.forward_kinematics(np.zeros(5)).tolist()
    )
    with pytest.raises(pliant.ShapeError):
        model.with_servos(pliant.robots.arm7().servos)
