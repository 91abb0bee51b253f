"""True state of the simulation, for hands, scenes and figures; not available to a controller."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import FrameNotFoundError
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from pliant._typing import Array

#: Frame names that every robot has besides its links: tip of the chain, and its last moving body.
TOOL, WRIST = "tool", "wrist"


class Frame:
    """One frame of the robot in base axes: present pose and velocity, and start pose."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, site: int) -> None:
        """Observe a site."""
        self._model, self._data, self.site = model, data, site
        self.body = int(model.site_bodyid[site])
        #: Position (3,) [m], a live view.
        self.position: Array = data.site_xpos[site]
        self._matrix: Array = data.site_xmat[site]
        self._twist = np.zeros(6)
        self.remember()

    def remember(self) -> None:
        """Store the present pose as the start."""
        self.start = self.position.copy()
        self.start_rotation = self.rotation.copy()

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3), a live view."""
        return self._matrix.reshape(3, 3)

    @property
    def pose(self) -> Array:
        """Pose (4, 4), a copy."""
        pose = np.eye(4)
        pose[:3, :3] = self.rotation
        pose[:3, 3] = self.position
        return pose

    def shift(self) -> Array:
        """Return the displacement from the start (3,) [m]."""
        return self.position - self.start

    def turn(self) -> Array:
        """Return the rotation vector (3,) [rad] from the start, in base axes."""
        quat, vector = np.zeros(4), np.zeros(3)
        mujoco.mju_mat2Quat(quat, (self.rotation @ self.start_rotation.T).reshape(9))
        mujoco.mju_quat2Vel(vector, quat, 1.0)
        return vector

    def twist(self) -> Array:
        """Velocity (6,) in base axes: linear [m/s] at the frame's origin, then angular [rad/s]."""
        mujoco.mj_objectVelocity(
            self._model, self._data, mujoco.mjtObj.mjOBJ_SITE, self.site, self._twist, 0
        )
        return np.concatenate((self._twist[3:], self._twist[:3]))


class GroundTruth:
    """The frames of the simulation by name: every link, `tool` and `wrist`."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, aliases: dict[str, str]) -> None:
        """Find the frames; `aliases` maps `tool` and `wrist` to links."""
        self.model, self.data = model, data
        self._aliases = aliases
        self._frames: dict[str, Frame] = {}

    def frame(self, name: str) -> Frame:
        """Return a frame by the name of a link, `tool` or `wrist`.

        Raises:
            FrameNotFoundError: There is no such frame; the message lists those there are.
        """
        found = self._frames.get(name)
        if found is not None:
            return found
        names = [self.model.site(i).name for i in range(self.model.nsite)]
        link = name if name in names else self._aliases.get(name, name)
        if link not in names:
            there = dict.fromkeys([*self._aliases, *names])
            raise FrameNotFoundError(
                f"no frame {name!r} in the simulation; there are {', '.join(there)}"
            )
        found = self._frames[name] = Frame(self.model, self.data, self.model.site(link).id)
        return found

    def remember(self) -> None:
        """Store the present poses of all frames as their start."""
        for frame in self._frames.values():
            frame.remember()
