"""Residuals of a model on flights: channel by channel, over the noise floor, and as reduced chi-square."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.estimation.channel_noise import ChannelNoise
from diagnosis.models import channels
from diagnosis.models.command_effects import own_gains
from diagnosis.models.prediction import Prediction
from diagnosis.models.predictor import Predictor
from diagnosis.thresholds import DEFAULT, PredictionThresholds, Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle


def residuals(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    noise: ChannelNoise | None = None,
    thresholds: Thresholds = DEFAULT,
) -> list[Floats]:
    """(m, 12) measured less modelled of each segment.

    noise: by which each segment's own sensor errors, within specification, are estimated and removed; None: not.
    """
    measured = segments[0].rotor_source == "measured"
    own = own_gains(vehicle, thresholds.command_curve)
    predictor = Predictor(
        vehicle, vehicle.effects, catalogue, list(own), speed_measured=measured, thresholds=thresholds.prediction
    )
    results = []
    for segment in segments:
        rows = channels.residual(segment, predictor.predict(segment))
        if noise is not None:
            gains = predictor.slopes(segment) if own else []
            rows = _without_biases(segment, gains, list(own.values()), rows, noise)
        results.append(rows)
    return results


def _without_biases(
    segment: Segment, gains: Sequence[Prediction], deviations: Sequence[float], rows: Floats, noise: ChannelNoise
) -> Floats:
    """Rows less the errors of healthy sensors and, of commands, the flight's own gains, as far as specification allows.

    gains: slopes of the prediction in the gains of commands of which every flight has its own. deviations: of these.
    """
    columns, deviation = noise.sensor_errors.columns(segment), noise.sensor_errors.deviation
    if gains:
        columns = np.concatenate([columns, channels.predicted(segment, gains)], axis=2)
        deviation = np.append(deviation, deviations)
    if not len(deviation):
        return rows
    variance = noise.variances()
    here = variance > 0
    root = np.sqrt(variance[here])
    white, left = (columns[:, here] / root[:, None]).reshape(-1, columns.shape[2]), (rows[:, here] / root).ravel()
    off = np.linalg.solve(white.T @ white + np.diag(deviation**-2), white.T @ left)
    limit = noise.thresholds.relevance.max_bias * deviation
    return np.asarray(rows - columns @ np.clip(off, -limit, limit))


def residuals_in(noise: ChannelNoise, vehicle: Vehicle, segments: Sequence[Segment]) -> list[Floats]:
    """(m, 12) of each segment under a vehicle's model, without sensor errors that the noise allows."""
    return residuals(vehicle, noise.catalogue, segments, noise, noise.thresholds)


def reduced_chi_square(rows: Sequence[Floats], floor: Floats) -> float:
    """Mean square of residuals (m, 12) over their floor (12,): 1 where they are noise."""
    here = floor > 0
    return float(np.mean((np.vstack(rows)[:, here] / floor[here]) ** 2))


def require_followed(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment], thresholds: PredictionThresholds
) -> None:
    """Raise DataError where the vehicle's own model cannot be followed along some segments."""
    measured = segments[0].rotor_source == "measured"
    predictor = Predictor(vehicle, vehicle.effects, catalogue, speed_measured=measured, thresholds=thresholds)
    if all(np.isfinite(predictor.states(segment)).all() for segment in segments):
        return
    hidden = ", ".join(use.name for use in vehicle.effects if catalogue[use.name].hidden) or "its effects"
    raise DataError(
        f"the vehicle file's model has no finite prediction along these flights of {segments[0].rate:.0f} Hz. "
        f"Check the values of {hidden}, or log faster."
    )


def floor_norms(floor: Floats) -> dict[str, float]:
    """Noise floor of each kind from a floor (12,): norm over its three axes, 0 where the kind is absent."""
    return dict(zip(channels.KINDS, np.sqrt(channels.squared_by_kind(floor)).tolist(), strict=True))
