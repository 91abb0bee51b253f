"""Servos softer than assumed: the arm drifts until gravity is captured.

The goal offset (lead) that holds an arm against gravity is g / k_p. If k_p is wrong, measure the
lead instead: hold the pose with integral action on the goal, and store the resulting lead.
"""

import os

import pliant
import pliant.robots
import pliant.sim

SECONDS = 1.0 if os.environ.get("PLIANT_SHORT") else 4.0
START = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657]  # [rad]

model = pliant.robots.arm7()
soft = pliant.Settings(
    axes={"y": pliant.Axis(soft=4.0, adaptation=0.999)}, accept_high_adaptation=True
)
holding = pliant.Settings(
    tracking=pliant.Tracking(integrate=4.0)
)  # all axes stiff, with integral action on the goal [1/s]


def run(controller: pliant.Controller, arm: pliant.sim.Plant, seconds: float) -> None:
    """Hold the start pose for `seconds`."""
    target = model.forward_kinematics(START)
    for _ in range(round(seconds * arm.rate)):
        command = controller.step(arm.read().q, target)
        arm.write(command.goal, command.torque_limit)
        arm.advance()


for capture in (False, True):
    arm = pliant.sim.Plant(model, kp_scale=0.8)  # true stiffness 80 % of the table's
    arm.reset(START)
    controller = pliant.Controller(model, holding if capture else soft)
    controller.reset(START)
    if capture:
        run(controller, arm, 2.0)
        goal = controller.step(arm.read().q, model.forward_kinematics(START)).goal
        controller.capture_gravity(arm.read().q, goal)
        controller.update(soft)
    before = arm.tool
    run(controller, arm, SECONDS)
    drift = 1e3 * (arm.tool[1, 3] - before[1, 3])  # [mm]
    label = "captured" if capture else "assumed"
    print(f"gravity {label}: y drifts {drift:+6.1f} mm in {SECONDS:.0f} s")
