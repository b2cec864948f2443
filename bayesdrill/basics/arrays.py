"""Names for types of arrays: of numbers, of yes and no, of indices, of counts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Counts = NDArray[np.int64]

PART = 1 << 18  # numbers of a long series that are looked at together, lest all of it is copied
