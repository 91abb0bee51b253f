"""Reactions to contact: conditions on measured quantities, and the actions that they trigger.

    >>> from pliant.reactions import Deviation, Force, Reaction, Retract, ReactionMonitor
    >>> bumped = Force("z", above=9.0).lasting(0.05) & ~Deviation("xy", above=0.02)
    >>> watch = ReactionMonitor(controller, [Reaction(bumped, Retract(0.05))])
    >>> for tick in loop:
    ...     command = controller.step(tick.q, watch.update(tick.q, target))

Call `update` before the step of its tick: it returns the target for the step.
"""

from pliant.reactions.actions import Action, Call, Follow, Hold, Retract, Running, Stop, Yield
from pliant.reactions.conditions import Condition
from pliant.reactions.measures import (
    Deviation,
    Elapsed,
    Evidence,
    Force,
    Saturated,
    Speed,
    Touched,
)
from pliant.reactions.moment import Moment
from pliant.reactions.monitor import Noted, Reaction, ReactionMonitor

__all__ = [
    "Action",
    "Call",
    "Condition",
    "Deviation",
    "Elapsed",
    "Evidence",
    "Follow",
    "Force",
    "Hold",
    "Moment",
    "Noted",
    "Reaction",
    "ReactionMonitor",
    "Retract",
    "Running",
    "Saturated",
    "Speed",
    "Stop",
    "Touched",
    "Yield",
]
