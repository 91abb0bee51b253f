"""Insert a plug into a hole that is 2 mm and 2° off, pushing with at most 10 N.

The tool frame is at the tip of the plug, so that the plug turns about its tip in the chamfer.
"""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 3.5 if os.environ.get("PLIANT_SHORT") else 6.0
START = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657]  # [rad]

model = pliant.robots.arm7()
variants = {
    "plug": pliant.Settings.plug(axis="-z", push=10.0),
    "all axes stiff": pliant.Settings.firm(),
}

for name, settings in variants.items():
    socket = pliant.sim.Socket(offset=(-0.002, 0.002, -0.02), tilt=(0.0, np.deg2rad(2.0), 0.0))
    arm = pliant.sim.Plant(model, scene=[socket])
    arm.reset(START)
    controller = pliant.Controller(model, settings)
    controller.reset(START)
    target = arm.tool
    for _ in range(round(SECONDS * arm.rate)):
        if 1.0 < arm.time < 4.0:
            target[2, 3] -= 0.02 / arm.rate  # down at 0.02 m/s, 10 mm deeper than the hole
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
    print(
        f"{name}: {1e3 * socket.deepest:.0f} of {1e3 * socket.depth:.0f} mm deep, at most "
        f"{socket.peak_along:.0f} N along the hole and {socket.peak_across:.0f} N across"
    )
