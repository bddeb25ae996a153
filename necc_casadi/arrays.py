"""The arrays that pass through the whole house, as types."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["Indices", "Truth", "Vector"]


Truth = npt.NDArray[np.bool_]


Indices = npt.NDArray[np.intp]


Vector = npt.NDArray[np.float64]
