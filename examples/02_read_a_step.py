"""Read the intermediate values of one control step, from deviation to activation."""

import numpy as np

import pliant
import pliant.robots

model = pliant.robots.arm7()
settings = pliant.Settings(
    axes={
        # [N]; a pair is (pushed toward -, pushed toward +)
        "y": pliant.Axis(soft=4.0, firm=(15.0, 25.0), adaptation=0.5),
        "yaw": pliant.Axis(soft=0.8, firm=1.5),  # [N·m]
    },
)
controller = pliant.Controller(model, settings)

q = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])  # [rad]
target = model.forward_kinematics(q)
controller.reset(q)

# A hand holds the tool 6 cm to the left of its target.
displaced = target.copy()
displaced[1, 3] += 0.06
solution = model.inverse_kinematics(displaced, q)
command = controller.step(solution.q, target)

last = controller.diagnostics
np.set_printoptions(precision=3, suppress=True)
print("axis      deviation  adapted  softness  compliance  strength   wrench")
for k, name in enumerate(pliant.AXES):
    print(
        f"{name:6} {last.deviation[k]:12.4f} {last.adapted_deviation[k]:8.4f}"
        f" {last.softness[k]:9.2f} {last.compliance[k]:11.2f}"
        f" {last.axis_strength[k]:9.2f} {last.wrench[k]:8.2f}"
    )
print("\njoint            goal - q   torque limit   gravity")
for k, name in enumerate(model.joint_names):
    lead = command.goal[k] - solution.q[k]
    print(f"{name:16} {lead:+8.4f} {command.torque_limit[k]:12.2f} {last.gravity[k]:10.2f}")
print(f"\nsmallest singular value {last.sigma_min:.3f}, damping {last.damping:.3f}")
print("activation (joints × axes, the null space last):")
print(last.activation)
