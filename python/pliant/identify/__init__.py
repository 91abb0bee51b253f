"""Identification of servos, delay, payload and gravity offset on the arm; and hand guiding.

    >>> result = pliant.identify.identify_servos(arm, arm.model, arm.servos)      # 2 minutes
    >>> print(result)
    >>> controller = result.controller(arm.model, settings)
    >>> pliant.identify.capture_gravity(arm, controller)                      # 4 s, moves nothing
    >>> pliant.identify.estimate_payload(arm, controller)                      # 30 s

The procedures need only joint positions, goals and torque limits, so they accept any real or
simulated arm with `read` and `write`. For your own control loop, call the attribute `procedure` of
a function, as in `capture_gravity.procedure(controller)`: it returns a `Procedure`, whose `step(q)`
is called once per cycle.
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
