"""Identify an arm that differs from its table: servos, payload, delay.

The simulated servos are 20 % softer than their table, have 40 % more friction and a tick of delay,
and the tool carries an unknown 0.2 kg. `pliant.identify` needs positions, goals and limits only, so
its functions also take a real arm, the result of `pliant.connect`.

python examples/17_identify.py
"""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SHORT = bool(os.environ.get("PLIANT_SHORT"))
START = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])  # [rad]

model = pliant.robots.arm7()
arm = pliant.sim.Plant(
    model,
    kp_scale=0.8,
    friction_scale=1.4,
    delay=(1, 0),  # [ticks]
    encoder_step=np.deg2rad(0.088),  # [rad]
    payload=(0.2, (0.02, 0.01, 0.05)),  # [kg], [m]
)
arm.reset(START)
table = model.servos.replace(encoder_step=np.deg2rad(0.088), stiffness_known=False)

# 1. Measure the gravity torques without motion, in four seconds.
settings = pliant.Settings.soft("y")
controller = pliant.Controller(model, settings, table)
print(f"capture\n{pliant.identify.capture_gravity(arm, controller)}\n")

# 2. Payload alone. The table's k_p is wrong, so the error bars are wide.
if not SHORT:
    print(f"weigh\n{pliant.identify.estimate_payload(arm, controller, span=0.4).summary()}\n")

# 3. Everything: two and a half minutes of simulated time, poses within ±0.4 rad.
result = pliant.identify.identify_servos(arm, model, table, span=0.4)
print(f"identify\n{result}\n")

# 4. A controller with all results: table, payload and delay.
controller = result.controller(model, settings)
target = model.forward_kinematics(arm.read().q)
for _ in range(200):
    command = controller.step(arm.read().q, target)
    arm.write(command.goal, command.torque_limit)
    arm.advance()
error = 1e3 * np.linalg.norm(arm.tool[:3, 3] - target[:3, 3])  # [mm]
print(f"held for 2 s with what was found: {error:.1f} mm off")
