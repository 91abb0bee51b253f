"""Logs of runs in MCAP files with ROS 2 messages: recording, reading, and verification.

A log contains every call of the controller, from which `verify` recomputes the commands with the
same version of pliant. If the writer process is too slow, calls are missing (`Log.missing`).

>>> for tick in pliant.Loop(arm, controller, recorder=pliant.log.Recorder("run.mcap")):
...     tick.step(target)
>>> log = pliant.log.read("run.mcap")
>>> log.q, log.goal, pliant.log.verify(log).same
"""

from pliant._extras import missing

try:
    import mcap_ros2.writer  # noqa: F401 - imports mcap and zstandard too
except ImportError as error:
    raise ImportError(missing("pliant.log", "log")) from error

from pliant.log.journal import Journal
from pliant.log.reader import Log, read
from pliant.log.recorder import Recorder
from pliant.log.verify import Verification, verify

__all__ = ["Journal", "Log", "Recorder", "Verification", "read", "verify"]
