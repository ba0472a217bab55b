"""What was true in a simulated campaign: the increments that labels only estimate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import DataError
from flights.flight import Flight
from flights.labels import mean_increment
from training.dataset import Dataset
from training.features import body_accelerations

Floats = NDArray[np.float64]
FOLDER = "truth"  # of a campaign


def true_label(data: Dataset, campaign: Path, *, dt: float) -> Floats:
    """(n, 6) true mean body accelerations over the next dt at the rows of a campaign's flights; NaN at their ends.

    Raises DataError when the campaign kept no truth of one of the flights.
    """
    found = np.full((len(data.time), 6), np.nan)
    for place, name in enumerate(data.flights):
        path = campaign / FOLDER / name
        if not path.exists():
            raise DataError(f"{path} is missing: errors against the truth need a campaign's own flights and folder.")
        flight = Flight.read(path, rate=1 / dt)
        rows = np.flatnonzero(data.flight_of == place)
        at = np.searchsorted(flight.time, data.time[rows] - 0.25 * dt)
        increments = mean_increment(np.hstack([flight["velocity"], flight["rate"]]), 1 / dt, dt)
        inside = at < len(increments)
        found[rows[inside]] = body_accelerations(increments[at[inside]], data.state[rows[inside], 3:7])
    return found
