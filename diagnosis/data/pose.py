"""Where the pose comes from when neither the log nor the user tells."""

from __future__ import annotations

import numpy as np
import scipy

from diagnosis.data.filters import difference
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics import quaternion
from dynamics.arrays import Floats
from flights import Flight
from flights.pose_source import PoseSource


def pose_source(flight: Flight, thresholds: Thresholds = DEFAULT) -> PoseSource:
    """The source that the log or the user tells; else an estimator if the velocity holds the accelerometer's noise.

    Motion capture cannot see that noise, so that its acceleration and the accelerometer do not agree at frequencies
    that no motion reaches. What agrees less is unknown.
    """
    if flight.pose_source != "unknown" or not flight.has("specific_force", "velocity", "attitude"):
        return flight.pose_source
    limits, origin = thresholds.pose, flight.origins.get("velocity")
    rate = flight.rate if origin is None else min(flight.rate, origin.rate)
    low = limits.sensor_band[0] * thresholds.filters.cutoff
    band = low, min(limits.sensor_band[1] * thresholds.filters.cutoff, limits.sensor_share * rate)
    parts = [part for part in flight.segments() if len(part) >= 4 * limits.sensor_rows]
    if band[1] <= band[0] or not parts:
        return "unknown"
    coherent = [_coherence(part, band, limits.sensor_rows) for part in parts]
    return "estimator" if float(np.median(coherent)) > limits.min_coherence else "unknown"


def _coherence(part: Flight, band: tuple[float, float], rows: int) -> float:
    """Share of the velocity's derivative that the accelerometer has as well, inside a band, Hz; over the three axes."""
    attitude = quaternion.normalise(part["attitude"])
    force = np.einsum("nij,nj->ni", quaternion.rotation_matrix(attitude), part["specific_force"])
    acceleration = difference(part["velocity"], part.rate)
    frequency, cross = scipy.signal.csd(acceleration, force, part.rate, nperseg=rows, axis=0)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    powers = [scipy.signal.welch(x, part.rate, nperseg=rows, axis=0)[1][inside] for x in (acceleration, force)]
    shared = np.abs(cross[inside]) ** 2
    share: Floats = shared / np.maximum(powers[0] * powers[1], 1e-30)
    return float(np.median(share))
