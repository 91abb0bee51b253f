"""ROS 2 and Foxglove without ROS: publish an arm's state, take targets and softness.

A separate process talks to the network, so that the control loop never waits for it. `pliant ros`
and `pliant foxglove` run a whole arm; `Bridge` connects your own loop.

>>> with pliant.ros.ros_link() as link, pliant.connect("so101") as arm:
...     loop = pliant.Loop(arm, pliant.Controller(arm.model, settings, arm.servos))
...     bridge = pliant.ros.Bridge(arm, loop, link)
...     for tick in loop:
...         bridge.step(tick)
"""

from pliant.ros.bridge import Bridge
from pliant.ros.processes import foxglove_link, ros_link

__all__ = ["Bridge", "foxglove_link", "ros_link"]
