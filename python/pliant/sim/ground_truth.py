"""True poses and velocities of the simulated frames, for hands, scenes and figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import FrameNotFoundError
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from pliant._typing import Array

#: Names of frames that every robot has in addition to its links: the tip of the chain (`tool`), and
#: the link that the chain's last joint moves (`wrist`).
TOOL, WRIST = "tool", "wrist"

#: Vector (3,) for a force or torque that does not act; the plant recognizes this object.
ZERO = np.zeros(3)
ZERO.setflags(write=False)


_SITE = int(mujoco.mjtObj.mjOBJ_SITE)


class Frame:
    """Frame of the robot in base axes: present pose and velocity, and start pose."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, site: int) -> None:
        """Create the frame of the MuJoCo site with the index `site`."""
        self._model, self._data, self.site = model, data, site
        self.body = int(model.site_bodyid[site])
        #: Present position (3,) [m], a view of the simulation state.
        self.position: Array = data.site_xpos[site]
        self._matrix: Array = data.site_xmat[site]
        self._twist = np.zeros(6)
        self._angular, self._linear = self._twist[:3], self._twist[3:]
        self.remember()

    def remember(self) -> None:
        """Store the present pose as the start pose; a reset of the plant does this too."""
        self.start = self.position.copy()
        self.start_rotation = self.rotation.copy()

    @property
    def rotation(self) -> Array:
        """Present rotation matrix (3, 3), a view of the simulation state."""
        return self._matrix.reshape(3, 3)

    @property
    def pose(self) -> Array:
        """Present pose (4, 4) in base axes, a copy."""
        pose = np.eye(4)
        pose[:3, :3] = self.rotation
        pose[:3, 3] = self.position
        return pose

    def shift(self) -> Array:
        """Return the displacement (3,) [m] from the start pose, in base axes."""
        return self.position - self.start

    def turn(self) -> Array:
        """Return the rotation from the start pose as a rotation vector (3,) [rad] in base axes."""
        quat, vector = np.zeros(4), np.zeros(3)
        mujoco.mju_mat2Quat(quat, (self.rotation @ self.start_rotation.T).reshape(9))
        mujoco.mju_quat2Vel(vector, quat, 1.0)
        return vector

    def twist(self) -> Array:
        """Return the velocity (6,) of the frame in base axes.

        The linear velocity of the origin [m/s] comes first, then the angular velocity [rad/s].
        """
        return np.concatenate(self.velocities())

    def velocities(self) -> tuple[Array, Array]:
        """Return linear velocity of the origin (3,) [m/s] and angular velocity (3,) [rad/s].

        Both are in base axes, and views that the next call overwrites.
        """
        mujoco.mj_objectVelocity(self._model, self._data, _SITE, self.site, self._twist, 0)
        return self._linear, self._angular


class GroundTruth:
    """Frames of the simulation by name: every link, `tool` and `wrist`."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, aliases: dict[str, str]) -> None:
        """Store the simulation; `aliases` maps `tool` and `wrist` to link names."""
        self.model, self.data = model, data
        self._aliases = aliases
        self._frames: dict[str, Frame] = {}

    def frame(self, name: str) -> Frame:
        """Return a frame by the name of a link, `tool` or `wrist`.

        Raises:
            FrameNotFoundError: There is no such frame; the message lists the known frames.
        """
        frame = self._frames.get(name)
        if frame is not None:
            return frame
        names = [self.model.site(i).name for i in range(self.model.nsite)]
        link = name if name in names else self._aliases.get(name, name)
        if link not in names:
            known = dict.fromkeys([*self._aliases, *names])
            raise FrameNotFoundError(
                f"no frame {name!r} in the simulation; there are {', '.join(known)}"
            )
        frame = self._frames[name] = Frame(self.model, self.data, self.model.site(link).id)
        return frame

    def remember(self) -> None:
        """Store the present pose of each frame as its start pose."""
        for frame in self._frames.values():
            frame.remember()
