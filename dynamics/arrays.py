"""Array types shared by all rooms."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
