"""Wipe a surface with hills and valleys of 10 mm; a cap on the force keeps it near 5 N.

The target moves in a plane 25 mm below the mean surface, so far that the force reaches the cap.
"""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 4.5 if os.environ.get("PLIANT_SHORT") else 11.0
START = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657]  # [rad]
DEPTH = 0.025  # of the target below the mean surface [m]

model = pliant.robots.arm7()
variants = {
    "wipe, 5 N": pliant.Settings.wipe(press=5.0, axis="z"),
    "all axes stiff": pliant.Settings.firm(),
}

for name, settings in variants.items():
    surface = pliant.sim.Surface(below=0.01, unevenness=0.010, friction=0.4)
    arm = pliant.sim.Plant(model, scene=[surface])
    arm.reset(START)
    controller = pliant.Controller(model, settings)
    controller.reset(START)
    start, forces = arm.tool, []
    for _ in range(round(SECONDS * arm.rate)):
        target = start.copy()
        target[2, 3] -= min(max(0.02 * (arm.time - 0.5), 0.0), surface.below + DEPTH)
        phase = 2.0 * np.pi * max(arm.time - 3.0, 0.0) / 8.0
        target[:2, 3] += 0.04 * np.sin(2.0 * phase), 0.10 * np.sin(phase)  # [m]
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
        if arm.time > 3.0:
            forces.append(arm.hands[0].force[2])
    print(f"{name}: {min(forces):.1f} to {max(forces):.1f} N, {np.mean(forces):.1f} N in the mean")
