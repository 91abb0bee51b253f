"""Import MuJoCo in one place, with a clear error if the extra is not installed."""

from __future__ import annotations

try:
    import mujoco
except ImportError as error:
    from pliant._extras import missing

    raise ImportError(missing("pliant.sim", "sim")) from error

__all__ = ["mujoco"]
