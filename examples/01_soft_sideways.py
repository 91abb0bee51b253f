"""An arm that gives way sideways and holds everything else, while a strong hand drags it.

Runs on the simulated arm; example 19 has the loop that controls a real arm too.
"""

import os

import numpy as np

import pliant.robots
import pliant.sim

SECONDS = 3.0 if os.environ.get("PLIANT_SHORT") else 7.0

model = pliant.robots.arm7()
settings = pliant.Settings(
    axes={
        "y": pliant.Axis(soft=4.0, firm=15.0, adaptation=0.999)
    },  # soft and firm [N]; all other axes are stiff
)
controller = pliant.Controller(model, settings)

hand = pliant.sim.Drag(axis="y", distance=0.15, stiffness=3000.0, limit=80.0, at="tool")
arm = pliant.sim.Plant(model, rate=100.0, scene=[hand])
arm.reset([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])  # [rad]
target = arm.tool

print("  time    y [mm]  x [mm]  z [mm]   hand")
for tick in range(round(SECONDS * arm.rate)):
    command = controller.step(arm.read().q, target)
    arm.write(command.goal, command.torque_limit)
    arm.advance()
    if tick % 50 == 49:
        moved = 1e3 * (arm.tool[:3, 3] - target[:3, 3])  # [mm]
        force = np.linalg.norm(arm.hands[0].force)  # [N]
        print(f"{arm.time:5.1f} s {moved[1]:8.1f} {moved[0]:7.1f} {moved[2]:7.1f} {force:6.1f} N")
