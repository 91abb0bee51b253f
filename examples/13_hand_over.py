"""Hand over an object of unknown weight: give way to the hand that takes it, then let go.

Close to its target the arm resists enough to carry the object. Once the hand has moved it by 50 mm,
the gripper opens. With all axes stiff, the person has to pull three times as hard.
"""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 3.2 if os.environ.get("PLIANT_SHORT") else 6.0
START = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657]  # [rad]
RELEASE_DISTANCE = 0.05  # [m]

model = pliant.robots.arm7()
variants = {"hand_over": pliant.Settings.hand_over(), "all axes stiff": pliant.Settings.firm()}

for name, settings in variants.items():
    handover_object = pliant.sim.HandoverObject(mass=0.3)  # a person takes hold of it at 2 s
    arm = pliant.sim.Plant(model, scene=[handover_object])
    arm.reset(START)
    controller = pliant.Controller(model, settings)
    controller.reset(START)
    target, sag = arm.tool, 0.0
    for _ in range(round(SECONDS * arm.rate)):
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
        deviation = float(np.linalg.norm(controller.diagnostics.deviation[:3]))  # [m]
        if arm.time < 2.0:
            sag = deviation
        elif handover_object.released is None and deviation > RELEASE_DISTANCE:
            handover_object.release(arm)  # on a real arm: arm.gripper.open()
    release_time = (
        "never" if handover_object.released is None else f"at {handover_object.released:.2f} s"
    )
    print(
        f"{name}: hung {1e3 * sag:.0f} mm under 0.3 kg, let go {release_time}; "
        f"the person pulled with at most {handover_object.peak_effort:.0f} N"
    )
