"""Log a run, and write a report that explains where the arm was soft and where it was firm.

A hand pulls the tool sideways, where it yields, then down, where it holds. In the shell:
`pliant run my_arm.toml --log run.mcap`, then `pliant log report run.mcap`. Needs the extras "log"
and "plot". python examples/22_why_was_it_soft.py
"""

import os
import tempfile
from pathlib import Path

import numpy as np

import pliant
import pliant.log
import pliant.sim
from pliant.log import findings, forces
from pliant.log.report import report

SECONDS = 5.0 if os.environ.get("PLIANT_SHORT") else 8.0
START = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]  # [rad]
folder = Path(tempfile.mkdtemp())


def pull(axis, start):
    """Return a hand that moves the tool by 0.15 m within 1 s and lets go 1 s later."""
    course = pliant.sim.ForceProfile(start=start, rise=1.0, end=start + 2.0)
    return pliant.sim.Drag(
        axis=axis, distance=0.15, stiffness=3000.0, limit=60.0, at="tool", course=course
    )


settings = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=15.0)})  # [N]
plant = pliant.sim.Plant(pliant.robots.arm7(), scene=[pull("y", 1.0), pull("z", 4.0)])
plant.reset(START)
with pliant.Arm(plant.model, pliant.sim.SimDrive(plant)) as arm:
    controller = pliant.Controller(arm.model, settings, arm.servos)
    target = arm.model.forward_kinematics(arm.read().q)
    recorder = pliant.log.Recorder(folder / "run.mcap", note="two pulls")
    for tick in pliant.Loop(arm, controller, duration=SECONDS, recorder=recorder):
        tick.step(target)

log = pliant.log.read(folder / "run.mcap")
# The log has no forces: run the controller again, with a ContactEstimator.
estimates = forces.estimate_forces(log)
assert estimates is not None, "the computer was busy, and ticks are missing in the log: try again"
for k in range(3):
    force = float(np.abs(estimates.force[:, k]).max())
    print(findings.sentence(log, estimates, k), f"Felt: {force:.0f} N at most.")
for span in findings.spans(log)[:3]:
    took = span.end - span.start
    print(f"{span.joint} at its bound from {span.start:.2f} s for {took:.2f} s, by {span.axis}")
print(f"the page: {report(log, folder / 'report', title='two pulls')}")
