"""The table under an arm: links that can move vertically collide with it."""

import numpy as np
import pytest

import pliant
from pliant.sim import Plant, Tabletop
from pliant.sim._model_builder import rigid_groups


def settle_on_table(model, q, *, seconds=3.0, table=True, rotation=None):
    """Let an arm without torque sink from q onto its table; return plant and table."""
    scene = [Tabletop()] if table else []
    plant = Plant(model, scene=scene)
    plant.reset(q)
    gripper_command = dict.fromkeys(plant.read().extra, (0.0, 0.0))
    for _ in range(round(seconds * plant.rate)):
        plant.write(plant.q, np.zeros(plant.n), gripper_command)
        plant.advance()
    return plant, scene[0] if table else None


def test_an_arm_without_torque_comes_to_lie_on_its_table():
    model = pliant.robots.so101()
    q = [0.4, 0.6, 0.5, 0.3, 0.0]
    plant, table = settle_on_table(model, q)
    without_table, _ = settle_on_table(model, q, table=False)
    weight = 9.81 * sum(link.inertial.mass for link in model.links if link.inertial)
    assert without_table.tool[2, 3] < -0.05, "without a table it hangs below its base"
    assert plant.tool[2, 3] > 0.005
    assert abs(table.clearance()) < 1e-4
    assert "gripper" in table.touching
    assert 0.3 < table.force < weight
    assert np.abs(plant.dq).max() < 0.02
    assert table.peak_force > table.force


@pytest.mark.parametrize(
    ("name", "q"),
    [("koch", [0.0, 1.75, -1.7, 0.0, 0.0]), ("so101", [0.0, 1.5, -1.3, -0.6, 0.0])],
)
def test_other_links_than_the_tool_touch_it_too(name, q):
    _, table = settle_on_table(pliant.robots.load(name), q)
    assert {"lower_arm", "gripper"} <= set(table.touching)


@pytest.mark.parametrize("name", ["so101", "koch"])
def test_links_that_only_turn_about_the_vertical_never_touch(name):
    model = pliant.robots.load(name)
    cut = rigid_groups(model, "held")
    table = Tabletop(height=0.5)
    plant = Plant(model, scene=[table])
    geoms = {plant.mj_model.geom(geom).name for geom in range(plant.mj_model.ngeom)}
    names = {name.split(":")[1] for name in geoms if name.startswith("tabletop:")}
    assert "shoulder" not in names
    assert {"upper_arm", "lower_arm", "wrist", "gripper"} <= names
    assert len(cut) > len(names)


def test_a_slide_touches_and_clearance_is_the_lowest_link():
    model = pliant.Model.from_urdf_str(
        '<robot name="lift"><link name="base"/>'
        '<joint name="up" type="prismatic"><parent link="base"/><child link="arm"/>'
        '<axis xyz="0 0 1"/><limit lower="0" upper="1" effort="50" velocity="1"/></joint>'
        '<link name="arm"><inertial><mass value="1"/>'
        '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="tip" type="fixed"><parent link="arm"/><child link="tool"/>'
        '<origin xyz="0.3 0 0"/></joint><link name="tool"/></robot>',
        base="base",
        tip="tool",
    )
    table = Tabletop(height=0.1)
    plant = Plant(model, scene=[table])
    plant.reset([0.4])
    assert table.clearance() == pytest.approx(0.4 - 0.1 - 0.035)
    plant.reset([0.1])
    assert table.clearance() == pytest.approx(-0.035)
    plant.reset([0.4])
    for _ in range(200):
        plant.write([0.2], [0.0])
        plant.advance()
    assert table.touching == ("arm",)
    # Gear friction carries a part of the weight.
    assert 9.81 - 1.1 < table.force < 9.81 + 1.1


def test_a_scene_without_a_table_is_as_it_was():
    model = pliant.robots.so101()
    ends = []
    for scene in ([], [Tabletop(height=-5.0)]):
        plant = Plant(model, scene=scene)
        plant.reset([0.0, 0.3, 0.2, 0.1, 0.0])
        for _ in range(50):
            plant.advance()
        ends.append(plant.q)
    np.testing.assert_allclose(*ends, atol=1e-12)


@pytest.mark.parametrize("arguments", [{"height": np.nan}, {"friction": -1.0}])
def test_invalid_numbers_of_a_table_are_refused(arguments):
    with pytest.raises(pliant.ConfigError, match="Tabletop needs"):
        Tabletop(**arguments)
