"""Check before switching on: forces of a pose, limits of a path, and which setting to change.

python examples/09_what_can_this_pose_do.py
"""

import numpy as np

import pliant
import pliant.robots

model = pliant.robots.arm7()
q = np.array([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657])  # [rad]

# 1. Report of one pose, with the arm at rest on its target.
settings = pliant.Settings(axes={"y": pliant.Axis(soft=4.0, firm=15.0)})  # [N]
controller = pliant.Controller(model, settings)
report = controller.report(q)
print(report)

# Without q, `report` uses the pose and torque limits of the last step. It is fast enough to be
# called in every tick.
controller.step(q, model.forward_kinematics(q))
pushed_minus, pushed_plus = controller.report().axes["y"].host_loss_force
print(
    f"if this program stops now, a hand meets {pushed_plus:.1f} N in +y, {pushed_minus:.1f} in -y"
)

# 2. A path of 50 postures: can the arm exert 60 N sideways and hold 80 N in z?
path = q + 0.2 * np.sin(np.linspace(0.0, 3.0, 50))[:, None]
wanted = pliant.Settings(
    axes={"y": pliant.Axis(soft=0.05, firm=60.0), "z": pliant.Axis(hold=80.0)}  # [N]
)
check = pliant.feasibility.check_path(model, wanted, path)
print(f"\nasked for: {check}")

# 3. Apply its proposals: the smaller one where a setting is named for both sides.
proposed: dict[str, float] = {}
for issue in check.issues:
    if issue.required and issue.setting and issue.value is not None:
        proposed[issue.setting] = min(issue.value, proposed.get(issue.setting, np.inf))
changed = pliant.Settings(
    axes={
        "y": pliant.Axis(soft=0.05, firm=proposed["axes.y.firm"]),
        "z": pliant.Axis(hold=proposed["axes.z.hold"]),
    }
).raise_soft(model, path)  # raises soft to three times the friction
print(f"\nproposed: y {changed.axes['y']}, z {changed.axes['z']}")
print(pliant.feasibility.check_path(model, changed, path))

# 4. A tool pose works too.
far_target = model.forward_kinematics(q)
far_target[0, 3] += 1.0  # [m]
print(f"\none metre ahead: {pliant.feasibility.check_path(model, settings, far_target, q0=q)}")
