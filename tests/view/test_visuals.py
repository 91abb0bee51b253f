"""Shapes and mesh files of a URDF: found, read and drawn on the page."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import pliant
from pliant.sim import Plant
from pliant.view.robot_view import find_mesh, visuals
from pliant.view.scene_view import _body_meshes, _floor_height

URDF = """<robot name="own">
  <material name="blue"><color rgba="0 0 1 1"/></material>
  <link name="base"><visual><geometry><mesh filename="{base}"/></geometry></visual></link>
  <joint name="lift" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="5"/></joint>
  <link name="arm">
    <inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual><origin xyz="0.1 0 0" rpy="0.3 0.2 0.1"/>
      <geometry><mesh filename="{arm}" scale="0.001 0.001 0.001"/></geometry>
      <material name="blue"/></visual>
    <visual><origin xyz="0 0 0.2"/><geometry><box size="0.1 0.2 0.3"/></geometry></visual>
  </link>
  <joint name="mount" type="fixed"><parent link="arm"/><child link="tool"/>
    <origin xyz="0.2 0 0"/></joint>
  <link name="tool"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>
</robot>"""


def draw(base, arm, urdf):
    model = pliant.Model.from_urdf_str(URDF.format(base=base, arm=arm))
    figure = Plant(model).mj_model
    return figure, visuals(model, figure, urdf)


@pytest.fixture
def folder(tmp_path):
    """Make a ROS package with own_description/urdf/own.urdf and own_description/meshes."""
    meshes = tmp_path / "own_description" / "meshes"
    meshes.mkdir(parents=True)
    (tmp_path / "own_description" / "urdf").mkdir()
    trimesh.creation.box(extents=(0.2, 0.2, 0.1)).export(meshes / "base.stl")
    trimesh.creation.box(extents=(100.0, 20.0, 20.0)).export(meshes / "arm link.obj")
    (meshes / "broken.stl").write_bytes(b"solid nothing")
    return tmp_path / "own_description"


def test_meshes_are_found_beside_the_urdf_and_by_package(folder):
    urdf = folder / "urdf" / "own.urdf"
    inside = folder / "meshes" / "base.stl"
    for name in (
        "../meshes/base.stl",
        "package://own_description/meshes/base.stl",
        "package://another_name/meshes/base.stl",
        str(inside),
        f"file://{inside}",
    ):
        assert find_mesh(name, urdf) == inside.resolve()
    assert find_mesh("package://own_description/meshes/arm%20link.obj", urdf) is not None
    for name in ("", "base.stl", "package://own_description/meshes/none.stl", "https://a/b.stl"):
        assert find_mesh(name, urdf) is None
    assert find_mesh("../meshes/base.stl", None) is None


def test_shapes_stand_where_the_urdf_has_them(folder):
    figure, shapes = draw("../meshes/base.stl", "../meshes/arm link.obj", folder / "urdf" / "x")
    kinds = [(figure.body(v.body).name, v.kind) for v in shapes]
    assert kinds == [
        ("body:base", "mesh"),
        ("body:arm", "mesh"),
        ("body:arm", "box"),
        ("body:arm", "sphere"),
    ]
    _, arm, box, sphere = (v.mesh() for v in shapes)
    np.testing.assert_allclose(arm.bounds.mean(axis=0), (0.1, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(shapes[1].pose[:3, 0], (0.97517, 0.097843, -0.198669), atol=1e-5)
    assert arm.volume == pytest.approx(0.1 * 0.02 * 0.02)
    np.testing.assert_allclose(box.bounds, ((-0.05, -0.1, 0.05), (0.05, 0.1, 0.35)), atol=1e-9)
    np.testing.assert_allclose(sphere.bounds.mean(axis=0), (0.2, 0.0, 0.0), atol=1e-9)
    assert (arm.visual.vertex_colors[0] == (0, 0, 255, 255)).all()


def test_link_without_its_mesh_and_a_broken_file_are_drawn_as_before(folder):
    figure, shapes = draw("missing.stl", "../meshes/broken.stl", folder / "urdf" / "x")
    assert "body:base" not in {figure.body(v.body).name for v in shapes}
    assert _body_meshes(SimpleNamespace(visuals=shapes)) == {}


@pytest.mark.parametrize("robot", ["so101", "koch"])
def test_small_arms_have_a_base_and_a_gripper_and_stand_on_their_table(robot):
    model = pliant.robots.load(robot)
    plant = Plant(model)
    stage = SimpleNamespace(
        mj_model=plant.mj_model,
        visuals=visuals(model, plant.mj_model),
        table=None,
        home=np.eye(4),
    )
    drawn = {plant.mj_model.body(b).name for b in _body_meshes(stage)}
    assert drawn == {f"body:{link.name}" for link in model.links if link.name != "tool"}
    # Test tool positions above and below the base: a real arm may start anywhere.
    for height in (0.3, -0.2):
        stage.home[2, 3] = height
        assert _floor_height(stage) == pytest.approx(0.0, abs=1e-9)


def test_arm_that_hangs_is_above_the_floor_and_a_known_table_counts():
    model = pliant.robots.arm7()
    plant = Plant(model)
    home = np.eye(4)
    home[2, 3] = -0.28
    stage = SimpleNamespace(
        mj_model=plant.mj_model, visuals=visuals(model, plant.mj_model), table=None, home=home
    )
    assert _floor_height(stage) == pytest.approx(-0.58)
    stage.table = -0.4
    assert _floor_height(stage) == -0.4
