"""The one place that imports MuJoCo, so that a missing extra is one clear line."""

from __future__ import annotations

try:
    import mujoco
except ImportError as error:
    from pliant.extras import missing

    raise ImportError(missing("pliant.sim", "sim")) from error

__all__ = ["mujoco"]
