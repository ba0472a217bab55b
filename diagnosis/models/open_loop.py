"""Multi-step prediction: the model runs from a measured state; one right at one step can be wrong at fifty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models.prediction import Predictor
from diagnosis.models.rollout import Simulator, healthy
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle

HORIZONS = (0.1, 0.5, 1.0)  # s
EVERY = 0.5  # s between starts


class HorizonError(msgspec.Struct, frozen=True):
    """RMS error after a horizon (s) of open loop: position m, velocity m/s, attitude rad, rate rad/s."""

    horizon: float
    position: float
    velocity: float
    attitude: float
    rate: float


def open_loop_errors(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment]
) -> tuple[HorizonError, ...]:
    """Prediction errors of a vehicle's model over 0.1, 0.5 and 1 s, from starts all along the segments.

    None where the segments hold no pose to start from.
    """
    if not all(s.has_pose for s in segments):
        return ()
    rate, measured = segments[0].rate, segments[0].rotor_source == "measured"
    vehicle, segments = healthy(vehicle, catalogue, segments)
    predictor = Predictor(vehicle, vehicle.effects, catalogue, speed_measured=measured)
    simulator = Simulator(predictor, rate, speed_measured=measured)
    found: dict[float, list[Floats]] = {horizon: [] for horizon in HORIZONS}
    for segment in segments:
        starts = np.arange(0, len(segment) - round(HORIZONS[-1] * rate), max(1, round(EVERY * rate)))
        windows = simulator.run(segment, starts.tolist(), round(HORIZONS[-1] * rate), predictor.values())
        for horizon, errors in found.items():
            step = round(horizon * rate)
            errors.append(_difference(windows.states[:, step], segment.smooth[windows.rows[:, step]]))
    return tuple(_summary(horizon, np.vstack(errors)) for horizon, errors in found.items())


def _difference(said: Floats, was: Floats) -> Floats:
    turned = quaternion.multiply(quaternion.conjugate(was[:, 6:10]), said[:, 6:10])
    turned = np.where(turned[:, :1] < 0, -turned, turned)
    attitude = quaternion.logarithm(turned)
    return np.hstack([said[:, :6] - was[:, :6], attitude, said[:, 10:13] - was[:, 10:13]])


def _summary(horizon: float, errors: Floats) -> HorizonError:
    norms = [float(np.sqrt(np.mean(np.sum(errors[:, 3 * i : 3 * i + 3] ** 2, axis=1)))) for i in range(4)]
    return HorizonError(horizon, *norms)
