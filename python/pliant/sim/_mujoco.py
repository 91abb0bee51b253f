"""MuJoCo's Python package; if it is missing, this import raises an error that names the extra."""

from __future__ import annotations

try:
    import mujoco
except ImportError as error:
    from pliant._extras import missing

    raise ImportError(missing("pliant.sim", "sim")) from error

__all__ = ["mujoco"]
