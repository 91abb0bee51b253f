"""Logs in MCAP files with ROS 2 messages, complete enough to recompute every command.

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
