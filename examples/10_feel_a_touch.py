"""Detect a touch without a force sensor, move out of the way, and return afterwards.

python examples/10_feel_a_touch.py
"""

import os

import numpy as np

import pliant
import pliant.robots
from pliant.reactions import After, Call, Deviation, Force, Hold, Reaction, Retract
from pliant.sim import ForceProfile, Plant, Push

model = pliant.robots.arm7()
controller = pliant.Controller(model, pliant.Settings.soft("y"))

# 1. What can this arm detect? State the model errors: a few percent for a simulated arm.
contact = pliant.ContactEstimator(controller, kp_error=0.02, gravity_error=0.02, guard=0.6)
x, y, z = contact.typical_uncertainty()[:3]
print(f"at rest, in the median pose: x ± {x:.1f} N, y ± {y:.1f} N, z ± {z:.1f} N")
try:
    pliant.ContactEstimator(controller, touch={"z": 0.5})
except pliant.OutOfRangeError as error:
    print(f"too fine a threshold is refused: {error}\n")

# 2. Reactions: after a push from below, move 5 cm up for a second; after a long drag, hold still.
upward_push = Force("z", above=6.0, toward="+").for_seconds(0.05)
sideways_drag = Deviation("y", above=0.08)
reactions = [
    Reaction(
        upward_push,
        [Call(lambda moment: print(f"{moment.time:.2f} s: felt {moment.wrench}")), Retract(0.05)],
        until=After(1.0),
    ),
    Reaction(sideways_drag & ~upward_push, Hold()),
]
monitor = pliant.ReactionMonitor(controller, reactions, contact=contact)
print("\n".join(repr(reaction.when) for reaction in reactions))

# 3. A hand lifts the tool with 10 N for a third of a second.
start = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])  # [rad]
hand = Push(force_vector=(0.0, 0.0, 10.0), course=ForceProfile(start=1.0, rise=0.1, end=1.35))
plant = Plant(model, scene=[hand], rate=100.0)
plant.reset(start)
controller.reset(start)
target = model.forward_kinematics(start)
seconds = 4.0 if os.environ.get("PLIANT_SHORT") else 6.0
for tick in range(round(seconds * plant.rate)):
    q = plant.read().q
    command = controller.step(q, monitor.update(q, target))  # the monitor first, then the step
    plant.write(command.goal, command.torque_limit)
    plant.advance()
    if tick % 50 == 49:
        force, height = plant.hands[0].force[2], 1e3 * (plant.tool[2, 3] - target[2, 3])
        state = "in force" if monitor.active else "resuming" if monitor.resuming else "free"
        print(f"{plant.time:.1f} s: {contact.estimate.force[2]:+5.1f} N felt, {force:4.1f} N true,")
        print(f"       tool {height:+5.1f} mm, {state}")

for line in monitor.log:
    print(f"{line.time:.2f} s: {line.what} {line.reaction.when!r}")
