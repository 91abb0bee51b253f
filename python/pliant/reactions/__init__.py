"""Reactions to contact: conditions on measured quantities, and the actions that they trigger.

    >>> from pliant.reactions import Deviation, Force, Reaction, Retract, ReactionMonitor
    >>> bumped = Force("z", above=9.0).for_seconds(0.05) & ~Deviation("xy", above=0.02)
    >>> monitor = ReactionMonitor(controller, [Reaction(bumped, Retract(0.05))])
    >>> for tick in loop:
    ...     command = controller.step(tick.q, monitor.update(tick.q, target))

In each control cycle, call `update` before the step of the controller: `update` returns the target
for that step.
"""

from pliant.reactions.actions import Action, Call, Follow, Hold, Retract, Running, Stop, Yield
from pliant.reactions.conditions import (
    After,
    Condition,
    ContactEvent,
    Deviation,
    Force,
    ResidualAbove,
    Saturated,
    Speed,
    TickContext,
)
from pliant.reactions.monitor import Reaction, ReactionEvent, ReactionMonitor

__all__ = [
    "Action",
    "After",
    "Call",
    "Condition",
    "ContactEvent",
    "Deviation",
    "Follow",
    "Force",
    "Hold",
    "Reaction",
    "ReactionEvent",
    "ReactionMonitor",
    "ResidualAbove",
    "Retract",
    "Running",
    "Saturated",
    "Speed",
    "Stop",
    "TickContext",
    "Yield",
]
