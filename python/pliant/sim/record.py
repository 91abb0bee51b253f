"""Recorder of simulated runs: named signals, one row per call, as NumPy arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ShapeError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._typing import Array
    from pliant.sim.plant import Plant


class Recorder:
    """Records the true state of a simulated run and further signals of the caller.

    Signals of every row:

    - `t`: time [s];
    - `q`, `dq`: joint positions (n,) [rad] and velocities (n,) [rad/s];
    - `tool`: pose of the tool (4, 4) in base axes;
    - `torque`: servo torques (n,) [N·m], mean over the last control period;
    - `force{k}`, `torque{k}`: mean force (3,) [N] and torque (3,) [N·m] of hand number k, from 0.

    Example:
        >>> record = Recorder(plant)
        >>> record.add(compliance=controller.diagnostics.compliance)
        >>> record["tool"][:, 1, 3]  # y of the tool over time
    """

    def __init__(self, plant: Plant) -> None:
        """Create a recorder of `plant` without rows."""
        self._plant = plant
        self._rows: dict[str, list[Array]] = {}
        self._count = 0

    def add(self, **signals: ArrayLike) -> None:
        """Add a row with the plant's true state and the given signals.

        Raises:
            ShapeError: The signals of a row or their shapes differ from those of the first row.
        """
        plant = self._plant
        row: dict[str, ArrayLike] = {
            "t": plant.time,
            "q": plant.q,
            "dq": plant.dq,
            "tool": plant.tool,
            "torque": plant.torque,
        }
        for k, record in enumerate(plant.hands):
            row[f"force{k}"], row[f"torque{k}"] = record.force, record.torque
        row.update(signals)
        if self._count and row.keys() != self._rows.keys():
            names = ", ".join(sorted(row.keys() ^ self._rows.keys()))
            raise ShapeError(f"every row of a record has the same signals; these differ: {names}")
        arrays = {name: np.array(value, dtype=np.float64) for name, value in row.items()}
        for name, array in arrays.items():
            if self._count and array.shape != self._rows[name][0].shape:
                old = self._rows[name][0].shape
                raise ShapeError(f"signal {name!r} changed its shape from {old} to {array.shape}")
        for name, array in arrays.items():
            self._rows.setdefault(name, []).append(array)
        self._count += 1

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._count

    def __getitem__(self, name: str) -> Array:
        """Return the signal `name` of all rows as an array (rows, ...).

        Raises:
            KeyError: There is no such signal; the message lists the known signals.
        """
        if name not in self._rows:
            raise KeyError(f"no signal {name!r}; there are {', '.join(self._rows) or 'none yet'}")
        return np.stack(self._rows[name])

    def arrays(self) -> dict[str, Array]:
        """Return all signals by name, each of shape (rows, ...)."""
        return {name: np.stack(rows) for name, rows in self._rows.items()}
