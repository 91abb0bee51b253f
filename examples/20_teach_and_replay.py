"""Teach a motion by hand; the arm repeats it softly, waits while it is held, and continues.

In the shell: `pliant teach my_arm.toml wave.json`, then `pliant replay my_arm.toml wave.json
--soft "y=2"`. Here a simulated SO-101 and scripted hands; with the extra "log" the replay is
logged, and the log verified. python examples/20_teach_and_replay.py
"""

import contextlib
import importlib.util
import os
import tempfile
from pathlib import Path

import numpy as np

import pliant
import pliant.sim
import pliant.teach

HOLD_TIME = 2.0 if os.environ.get("PLIANT_SHORT") else 5.0  # [s]
START = [0.0, -0.3, 0.3, 0.9, 0.0]  # [rad]
folder = Path(tempfile.mkdtemp())
print(f"files: {folder}")


def grip(axis, distance, start, rise, end):
    """Return a strong hand at the tool, between two times [s]."""
    course = pliant.sim.ForceProfile(start=start, rise=rise, end=end)
    return pliant.sim.Drag(
        axis=axis, distance=distance, stiffness=2000.0, limit=60.0, at="tool", course=course
    )


# Teach by hand guiding: from 14 s on, a hand moves the tool to the side and up, and lets go.
hands = [grip("y", 0.08, 14.0, 3.0, 17.5), grip("z", 0.03, 14.0, 3.0, 17.5)]
with pliant.connect("so101", backend="sim", q=START, scene=hands) as arm:
    motion = pliant.teach.record(arm, on_status=print)
motion.save(folder / "wave.json")

# Replay with y soft (2 N): a hand holds the tool from the start, then lets go.
motion = pliant.teach.Motion.load(folder / "wave.json")
settings = pliant.Settings(task="xyz", axes={"y": pliant.Axis(soft=2.0, profile="constant")})
wall = grip("y", 0.0, 0.0, 0.0, 7.0 + HOLD_TIME)

with contextlib.ExitStack() as stack:
    arm = stack.enter_context(pliant.connect("so101", backend="sim", q=START, scene=[wall]))
    controller = pliant.Controller(arm.model, settings, arm.servos)
    recorder = None
    if importlib.util.find_spec("mcap_ros2") is not None:
        from pliant.log import Recorder

        recorder = Recorder(folder / "replay.mcap")
    loop = pliant.Loop(arm, controller, recorder=recorder)
    replay = pliant.teach.Replay(loop.controller, motion)
    state, forces = "", []
    for tick in loop:
        command = replay.step(tick.q, dt=tick.dt)
        tick.write(command, replay.extra(arm))
        forces.append(np.linalg.norm(arm.drive.plant.hands[0].force))
        if replay.state != state:
            state = replay.state
            print(f"at {tick.time:4.1f} s the motion is at {replay.time:.2f} s: {state}")
        if replay.done:
            break
    print(
        f"the hand that held it felt at most {max(forces):.1f} N; waited "
        f"{replay.blocked_time:.1f} s"
    )
    goal = arm.model.forward_kinematics(motion.q[-1])[:3, 3]
    print(f"off the end: {1e3 * np.linalg.norm(arm.drive.plant.tool[:3, 3] - goal):.1f} mm")

if recorder is not None:
    again = pliant.log.verify(pliant.log.read(recorder.path))
    print(f"run again from the log: {again.steps} commands, all the same: {again.same}")
