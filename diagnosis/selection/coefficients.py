"""Which coefficients of a candidate's columns are physically possible."""

from __future__ import annotations

import numpy as np

from diagnosis.selection.candidates import Candidate
from diagnosis.thresholds import DEFAULT, SearchThresholds
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle


def coefficient_bounds(
    candidate: Candidate, vehicle: Vehicle, thresholds: SearchThresholds = DEFAULT.search
) -> tuple[list[float], list[float]]:
    """Least and greatest possible coefficients of a candidate's columns, with a slack for noise."""
    if candidate.fixed_shape:
        low, high = _amplitudes(candidate, thresholds)
        return [low], [high]
    parameters = {p.name: p for p in candidate.effect.parameters}
    free = [(parameters[name], candidate.at[name]) for name in candidate.free]
    slack = [thresholds.bound_slack * p.prior(vehicle).std for p, _ in free]
    return (
        [p.lower - off - at for (p, at), off in zip(free, slack, strict=True)],
        [p.upper + off - at for (p, at), off in zip(free, slack, strict=True)],
    )


def _amplitudes(candidate: Candidate, thresholds: SearchThresholds) -> tuple[float, float]:
    """Least and greatest coefficient of a fixed shape, with all parameters within their bounds."""
    low, high = thresholds.amplitude
    if candidate.present is not None:  # a correction may be small
        low = 0.0
    sizes = candidate.sizes
    low = max(low, candidate.effect.min_detectable / abs(next(iter(sizes.values()))))
    for parameter in candidate.effect.parameters:
        size = sizes[parameter.name]
        if size:
            start = candidate.at[parameter.name] - size
            ends = sorted([(parameter.lower - start) / size, (parameter.upper - start) / size])
            low, high = max(low, ends[0]), min(high, ends[1])
    return low, high


def possible(
    candidate: Candidate, theta: Floats, vehicle: Vehicle, thresholds: SearchThresholds = DEFAULT.search
) -> bool:
    """Whether coefficients lie within the physical bounds of their parameters."""
    low, high = coefficient_bounds(candidate, vehicle, thresholds)
    return bool(np.all((theta >= low) & (theta <= high)))
