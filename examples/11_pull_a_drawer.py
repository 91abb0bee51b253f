"""Pull a drawer open whose slide is 10° off the assumed direction.

With the preset, the tool follows the slide, and the pull is capped, also at the end stop. With all
axes stiff, the arm strains against the slide.
"""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 2.0 if os.environ.get("PLIANT_SHORT") else 8.0
START = [-0.626, -0.418, 0.784, -1.194, 0.811, 0.468, -0.115]  # [rad]
ANGLE = np.deg2rad(10.0)

model = pliant.robots.arm7()
variants = {
    "drawer, the arm's own caps": pliant.Settings.drawer(axis="x"),
    "drawer, at most 10 N": pliant.Settings.drawer(axis="x", pull=10.0),
    "all axes stiff": pliant.Settings.firm(),
}

for name, settings in variants.items():
    drawer = pliant.sim.drawer(axis=(-np.cos(ANGLE), np.sin(ANGLE), 0.0))
    arm = pliant.sim.Plant(model, scene=[drawer])
    arm.reset(START)
    controller = pliant.Controller(model, settings)
    controller.reset(START)
    target = arm.tool
    for _ in range(round(SECONDS * arm.rate)):
        if 1.0 < arm.time < 6.6:
            target[0, 3] -= 0.05 / arm.rate  # pull back at 0.05 m/s, 0.03 m farther than it opens
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
    print(
        f"{name}: open by {1e3 * drawer.widest:.0f} mm, at most {drawer.peak_force:.0f} N at the "
        f"handle, {drawer.across:.0f} N of them across the slide"
    )
