"""Open-loop prediction errors: the model runs from a measured state without later measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models.predictor import Predictor
from diagnosis.models.rollout import Simulator, healthy
from diagnosis.thresholds import DEFAULT, PredictionThresholds
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY
from dynamics.vehicle import Vehicle


class HorizonError(msgspec.Struct, frozen=True):
    """RMS error after a horizon (s) of open loop: position m, velocity m/s, attitude rad, rate rad/s.

    The position's is NaN, null in JSON, where none was logged.
    """

    horizon: float
    position: float
    velocity: float
    attitude: float
    rate: float

    @property
    def figures(self) -> list[str]:
        """Position, velocity, attitude and rate in three digits, a dash for what was not logged."""
        values = (self.position, self.velocity, self.attitude, self.rate)
        return ["-" if np.isnan(value) else f"{value:.3g}" for value in values]


OPEN_LOOP_QUANTITIES = ("position", "velocity", "attitude", "rate")


def open_loop_errors(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    thresholds: PredictionThresholds = DEFAULT.prediction,
) -> tuple[HorizonError, ...]:
    """Prediction errors of a vehicle's model over each horizon, from starts all along the segments.

    Empty where the segments hold no pose to start from.
    """
    windows = open_loop_windows(vehicle, catalogue, segments, thresholds)
    return tuple(horizon_error(horizon, np.vstack(parts)) for horizon, parts in windows.items())


def open_loop_windows(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    thresholds: PredictionThresholds = DEFAULT.prediction,
) -> dict[float, list[Floats]]:
    """(W, 12) errors of the windows of each segment, by horizon; empty where the segments hold no pose.

    Errors of a position that was not logged are NaN.
    """
    if not all(s.has_pose for s in segments):
        return {}
    rate, measured = segments[0].rate, segments[0].rotor_source == "measured"
    vehicle, segments = healthy(vehicle, catalogue, segments)
    predictor = Predictor(vehicle, vehicle.effects, catalogue, speed_measured=measured, thresholds=thresholds)
    simulator = Simulator(predictor, rate, speed_measured=measured)
    last, interval = round(max(thresholds.horizons) * rate), max(1, round(thresholds.start_interval * rate))
    errors: dict[float, list[Floats]] = {horizon: [] for horizon in thresholds.horizons}
    with_position = not any("position" in s.lacks for s in segments)
    starts = [(s, range(0, len(s) - last, interval)) for s in segments]
    for segment, windows in zip(segments, simulator.run(starts, last, predictor.values()), strict=True):
        for horizon, parts in errors.items():
            step = round(horizon * rate)
            error = state_error(windows.states[:, step], segment.smooth[windows.rows[:, step]])
            if not with_position:
                error[:, POSITION] = np.nan
            parts.append(error)
    return errors


def motion_over_horizons(
    segments: Sequence[Segment], thresholds: PredictionThresholds = DEFAULT.prediction
) -> dict[float, Floats]:
    """(4,) RMS change of position, velocity, attitude and rate over each horizon."""
    motion: dict[float, Floats] = {}
    for horizon in thresholds.horizons:
        pairs = [(s.smooth[step:], s.smooth[:-step]) for s in segments if len(s) > (step := round(horizon * s.rate))]
        moved = np.vstack([state_error(later, earlier) for later, earlier in pairs]) if pairs else np.zeros((1, 12))
        motion[horizon] = np.sqrt(np.mean(np.sum(moved.reshape(-1, 4, 3) ** 2, axis=2), axis=0))
    return motion


def state_error(predicted: Floats, measured: Floats) -> Floats:
    """(n, 12) errors of position, velocity, attitude as a rotation vector, and rate, from states (n, 13 or more)."""
    rotation = quaternion.multiply(quaternion.conjugate(measured[:, ATTITUDE]), predicted[:, ATTITUDE])
    rotation = np.where(rotation[:, :1] < 0, -rotation, rotation)
    position, velocity, rate = (predicted[:, part] - measured[:, part] for part in (POSITION, VELOCITY, RATE))
    return np.hstack([position, velocity, quaternion.logarithm(rotation), rate])


def horizon_error(horizon: float, errors: Floats) -> HorizonError:
    """RMS over the rows of `state_error`."""
    norms = [float(np.sqrt(np.mean(np.sum(errors[:, 3 * i : 3 * i + 3] ** 2, axis=1)))) for i in range(4)]
    return HorizonError(horizon, *norms)
