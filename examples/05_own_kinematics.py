"""The equations as functions, for a robot with its own kinematics: a planar 2-link arm."""

import numpy as np

import pliant

LENGTHS = (0.3, 0.25)  # [m]
q = np.array([0.4, 0.9])  # [rad]


def jacobian(q: np.ndarray) -> np.ndarray:
    """Return the position Jacobian (2, 2) [m/rad] of the planar arm at q (2,) [rad]."""
    a, ab = q[0], q[0] + q[1]
    return np.array(
        [
            [-LENGTHS[0] * np.sin(a) - LENGTHS[1] * np.sin(ab), -LENGTHS[1] * np.sin(ab)],
            [LENGTHS[0] * np.cos(a) + LENGTHS[1] * np.cos(ab), LENGTHS[1] * np.cos(ab)],
        ]
    )


J = jacobian(q)
J_pinv = pliant.functional.damped_pseudo_inverse(J, 0.02)  # eq. (3), damping [m]
N = pliant.functional.null_space_projector(J)  # eq. (4): no redundancy here, so zero
A = pliant.functional.activation(J_pinv, N)  # eq. (6), (10): the share of each joint in each axis

deviation = np.array([0.03, -0.002])  # target minus actual [m]
c = pliant.functional.compliance(deviation, 0.01, 0.10)  # eq. (8)
tau_x = pliant.functional.holding_torque(c, 0.5, 4.0, 6.0, [True, False])  # eq. (9) [N·m]
tau_q = pliant.functional.joint_torque_limits(A, np.append(tau_x, 0.0))  # eq. (11) [N·m]

np.set_printoptions(precision=3, suppress=True)
print("activation\n", A)
print("compliance", c, " budgets", tau_x, "N·m  joint limits", tau_q, "N·m")
