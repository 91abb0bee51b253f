"""Hand guiding: the arm is weightless and stays where it is released, also with a wrong k_p.

python examples/18_float.py
"""

import os

import numpy as np

import pliant
import pliant.robots
import pliant.sim

SECONDS = 3.0 if os.environ.get("PLIANT_SHORT") else 10.0
START = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])  # [rad]

model = pliant.robots.arm7()
count, deadband = np.deg2rad([0.088, 0.06])  # [rad]
table = model.servos.replace(encoder_step=count, stiffness_known=False)

for kp_scale in (0.5, 1.0, 2.0):
    # From 8 s + SECONDS on, a hand moves the tool 0.12 m to the left in 2 s, holds it, and lets go.
    course = pliant.sim.ForceProfile(start=8.0 + SECONDS, rise=2.0, end=11.0 + SECONDS)
    hand = pliant.sim.Drag(axis="y", distance=0.12, stiffness=2000.0, limit=60.0, course=course)
    arm = pliant.sim.Plant(
        model, kp_scale=kp_scale, encoder_step=count, deadband=deadband, scene=[hand]
    )
    arm.reset(START)

    floating = pliant.HandGuiding(model, table)  # then call step(q) at every tick
    positions, forces, start = [], [], 0
    while arm.time < 11.0 + 2.0 * SECONDS:
        command = floating.step(arm.read().q)
        arm.write(command.goal, command.torque_limit)
        arm.advance()
        start += not floating.ready  # the initial motion: do not touch the arm
        positions.append(arm.tool[:3, 3])
        forces.append(abs(arm.hands[0].force[1]))

    distances = 1e3 * np.linalg.norm(np.array(positions) - positions[start], axis=1)  # [mm]
    idle_motion = distances[start : start + round(100 * SECONDS)].max()
    release = round(100 * course.end)
    drift = 1e3 * np.linalg.norm(np.array(positions[release:]) - positions[release], axis=1).max()
    low, high = floating.stiffness / model.servos.kp
    print(
        f"k_p × {kp_scale:3.1f}: untouched {idle_motion:.1f} mm in {SECONDS:.0f} s, led by "
        f"{np.median(forces[round(100 * course.start) + 50 : release - 100]):.1f} N, "
        f"then moves {drift:.1f} mm; shoulder k_p taken for {low[0]:.2f} to {high[0]:.2f} × table"
    )
