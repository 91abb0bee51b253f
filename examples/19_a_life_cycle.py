"""Life cycle of an arm: torque on, an error that is handled, and a descent at the end.

Runs on a simulated SO-101. For a real arm, call `pliant.connect("my_arm.toml")` and omit the height
of the tool, which `arm.drive.plant`, the simulation, returns. Ctrl-C lowers the arm at any time.
"""

import os

import numpy as np

import pliant

SECONDS = 2.0 if os.environ.get("PLIANT_SHORT") else 6.0
START = [0.0, -0.3, 0.3, 0.9, 0.0]  # [rad]

arm = pliant.connect("so101", backend="sim", q=START)
settings = pliant.Settings(task=pliant.Task(axes="xyz"), axes={"y": pliant.Axis(soft=1.0)})

with arm:  # torque on: limits, goals, torque, then a ramp of half a second
    controller = pliant.Controller(arm.model, settings, arm.servos)
    start = arm.model.forward_kinematics(arm.read().q)[:3, 3]
    arm.gripper.close()

    loop = pliant.Loop(arm, controller, rate=100.0, duration=SECONDS)
    for tick in loop:
        target = start + 0.03 * np.sin(np.pi * tick.time) * np.array([0.0, 1.0, 0.0])  # [m]
        if 100 <= tick.index < 120:
            target = np.full(3, np.nan)  # a policy that returns NaN
        try:
            tick.step(target)
        except pliant.OutOfRangeError:
            tick.skip()  # goal and limits stay; without this line the error would lower the arm

    print(f"late: {loop.lateness}; missed {loop.missed}, delay {1e3 * loop.delay:.0f} ms")
    hottest = max(arm.heat, key=arm.heat.get)
    print(f"hottest: {hottest} with {100 * arm.heat[hottest]:.0f} % of its thermal budget in use")
    height = arm.drive.plant.tool[2, 3]

# The block has ended: the arm was lowered at 0.15 m/s at most, and its torque is off.
fallen = 1e3 * (height - arm.drive.plant.tool[2, 3])
print(f"torque on: {arm.enabled}; the tool came down by {fallen:.0f} mm at {arm.clock.now():.1f} s")
