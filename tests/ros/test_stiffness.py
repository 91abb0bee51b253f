"""The topic `~/target_stiffness`, which has an effect under law `impedance` only."""

from __future__ import annotations

import pytest

pytest.importorskip("zenoh", reason="ROS 2 needs zenoh: pip install 'pliant[ros]'")

import pliant
from tests.ros.conftest import answer, axis_values, free_port, run_node, send_until


def test_stiffness_from_the_client_changes_the_axes_of_law_impedance(tmp_path_factory, client_of):
    port, nan = free_port(), float("nan")
    settings = pliant.Settings.soft("x y", task="xyz", law="impedance")
    with run_node(port, tmp_path_factory, settings) as node:
        client, before = client_of(port), node.controller.axes
        assert before["x"].stiffness == (0.0, 0.0)
        send_until(
            node,
            client,
            "/pliant/target_stiffness",
            axis_values(client, [150.0, nan, nan, nan, nan, nan]),
            condition=lambda: node.controller.axes["x"].stiffness == (150.0, 150.0),
            description="the change of the stiffness",
        )
        assert node.controller.axes["y"].stiffness == before["y"].stiffness
        # In CRISP's controllers this parameter has the name `task.k_pos_x`.
        reply = answer(
            node,
            lambda: client.call("/pliant/get_parameters", "GetParameters", names=["task.k_pos_x"]),
        )
        assert reply.values[0].double_value == 150.0
