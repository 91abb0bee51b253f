"""The one place that imports MuJoCo, so that a missing extra is one clear line."""

from __future__ import annotations

try:
    import mujoco
except ImportError as error:
    raise ImportError('pliant.sim needs the extra "sim": pip install "pliant[sim]"') from error

__all__ = ["mujoco"]
