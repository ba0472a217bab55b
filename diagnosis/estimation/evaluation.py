"""Residuals of a model on flights: channel by channel, over the noise floor, and as reduced chi-square."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.models.command_effects import own_gains
from diagnosis.models.prediction import Prediction
from diagnosis.models.predictor import Predictor
from diagnosis.selection.noise import NoiseModel, noise_floor, sensor_floor
from diagnosis.selection.regression import Regression
from diagnosis.selection.sensor_errors import SensorErrors
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


def residuals(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    noise: NoiseModel | None = None,
    thresholds: Thresholds = DEFAULT,
    errors: SensorErrors | None = None,
) -> list[Floats]:
    """(m, 12) measured less modelled of each segment.

    noise: by which each segment's own sensor errors, within specification, are estimated and removed; None: not.
    errors: of the sensors, to be computed once; by default those under this vehicle's model.
    """
    if noise is not None and errors is None:
        errors = SensorErrors(vehicle, catalogue, segments, thresholds)
    measured = segments[0].rotor_source == "measured"
    own = own_gains(vehicle, thresholds.command_curve)
    predictor = Predictor(
        vehicle, vehicle.effects, catalogue, list(own), speed_measured=measured, thresholds=thresholds.prediction
    )
    results = []
    for segment in segments:
        prediction = predictor.predict(segment)
        rows = channels.residual(segment, prediction)
        if noise is not None and errors is not None:
            gains = predictor.slopes(segment) if own else []
            rows = _without_biases(segment, errors, gains, list(own.values()), rows, noise, thresholds)
        results.append(rows)
    return results


def _without_biases(
    segment: Segment,
    errors: SensorErrors,
    gains: Sequence[Prediction],
    deviations: Sequence[float],
    rows: Floats,
    noise: NoiseModel,
    thresholds: Thresholds,
) -> Floats:
    """Rows less the errors of healthy sensors and, of commands, the flight's own gains, as far as specification allows.

    gains: slopes of the prediction in the gains of commands of which every flight has its own. deviations: of these.
    """
    columns, deviation = errors.columns(segment), errors.deviation
    if gains:
        columns = np.concatenate([columns, channels.predicted(segment, gains)], axis=2)
        deviation = np.append(deviation, deviations)
    if not len(deviation):
        return rows
    white = noise.whiten(columns).reshape(-1, columns.shape[2])
    off = np.linalg.solve(white.T @ white + np.diag(deviation**-2), white.T @ noise.whiten(rows).ravel())
    limit = thresholds.regression.max_bias * deviation
    off = np.clip(off, -limit, limit)
    return np.asarray(rows - columns @ off)


def residuals_in(regression: Regression, vehicle: Vehicle, segments: Sequence[Segment]) -> list[Floats]:
    """(m, 12) of each segment under a vehicle's model, without sensor errors that a regression's noise allows."""
    errors = regression.sensor_errors
    return residuals(vehicle, regression.catalogue, segments, regression.noise, regression.thresholds, errors)


def reduced_chi_square(rows: Sequence[Floats], noise: NoiseModel) -> float:
    """Mean squared whitened residual: 1 for a model that explains everything but the sensors' noise."""
    white = [noise.whiten(r) for r in rows]
    return float(sum(np.sum(w**2) for w in white) / sum(w.size for w in white))


def saturated_floor(regression: Regression, segments: Sequence[Segment]) -> Floats:
    """(12,) floor of the residuals of segments after all columns of the catalogue at once."""
    return residual_floor(regression, [regression.saturated_residual(segment) for segment in segments])


def residual_floor(regression: Regression, rows: Sequence[Floats]) -> Floats:
    """(12,) noise floor of residuals (m, 12) of segments."""
    thresholds = regression.thresholds.noise
    return noise_floor(rows, regression.rate, regression.noise.active, thresholds, pose=regression.pose)


def sensors_floor(regression: Regression, vehicle: Vehicle, segments: Sequence[Segment], floor: Floats) -> Floats:
    """(12,) the sensors' own noise in the residuals of segments under a vehicle's model, at most their floor (12,).

    It is heard above the filters' cutoff, where no motion reaches; the rest of the floor is a fast remainder, such as
    the rotors' turbulence.
    """
    return np.minimum(floor, _heard(vehicle, regression.catalogue, segments, regression.thresholds))


def _heard(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment], thresholds: Thresholds
) -> Floats:
    predictor = _predictor(vehicle, catalogue, segments[0], thresholds)
    rows = [channels.unfiltered(s, predictor.predict(s)) for s in segments]
    return sensor_floor(rows, segments[0].rate, segments[0].filters, thresholds.noise)


def _predictor(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], example: Segment, thresholds: Thresholds
) -> Predictor:
    measured = example.rotor_source == "measured"
    return Predictor(vehicle, vehicle.effects, catalogue, speed_measured=measured, thresholds=thresholds.prediction)


def floor_norms(floor: Floats) -> dict[str, float]:
    """Noise floor of each kind from a floor (12,): norm over its three axes, 0 where the kind is absent."""
    return dict(zip(channels.KINDS, np.sqrt(channels.squared_by_kind(floor)).tolist(), strict=True))
