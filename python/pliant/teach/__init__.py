"""Record a motion while a person guides the arm by hand, and replay it with a compliant arm.

>>> motion = pliant.teach.record(arm, seconds=20.0)     # ends earlier if the arm is left at rest
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
