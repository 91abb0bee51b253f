"""Logs of runs in MCAP files with ROS 2 messages: recording, reading, and verification.

A log holds every call of the controller, so that `verify` can recompute the commands with the same
version of pliant, unless the writer process was too slow and dropped calls (`Log.missing`).

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
