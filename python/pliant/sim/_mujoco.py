"""Import of MuJoCo; if MuJoCo is not installed, the error names the extra to install."""

from __future__ import annotations

try:
    import mujoco
except ImportError as error:
    from pliant._extras import missing

    raise ImportError(missing("pliant.sim", "sim")) from error

__all__ = ["mujoco"]
