"""Make a joint-space policy soft without changing it: `step_joints` takes joint positions.

A scripted "policy" swings the arm against a wall. With all axes stiff, the arm presses with the
full torque of its servos; with a cap, with at most the cap (plus the impact of its mass). The lag
is the distance of the tool from the commanded position.
"""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 2.0 if os.environ.get("PLIANT_SHORT") else 6.0
START = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])  # [rad]

model = pliant.robots.arm7()


def policy(time: float) -> np.ndarray:
    """Return joint positions (7,) [rad] of a policy without force control."""
    reach = np.array([-0.30, 0.0, 0.0, 0.36, 0.0, 0.0, 0.0])  # forward, toward the wall
    return START + np.sin(2 * np.pi * time / 6.0) * reach


for name, axes in {"stiff": {}, "soft": {"x": pliant.Axis(soft=8.0, firm=8.0)}}.items():
    controller = pliant.Controller(model, pliant.Settings(axes=axes))
    wall = pliant.sim.Wall(into=(1.0, 0.0, 0.0), distance=0.03, stiffness=2e3, damping=40.0)
    arm = pliant.sim.Plant(model, scene=[wall])
    arm.reset(START)
    lag = 0.0
    for _ in range(round(SECONDS * arm.rate)):
        command = controller.step_joints(arm.read().q, policy(arm.time))
        arm.write(command.goal, command.torque_limit)
        arm.advance()
        lag = max(lag, float(np.abs(controller.diagnostics.deviation[:3]).max()))
    force = arm.hands[0].peak_force
    print(f"{name:5}: largest force on the wall {force:5.1f} N, largest lag {1e3 * lag:5.1f} mm")
