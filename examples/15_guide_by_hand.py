"""Guide the tool by hand: with `hand_guiding`, a small force moves it, and it stays."""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 4.0 if os.environ.get("PLIANT_SHORT") else 7.0
DISTANCE = 0.01  # [m]
START = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657]  # [rad]

model = pliant.robots.arm7()
variants = {
    "hand_guiding": pliant.Settings.hand_guiding(),
    "all axes stiff": pliant.Settings.firm(),
}

for name, settings in variants.items():
    arm = pliant.sim.Plant(model, scene=[pliant.sim.DRAG_80N])  # 0.15 m along y, from 2 to 5 s
    arm.reset(START)
    controller = pliant.Controller(model, settings)
    controller.reset(START)
    target, start, forces = arm.tool, arm.tool, []
    for _ in range(round(SECONDS * arm.rate)):
        q = arm.read().q
        pose = model.forward_kinematics(q)
        if name == "hand_guiding" and np.linalg.norm(pose[:3, 3] - target[:3, 3]) > DISTANCE:
            target = pose  # the target follows the hand
        command = controller.step(q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
        forces.append(float(np.linalg.norm(arm.hands[0].force)))
    displacement = 1e3 * (arm.tool[1, 3] - start[1, 3])  # [mm]
    print(
        f"{name}: the hand needed at most {max(forces):.1f} N, the tool is at {displacement:.0f} mm"
    )
