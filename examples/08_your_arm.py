"""From a URDF and a servo table to a soft arm: here the SO-101 model that ships with pliant.

python examples/08_your_arm.py [arm.urdf BASE TIP]
"""

import os
import sys

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 2.0 if os.environ.get("PLIANT_SHORT") else 6.0

if len(sys.argv) == 4:
    # Data of a servo table; one number applies to every joint.
    servos = pliant.Servos(
        kp=20.0, max_torque=3.0, friction=0.08, damping=0.6
    )  # [N·m/rad], [N·m] ...
    model = pliant.Model.from_urdf(sys.argv[1], base=sys.argv[2], tip=sys.argv[3], servos=servos)
else:
    model = pliant.robots.so101()
print(f"{model.n} joints: {', '.join(model.joint_names)}; reach {model.reach:.2f} m")

# Fewer than six joints cannot hold six axes: take the translations.
settings = pliant.Settings(
    task=pliant.Task("xyz"), axes={"y": pliant.Axis(adaptation=0.9, yields="both")}
)
controller = pliant.Controller(model, settings)
for axis, strength in controller.axes.items():
    print(f"  {axis}: soft {strength.soft}, firm {strength.firm}, hold {strength.hold} N")

q = np.resize([0.2, -0.3, 0.3, 0.9, 0.0], model.n)  # [rad]
start = np.clip(q, model.lower, model.upper)
hand = pliant.sim.Drag(axis="y", distance=0.08, stiffness=500.0, limit=20.0, at="tool")
arm = pliant.sim.Plant(model, scene=[hand])
arm.reset(start)
target = arm.tool
for _ in range(round(SECONDS * arm.rate)):
    command = controller.step(arm.read().q, target)
    arm.write(command.goal, command.torque_limit)
    arm.advance()
print(f"dragged 0.08 m to the side with {arm.hands[0].peak_force:.1f} N at most;", end=" ")
error = 1e3 * np.linalg.norm(arm.tool[:3, 3] - target[:3, 3])
print(f"left {error:.0f} mm from its target,")
print("where the restoring force is below the dry friction of its gears")
