"""Functions that compute single equations of the paper behind the controller (docs/derivations.md).

>>> import pliant.functional as F
>>> F.compliance(0.03, soft_until=0.01, firm_from=0.10)
0.7777777777777778
"""

from pliant._core import (
    PaperOptions,
    activation,
    adapt_target,
    as_pose,
    compliance,
    damped_pseudo_inverse,
    holding_torque,
    joint_torque_limits,
    null_space_projector,
    pose_error,
    responsibility,
)

__all__ = [
    "PaperOptions",
    "activation",
    "adapt_target",
    "as_pose",
    "compliance",
    "damped_pseudo_inverse",
    "holding_torque",
    "joint_torque_limits",
    "null_space_projector",
    "pose_error",
    "responsibility",
]
