"""The paper's law: torque budgets per task axis, with and without a gravity model.

Without one the arm sags by the compliance of its servos; with y soft and eta near one it drifts.
"""

import os

import pliant
import pliant.robots
import pliant.sim

SECONDS = 2.0 if os.environ.get("PLIANT_SHORT") else 6.0
START = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657]  # [rad]

model = pliant.robots.arm7()
soft = {"y": pliant.Axis(soft=0.5, firm=10.0, hold=10.0, adaptation=0.999)}  # budgets [N·m]

for gravity in (False, True):
    settings = pliant.Settings.paper(axes=soft, gravity=gravity)
    controller = pliant.Controller(model, settings)
    arm = pliant.sim.Plant(model)
    arm.reset(START)
    target = arm.tool
    for _ in range(round(SECONDS * arm.rate)):
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
    x, y, z = 1e3 * (arm.tool[:3, 3] - target[:3, 3])  # [mm]
    label = "with" if gravity else "without"
    print(f"{label:7} gravity model, untouched, after {SECONDS:.0f} s: ", end="")
    print(f"x {x:+6.1f}  y {y:+6.1f}  z {z:+6.1f} mm")
