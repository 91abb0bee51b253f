"""Array types."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Array of real numbers.
Array = NDArray[np.float64]
#: Boolean mask.
Mask = NDArray[np.bool_]
