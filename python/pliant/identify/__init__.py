"""Identification of gravity offset, payload, servos and delay; and hand guiding.

    >>> found = pliant.identify.identify_servos(arm, arm.model, arm.servos)       # 2 minutes
    >>> print(found)
    >>> controller = found.controller(arm.model, settings)
    >>> pliant.identify.capture_gravity(arm, controller)                      # 4 s, moves nothing
    >>> pliant.identify.estimate_payload(arm, controller)                      # 30 s

They need only positions, goals and torque limits, of any arm with `read` and `write`, connected or
simulated. Each function has `.procedure(...)`, which makes a `Procedure` with `step(q)` for a loop
of your own.
"""

from pliant.identify.gravity import GravityCapture, capture_gravity
from pliant.identify.hand_guiding import HandGuiding
from pliant.identify.payload import estimate_payload
from pliant.identify.procedure import Guided, Procedure, run_procedure
from pliant.identify.result import Identification, PayloadEstimate
from pliant.identify.servos import identify_servos

__all__ = [
    "GravityCapture",
    "Guided",
    "HandGuiding",
    "Identification",
    "PayloadEstimate",
    "Procedure",
    "capture_gravity",
    "estimate_payload",
    "identify_servos",
    "run_procedure",
]
