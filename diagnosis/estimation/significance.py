"""How many standard deviations a vector of estimates is from zero."""

from __future__ import annotations

import numpy as np
import scipy

from dynamics.arrays import Floats


def deviations_of(distance: Floats, covariance: Floats) -> float:
    """Standard deviations of a single estimate that chance reaches as rarely as all of these together.

    distance: (k,). covariance: (k, k) of it. 2 is a probability of 95 %.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    scaled = np.linalg.pinv(covariance / np.outer(scale, scale), rcond=1e-10)
    squared = float((distance / scale) @ scaled @ (distance / scale))
    return float(scipy.stats.norm.isf(max(scipy.stats.chi2.sf(max(squared, 0.0), len(distance)), 1e-300) / 2))
