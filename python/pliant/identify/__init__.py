"""The arm finds out about itself: gravity offset, payload, servos, delay; and a mode to guide it.

    >>> found = pliant.identify.run(arm, arm.model, arm.servos)       # 2 minutes
    >>> print(found)
    >>> controller = found.controller(arm.model, settings)
    >>> pliant.identify.capture(arm, controller)                      # 4 s, moves nothing
    >>> pliant.identify.payload(arm, controller)                      # 30 s

From positions, goals and torque limits alone, on any arm that has `read` and `write`: connected or
simulated. Each call is also a `Procedure` with `step(q)` for a loop of one's own (`capturing`,
`weighing`, `identification`).
"""

from pliant.identify.capture import Captured, capture, capturing
from pliant.identify.found import Identification, PayloadEstimate
from pliant.identify.guided import identification, run
from pliant.identify.hand_guiding import HandGuiding
from pliant.identify.payload import payload, weighing
from pliant.identify.seam import Order, Procedure, drive

__all__ = [
    "Captured",
    "HandGuiding",
    "Identification",
    "Order",
    "PayloadEstimate",
    "Procedure",
    "capture",
    "capturing",
    "drive",
    "identification",
    "payload",
    "run",
    "weighing",
]
