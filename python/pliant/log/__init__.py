"""Portable logs: MCAP with ROS 2 messages, with all data to run the controller again.

>>> for tick in pliant.Loop(arm, controller, recorder=pliant.log.Recorder("run.mcap")):
...     tick.step(target)
>>> log = pliant.log.read("run.mcap")
>>> log.q, log.goal, pliant.log.verify(log).same
"""

from pliant.log.journal import Journal
from pliant.log.reader import Log, read
from pliant.log.recorder import Recorder
from pliant.log.verify import Verification, verify

__all__ = ["Journal", "Log", "Recorder", "Verification", "read", "verify"]
