"""Array types by their content, for annotations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
IntArray = NDArray[np.int64]
Stamps = NDArray[np.int64]  # ns
