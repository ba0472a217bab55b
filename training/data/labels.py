"""Labels and inputs of a flight: accelerations to learn, and the causal inputs to learn them from.

Labels depend on later rows, inputs never do. `paper_table` is the exception: it filters inputs with their future as the
paper does, for a comparison with the paper's figures only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from flights import filters
from flights.flight import Flight
from training.data import kalman

HORIZON = 0.010  # s, of the increment label
VELOCITY_CUTOFF = 5.0  # Hz
RATE_CUTOFF = 12.0  # Hz

Differentiator = Callable[[Floats, float, float], Floats]


@dataclass(frozen=True, eq=False)
class Samples:
    """Rows to learn from.

    time: (n,) s.
    state: (n, 13), zeros for a position that the flight does not have.
    rotor_speed: (n, rotors) rad/s.
    label: (n, 6) linear acceleration (world, m/s^2) and angular acceleration (body, rad/s^2); NaN where there is none.
    """

    time: Floats
    state: Floats
    rotor_speed: Floats
    label: Floats


def paper_label(
    segment: Flight, *, cutoff: float = filters.PAPER_CUTOFF, differentiate: Differentiator = kalman.rts_acceleration
) -> Floats:
    """Accelerations (n, 6) from velocity and body rates at a cutoff (Hz), PI-TCN section IV-A.

    differentiate: by default the RTS smoother, which errs less than the paper's UKF; pass `kalman.ukf_acceleration`
    for the paper's own. Raises DataError when velocity or rates are missing.
    """
    motion = np.hstack([segment["velocity"], segment["rate"]])
    return differentiate(motion, segment.rate, cutoff)


def increment_label(
    segment: Flight,
    *,
    horizon: float = HORIZON,
    velocity_cutoff: float = VELOCITY_CUTOFF,
    rate_cutoff: float = RATE_CUTOFF,
) -> Floats:
    """Mean accelerations (n, 6) over the next `horizon` seconds, from zero-phase filtered velocity and rates.

    It is what a controller that holds its input for that long needs to predict. The last rows are NaN. Raises
    DataError when velocity or rates are missing.
    """
    velocity = filters.lowpass(segment["velocity"], segment.rate, velocity_cutoff)
    rate = filters.lowpass(segment["rate"], segment.rate, rate_cutoff)
    return mean_increment(np.hstack([velocity, rate]), segment.rate, horizon)


def as_labelled(world: Floats, rate: float, *, paper: bool = False) -> Floats:
    """A model's accelerations (n, 6) after the filters that the labels of the same rows have.

    world: linear acceleration (world, m/s^2), angular acceleration (body, rad/s^2). rate: Hz. paper: `paper_label`'s
    cutoff instead of `increment_label`'s.
    """
    linear, angular = (filters.PAPER_CUTOFF,) * 2 if paper else (VELOCITY_CUTOFF, RATE_CUTOFF)
    return np.hstack([filters.lowpass(world[:, :3], rate, linear), filters.lowpass(world[:, 3:], rate, angular)])


def mean_increment(values: Floats, rate: float, horizon: float = HORIZON) -> Floats:
    """(x(t + horizon) - x(t)) / horizon, linear between samples; NaN at the end. values: (n, k). rate: Hz."""
    rows = horizon * rate
    full = int(np.floor(rows + 1e-9))
    fraction = max(rows - full, 0.0)
    result = np.full_like(values, np.nan)
    count = len(values) - full - (1 if fraction > 1e-9 else 0)
    if count <= 0:
        return result
    later = values[full : full + count]
    if fraction > 1e-9:
        later = later + fraction * (values[full + 1 : full + 1 + count] - later)
    result[:count] = (later - values[:count]) / horizon
    return result


def samples(segment: Flight, *, horizon: float = HORIZON) -> Samples:
    """Causal inputs, exactly as they were logged, with increment labels. Raises DataError for what is missing."""
    state = np.hstack([_position(segment), segment["velocity"], segment["attitude"], segment["rate"]])
    return Samples(segment.time, state, segment["rotor_speed"], increment_label(segment, horizon=horizon))


def paper_table(segment: Flight, *, cutoff: float = filters.PAPER_CUTOFF) -> Samples:
    """The paper's processing: inputs and labels all filtered both ways at 5 Hz, PI-TCN section IV-A.

    The inputs depend on about 0.1 s of the future: numbers from them can be compared with the paper's, and mean
    little for the response to the motors. Raises DataError for what is missing.
    """
    attitude = filters.lowpass(quaternion.continuous(segment["attitude"]), segment.rate, cutoff)
    velocity, rate = (filters.lowpass(segment[name], segment.rate, cutoff) for name in ("velocity", "rate"))
    state = np.hstack([_position(segment), velocity, quaternion.normalise(attitude), rate])
    rotor_speed = filters.lowpass(segment["rotor_speed"], segment.rate, cutoff)
    return Samples(segment.time, state, rotor_speed, paper_label(segment, cutoff=cutoff))


def _position(segment: Flight) -> Floats:
    return segment["position"] if segment.has("position") else np.zeros((len(segment), 3))
