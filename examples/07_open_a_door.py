"""Open a rigidly gripped door whose hinge position is unknown.

With soft y and yaw, the tool follows the handle; with all axes stiff, the door jams.
"""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 2.0 if os.environ.get("PLIANT_SHORT") else 7.0
START = [-0.626, -0.418, 0.784, -1.194, 0.811, 0.468, -0.115]  # [rad]

model = pliant.robots.arm7()

# For comparison: law of the paper, all axes stiff, full torque of every servo.
stiff = {"all": pliant.Axis(hold=1000.0)}
variants = {
    "y and yaw compliant": pliant.Settings.door(),
    "all axes stiff": pliant.Settings.paper(
        axes=stiff, gravity=True, null_space=pliant.NullSpace(gain=1.0)
    ),
}

for name, settings in variants.items():
    door = pliant.sim.Door(hinge=(0.0, -0.30, 0.0), mass=3.0, grip="rigid")
    arm = pliant.sim.Plant(model, scene=[door])
    arm.reset(START)
    controller = pliant.Controller(model, settings)
    controller.reset(START)
    target = arm.tool
    for _ in range(round(SECONDS * arm.rate)):
        if 1.0 < arm.time < 6.6:
            target[0, 3] -= 0.05 / arm.rate  # pull back at 0.05 m/s, by 0.28 m in all
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
    angle = np.rad2deg(door.widest)
    print(f"{name}: the door opened to {angle:.0f}°, at most {door.peak_force:.0f} N at the handle")
