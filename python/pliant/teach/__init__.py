"""Teach by hand and replay, softly.

>>> motion = pliant.teach.record(arm, seconds=20.0)     # float, lead it, rest: it ends
>>> motion.save("wave.json")
>>> replay = pliant.teach.Replay(controller, motion, speed=1.0)
>>> for tick in pliant.Loop(arm, controller):
...     tick.write(replay.step(tick.q, dt=tick.dt), replay.extra(arm))
...     if replay.done:
...         break
"""

from pliant.teach._retiming import retime
from pliant.teach.motion import Motion
from pliant.teach.replay import Replay
from pliant.teach.teacher import Teacher, record

__all__ = ["Motion", "Replay", "Teacher", "record", "retime"]
