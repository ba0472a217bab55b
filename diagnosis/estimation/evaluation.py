"""How far a model is from flights, channel by channel, against the sensors' noise floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.models.prediction import Prediction, Predictor
from diagnosis.selection.noise import NoiseModel, noise_floor
from diagnosis.selection.regression import Regression
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects.gyro_bias import SENSOR_PRIOR as GYRO_BIAS
from dynamics.effects.imu_bias import SENSOR_PRIOR as ACCELEROMETER_BIAS
from dynamics.effects.time_delay import SENSOR_PRIOR as CLOCK_OFFSET
from dynamics.vehicle import Vehicle

WINDOW = 2.0  # s
SPECIFIED_AT_MOST = 2.5  # standard deviations of a sensor's bias; what is beyond is a fault


def residuals(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment], noise: NoiseModel | None = None
) -> list[Floats]:
    """(m, 12) of each segment: what was measured less what the vehicle's model says.

    noise: take out what the sensors are off by in each segment, as far as they are specified to be; None for nothing.
    """
    measured = segments[0].rotor_source == "measured"
    predictor = Predictor(vehicle, vehicle.effects, catalogue, speed_measured=measured)
    found = []
    for segment in segments:
        said = predictor.predict(segment)
        rows = channels.residual(segment, said)
        found.append(rows if noise is None else _without_biases(segment, said, rows, noise))
    return found


def _without_biases(segment: Segment, said: Prediction, rows: Floats, noise: NoiseModel) -> Floats:
    count = len(rows)
    columns = np.zeros((count, channels.CHANNELS, 7))
    for axis in range(3):
        columns[:, axis, axis] = 1.0
        columns[:, 9 + axis, 3 + axis] = -1.0
    later = replace(said, pose_age=said.pose_age + CLOCK_OFFSET)
    both = channels.predicted(segment, [said, later])
    columns[:, :, 6] = (both[:, :, 1] - both[:, :, 0]) / CLOCK_OFFSET
    deviation = np.array([ACCELEROMETER_BIAS] * 3 + [GYRO_BIAS] * 3 + [CLOCK_OFFSET])
    white = noise.whiten(columns).reshape(-1, 7)
    off = np.linalg.solve(white.T @ white + np.diag(deviation**-2), white.T @ noise.whiten(rows).ravel())
    off = np.clip(off, -SPECIFIED_AT_MOST * deviation, SPECIFIED_AT_MOST * deviation)
    return np.asarray(rows - columns @ off)


def misfit(rows: Sequence[Floats], noise: NoiseModel) -> float:
    """Mean squared whitened residual: 1 for a model that explains everything but the sensors' noise."""
    white = [noise.whiten(r) for r in rows]
    return float(sum(np.sum(w**2) for w in white) / sum(w.size for w in white))


def typical_misfit(rows: Sequence[Floats], noise: NoiseModel, rate: float) -> float:
    """The same of a typical window of 2 s (geometric mean), which a few seconds of chaos do not spoil."""
    length = max(1, round(WINDOW * rate))
    squares = [np.mean(noise.whiten(r) ** 2, axis=1) for r in rows]
    means = [np.mean(s[i : i + length]) for s in squares for i in range(0, max(1, len(s) - length // 2), length)]
    return float(np.exp(np.mean(np.log(means))))


def held_out_floor(regression: Regression, segments: Sequence[Segment], after: Sequence[Floats]) -> Floats:
    """(12,) noise floor of segments that were not fitted; after: (m, 12) what the fitted model leaves of them.

    Turbulence of the rotors grows with their thrust, so that other flights have another floor. It is what all that the
    catalogue knows leaves, or less where the fitted model leaves less, and never redder than sensors are.
    """
    made = [regression.pipeline.run(segment) for segment in segments]
    left = [y - x @ regression.everything for y, x in made]
    active = regression.noise.active
    return np.minimum(noise_floor(left, regression.rate, active), noise_floor(after, regression.rate, active))


def floors(noise: NoiseModel) -> dict[str, float]:
    """Noise floor of each kind: norm over its three axes, 0 where the kind is absent."""
    return floor_norms(noise.floor)


def floor_norms(floor: Floats) -> dict[str, float]:
    """The same of a floor (12,)."""
    return {kind: float(np.sqrt(np.sum(floor[3 * i : 3 * i + 3] ** 2))) for i, kind in enumerate(channels.KINDS)}
