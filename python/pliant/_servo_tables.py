"""Selection, broadcasting and concatenation of servo parameters (`Servos`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from pliant._core import Servos
    from pliant._typing import Array

#: Fields of `Servos` with one number, or one number per joint.
COLUMNS = (
    "kp",
    "max_torque",
    "friction",
    "load_friction",
    "stribeck",
    "load_stribeck",
    "stribeck_speed",
    "damping",
    "kv",
    "armature",
    "encoder_step",
)
#: No-load speed [rad/s] that stands for "no back-EMF" in a table where the field needs a number.
UNREACHABLE = 1e6


def take(table: Servos, n: int, indices: ArrayLike) -> Servos:
    """Return a servo table with the entries of some joints of a table for n joints.

    Args:
        table: Parameters of n servos; a field may hold one number for all joints.
        n: Number of joints of the table.
        indices: Indices of the joints.

    Raises:
        ConfigError: A field has neither one nor n entries.
    """
    return table.replace(**_columns(table, n, np.asarray(indices, dtype=int)))


def spread(table: Servos, n: int) -> Servos:
    """Return the servo table with n entries in every field; a single number is repeated.

    Raises:
        ConfigError: A field has neither one nor n entries.
    """
    return take(table, n, np.arange(n))


def join(first: Servos, rest: Sequence[Servos]) -> Servos:
    """Concatenate servo tables; limit type and `stiffness_known` are those of the first table.

    If the first table has a no-load speed (limit type `pwm`), servos of a table without one get the
    no-load speed `UNREACHABLE`, which means no back-EMF.
    """
    tables = [first, *rest]
    sizes = [np.size(table.kp) for table in tables]

    def column(name: str) -> Array:
        values = [getattr(table, name) for table in tables]
        values = [UNREACHABLE if value is None else value for value in values]
        rows = zip(values, sizes, strict=True)
        return np.concatenate([np.broadcast_to(value, size) for value, size in rows])

    joined: dict[str, Any] = {name: column(name) for name in COLUMNS}
    if first.no_load_speed is not None:
        joined["no_load_speed"] = column("no_load_speed")
    return first.replace(**joined)


def _columns(table: Servos, n: int, indices: NDArray[np.int_]) -> dict[str, Any]:
    """Return, for every numeric field of a table for n joints, its entries at the given indices."""
    names = [*COLUMNS, *(["no_load_speed"] if table.no_load_speed is not None else [])]
    out = {}
    for name in names:
        value = np.asarray(getattr(table, name), dtype=np.float64)
        if value.shape not in {(), (1,), (n,)}:
            raise ConfigError(f"servos.{name} has {value.size} entries for {n} joints")
        out[name] = np.broadcast_to(value, n)[indices]
    return out
