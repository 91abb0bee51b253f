"""A thousand arms in one call, e.g. to train a policy in many simulated environments.

A state holds each arm's memory (velocity, slew, tool speed); finished episodes are reset one by
one. Each row equals the command of its own controller, bit for bit.
"""

import time

import numpy as np

import pliant
import pliant.robots

ARMS, TICKS = 1000, 300
model = pliant.robots.arm7()
settings = pliant.Settings()
controller = pliant.Controller(model, settings)
rng = np.random.default_rng(7)


def postures(count: int) -> np.ndarray:
    """Return random joint positions (count, n) in the middle of the ranges [rad]."""
    return model.lower + (model.upper - model.lower) * rng.uniform(0.3, 0.7, (count, model.n))


def targets_near(q: np.ndarray) -> np.ndarray:
    """Return tool poses (N, 4, 4) a few centimetres from those at q (N, n) [rad]."""
    return model.forward_kinematics_batch(q + rng.uniform(-0.1, 0.1, q.shape))


q = postures(ARMS)
targets = targets_near(q)
state = controller.batch_state(ARMS)
command = controller.step_batch(q, targets, state=state)  # later calls write into its arrays
single_controller, is_equal = pliant.Controller(model, settings), True
single_controller.step(q[0], targets[0])

arrivals, spent = 0, 0.0
for _ in range(TICKS):
    # Stand-in for a simulator: each tick covers a tenth of the distance to the equilibrium.
    q += 0.1 * (command.goal - q - model.gravity_batch(q) / model.servos.kp)
    tool = model.forward_kinematics_batch(q)
    is_at_target = np.linalg.norm(tool[:, :3, 3] - targets[:, :3, 3], axis=1) < 0.005
    is_at_target[0] = False  # keep the first arm, for comparison
    if is_at_target.any():
        arrivals += int(is_at_target.sum())
        q[is_at_target] = postures(int(is_at_target.sum()))
        targets[is_at_target] = targets_near(q[is_at_target])
        state.reset(is_at_target)
    start = time.perf_counter()
    controller.step_batch(q, targets, state=state, out=command)
    spent += time.perf_counter() - start
    single = single_controller.step(q[0], targets[0])
    is_equal &= np.array_equal(single.goal, command.goal[0])

print(f"{arrivals} episodes of {ARMS} arms ended on their targets")
print(f"{ARMS * TICKS / spent / 1e6:.2f} million steps a second on every core together")
print(f"first arm as with a controller of its own: {is_equal}")

# Without a state each row is independent, e.g. to label a data set.
q = postures(ARMS)
labels = controller.step_batch(q, targets_near(q))
print(f"goals without slew lead by up to {np.abs(labels.goal - q).max():.2f} rad")

# A diverged simulation does not stop the others.
q[3] = np.nan
labels = controller.step_batch(q, targets, state=state, invalid="nan")
print(f"rows without an answer: {np.flatnonzero(np.isnan(labels.goal[:, 0]))}")
