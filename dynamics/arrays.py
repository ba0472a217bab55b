"""Types of arrays and vectors, shared by all rooms."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Vector3 = tuple[float, float, float]
