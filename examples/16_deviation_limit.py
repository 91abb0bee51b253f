"""Limit the deviation of a stiff axis at a wall: its target yields, or the whole target waits.

`deviation_limit` bounds the deviation of a stiff axis, and so its force.
"""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 4.0 if os.environ.get("PLIANT_SHORT") else 9.0
START = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657]  # [rad]

model = pliant.robots.arm7()
variants = {
    "no limit": pliant.Axis(),
    "follow": pliant.Axis(deviation_limit=0.01, on_deviation_limit="yield"),  # [m]
    "hold": pliant.Axis(deviation_limit=0.01, on_deviation_limit="wait"),
}

for name, axis in variants.items():
    wall = pliant.sim.Wall(distance=0.03, stiffness=2e4, damping=50.0)
    arm = pliant.sim.Plant(model, scene=[wall])
    arm.reset(START)
    controller = pliant.Controller(model, pliant.Settings(axes={"x": axis}))
    controller.reset(START)
    start, fastest = arm.tool, 0.0
    for _ in range(round(SECONDS * arm.rate)):
        if abs(arm.time - 6.0) < 1e-6:
            arm.set_hands([])  # the wall is gone
        target = start.copy()
        target[:2, 3] += 0.10 * np.clip((arm.time - 1.0) / 2.0, 0.0, 1.0)  # x and y together [m]
        before = arm.tool[:3, 3]
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
        if abs(arm.time - 3.9) < 1e-6:
            waits = " (reported)" if controller.diagnostics.deviation_limited[0] else ""
            force = -arm.hands[0].force[0]
            y = arm.tool[1, 3] - start[1, 3]
            print(f"{name}{waits}: {force:.0f} N on the wall, y at {1e3 * y:.0f} of 100 mm", end="")
        if arm.time > 6.0:
            fastest = max(fastest, float(np.linalg.norm(arm.tool[:3, 3] - before)) * arm.rate)
    print(f"; free again at up to {fastest:.2f} m/s" if fastest else "")
