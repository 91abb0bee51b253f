"""NumPy array types for annotations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Array of float64.
Array = NDArray[np.float64]
#: Array of booleans that selects joints.
Mask = NDArray[np.bool_]
