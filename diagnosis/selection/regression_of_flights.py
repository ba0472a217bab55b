"""A regression made of flights: design, noise, normal equations; and made again about a fit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.filters import slow
from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.models.command_effects import (
    COMMAND_EFFECTS,
    flight_deviations,
    prior_deviation,
    with_command_effects,
)
from diagnosis.models.pose_errors import PoseErrors, pose_errors
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.design_matrix import DesignMatrix, evaluate_design
from diagnosis.selection.errors_in_variables import design_errors, gyro_noise_of_its_own, noisier_segments
from diagnosis.selection.noise import NoiseModel, estimate_noise
from diagnosis.selection.regression import FlightEquations, Regression, marginals, unzipped
from diagnosis.selection.sensor_errors import Biases, sensor_biases
from diagnosis.thresholds import DEFAULT, CommandCurveThresholds, Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle

AddedErrors = tuple[
    Floats, NDArray[np.floating]
]  # (m, 12) and (m, 12, k) of a segment's rows and columns by added noise
Whitened = tuple[Floats, Floats, Floats, Floats]  # columns (m, c, k), rows (m, c), and their errors by sensors' noise


def make_regression(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    flight_of: Sequence[int],
    thresholds: Thresholds = DEFAULT,
) -> Regression:
    """The regression of all candidates over segments of flights numbered from 0."""
    vehicle, catalogue = with_command_effects(vehicle, catalogue, segments)
    evaluated = evaluate_design(vehicle, catalogue, segments, thresholds.prediction)
    design, rows, columns = evaluated.matrix, evaluated.rows, evaluated.columns
    candidates = tuple(c for c in evaluated.candidates if c.effect.name not in COMMAND_EFFECTS)
    nuisances = tuple(c for c in evaluated.candidates if c.effect.name in COMMAND_EFFECTS)
    noisier = noisier_segments(segments, thresholds)
    errors = [(y, x.astype(np.float32)) for y, x in design_errors(noisier, design, rows, columns)]
    pose = pose_errors(segments, design.present, thresholds.pose)
    noise, everything = _noise(segments, rows, columns, errors, pose, _is_lagged(design), thresholds)
    equations = _equations(flight_of, noise, rows, columns, errors)
    observations = [0] * len(equations)
    for flight, y in zip(flight_of, rows, strict=True):
        observations[flight] += (len(y) - noise.order) * len(noise.active)
    biases = flight_biases(candidates, nuisances, thresholds.command_curve)
    return Regression(
        vehicle=vehicle,
        catalogue=catalogue,
        segments=segments,
        flight_of=flight_of,
        candidates=candidates,
        noise=noise,
        rows=rows,
        columns=columns,
        **_marginalised(equations, biases),
        observations=observations,
        rate=segments[0].decimated_rate,
        biases=biases,
        design=design,
        everything=everything,
        saturated=dict(zip([s.digest for s in segments], _residuals(rows, columns, everything), strict=True)),
        equations=equations,
        pose=pose,
        errors=errors,
        noisier=noisier,
        thresholds=thresholds,
        not_followed=evaluated.not_followed,
        nuisances=nuisances,
        shared=shared_unknowns(nuisances, thresholds.command_curve),
    )


def about_fit(
    regression: Regression, candidates: tuple[Candidate, ...], nuisances: tuple[Candidate, ...]
) -> Regression | None:
    """The regression about a fit of some candidates, which hold its values; None where that cannot be followed.

    Made again are the rows and the columns of what the fit holds, of air and of what shares a model with them, and the
    errors of both. Other columns change by as little as those effects change the vehicle.
    """
    r, thresholds = regression, regression.thresholds
    design = DesignMatrix(r.vehicle, r.catalogue, (*candidates, *nuisances), r.segments[0], thresholds.prediction)
    again = [design.again(segment, columns) for segment, columns in zip(r.segments, r.columns, strict=True)]
    rows, columns = unzipped(again)
    if not all(np.isfinite(y).all() and np.isfinite(x).all() for y, x in again):
        return None
    errors = []
    for segment, y, x, (_, x_error) in zip(r.noisier, rows, columns, r.errors, strict=True):
        noisier_y, noisier_x = design.again(segment, x + x_error)
        errors.append((noisier_y - y, (noisier_x - x).astype(np.float32)))
    pose = pose_errors(r.segments, design.present, thresholds.pose)
    noise, _ = _noise(r.segments, rows, columns, errors, pose, _is_lagged(design), thresholds)
    equations = _equations(r.flight_of, noise, rows, columns, errors)
    biases = flight_biases(candidates, nuisances, thresholds.command_curve)
    return replace(
        r,
        candidates=candidates,
        nuisances=nuisances,
        noise=noise,
        pose=pose,
        rows=rows,
        columns=columns,
        errors=errors,
        **_marginalised(equations, biases),
        biases=biases,
        shared=shared_unknowns(nuisances, thresholds.command_curve),
        equations=equations,
    )


def _marginalised(equations: Sequence[FlightEquations], biases: Biases) -> dict[str, Any]:
    """The fields of a regression with its normal equations."""
    joint_gram, joint_product = [one.gram for one in equations], [one.product for one in equations]
    gram, product = marginals(joint_gram, joint_product, biases)
    plain = [one.plain_gram for one in equations], [one.plain_product for one in equations]
    plain_gram, plain_product = marginals(*plain, biases)
    return {
        "gram": gram,
        "product": product,
        "plain_gram": plain_gram,
        "plain_product": plain_product,
        "joint_gram": joint_gram,
        "joint_product": joint_product,
    }


def _equations(
    flight_of: Sequence[int],
    noise: NoiseModel,
    rows: Sequence[Floats],
    columns: Sequence[Floats],
    errors: Iterable[AddedErrors],
) -> list[FlightEquations]:
    """The normal equations of each flight. errors: of rows (m, 12) and columns (m, 12, k), a segment each."""
    flights: list[list[Whitened]] = [[] for _ in range(max(flight_of) + 1)]
    for flight, y, x, (y_error, x_error) in zip(flight_of, rows, columns, errors, strict=True):
        white_errors = noise.whiten(np.asarray(x_error, dtype=float)), noise.whiten(y_error)
        flights[flight].append((noise.whiten(x), noise.whiten(y), *white_errors))
    return [flight_equations(parts) for parts in flights]


def flight_equations(segments: Sequence[Whitened]) -> FlightEquations:
    """The normal equations of one flight."""
    width = segments[0][0].shape[2]
    gram, correction = np.zeros((width, width)), np.zeros((width, width))
    product, product_correction = np.zeros(width), np.zeros(width)
    for columns, rows, column_errors, row_errors in segments:
        x, y, x_error, y_error = columns.reshape(-1, width), rows.ravel(), column_errors.reshape(-1, width), row_errors
        gram += x.T @ x
        product += x.T @ y
        correction += x_error.T @ x_error
        product_correction += x_error.T @ y_error.ravel()
    return FlightEquations(gram - correction, product - product_correction, gram, product)


def _noise(
    segments: Sequence[Segment],
    rows: Sequence[Floats],
    columns: Sequence[Floats],
    errors: Sequence[AddedErrors],
    pose: PoseErrors,
    lagged: bool,
    thresholds: Thresholds,
) -> tuple[NoiseModel, Floats]:
    """The noise, from the residuals after all columns at once, and the coefficients (k,) of these.

    lagged: whether the present model has the rotors' lag, of which slow motion says nothing.
    """
    kinds = np.all([channels.present(s) for s in segments], axis=0)
    active = [channel for channel in range(channels.CHANNELS) if kinds[channel // channels.AXES]]
    scale = np.sqrt(np.mean(np.vstack(rows)[:, active] ** 2, axis=0)) + 1e-12
    shared = _shared_noise(segments, errors, active, scale, thresholds)
    everything = _everything(rows, columns, active, scale, shared, thresholds.regression.ridge)
    residuals = _residuals(rows, columns, everything)
    answered = lagged and pose.there and segments[0].rotor_source == "command"
    beyond = _beyond_feedback(segments, rows, columns, active, scale, thresholds) if answered else ()
    # with commands alone the rotors' errors are in all channels, so correlation between channels is not sensor noise
    mixed = segments[0].rotor_source != "command"
    noise = estimate_noise(
        residuals,
        segments[0].decimated_rate,
        active,
        mixed=mixed,
        pose=pose,
        beyond_feedback=beyond,
        thresholds=thresholds.noise,
    )
    return noise, everything


def _is_lagged(design: DesignMatrix) -> bool:
    """Whether the rotors' speeds are hidden states of the present model."""
    return bool(design.present.model.rotor_speed_places)


def _residuals(rows: Sequence[Floats], columns: Sequence[Floats], theta: Floats) -> list[Floats]:
    return [y - x @ theta for y, x in zip(rows, columns, strict=True)]


def _beyond_feedback(
    segments: Sequence[Segment],
    rows: Sequence[Floats],
    columns: Sequence[Floats],
    active: Sequence[int],
    scale: Floats,
    thresholds: Thresholds,
) -> list[Floats]:
    """Residuals (m, 12) after a ridge regression on all columns of slow motion alone.

    The controller answers turbulence, and columns of its commands, of several lags behind them, explain a torque of
    turbulence by that answer: of its power near 1 Hz they leave a quarter to a thirtieth. Slow motion has little.
    """

    def slow_motion(values: Sequence[Floats]) -> list[Floats]:
        cutoff = segments[0].filters.command_cutoff
        return [slow(x, s.decimated_rate, cutoff) for s, x in zip(segments, values, strict=True)]

    ridge, none = thresholds.regression.slow_ridge, np.zeros(columns[0].shape[2])
    theta = _everything(slow_motion(rows), slow_motion(columns), active, scale, none, ridge)
    return _residuals(rows, columns, theta)


def _everything(
    rows: Sequence[Floats],
    columns: Sequence[Floats],
    active: Sequence[int],
    scale: Floats,
    shared: Floats,
    ridge: float,
) -> Floats:
    """(k,) coefficients of a ridge regression on all columns, whose residuals are mostly noise.

    scale: (c,) of the active channels. shared: (k,) of the columns' products with the rows, what is noise of both.
    """
    some = list(active)
    x = np.vstack([(c[:, some] / scale[:, None]).reshape(-1, c.shape[2]) for c in columns])
    y = np.concatenate([(r[:, some] / scale).ravel() for r in rows])
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-12
    x = x / size
    product = x.T @ y - shared / size
    return np.asarray(np.linalg.solve(x.T @ x + ridge * len(y) * np.eye(x.shape[1]), product) / size)


def _shared_noise(
    segments: Sequence[Segment],
    errors: Sequence[AddedErrors],
    active: Sequence[int],
    scale: Floats,
    thresholds: Thresholds,
) -> Floats:
    """(k,) products of the gyro's noise in the attitude's rate and in the columns, over the channels' squared scale.

    That channel is the gyro's reading less the attitude's derivative, and columns of its scale and of delays are made
    of the same reading: its noise would explain itself, and what is left would seem too precise where it is densest.
    """
    total = np.zeros(errors[0][1].shape[2])
    if (own := gyro_noise_of_its_own(segments, thresholds.noise)) is None:
        return total
    axes = [i for i in range(channels.ATTITUDE_RATE.start, channels.ATTITUDE_RATE.stop) if i in active]
    weight = own / np.array([scale[list(active).index(i)] for i in axes]) ** 2
    for y, x in errors:
        total += np.einsum("mck,mc,c->k", x[:, axes], y[:, axes], weight)
    return total


def flight_biases(
    candidates: Sequence[Candidate], nuisances: Sequence[Candidate], thresholds: CommandCurveThresholds
) -> Biases:
    """Each flight's own sensor errors, and its own deviations from the gains that all flights' commands share."""
    sensors, own = sensor_biases(candidates), flight_deviations(thresholds)
    gains = [(column, own[c.effect.name]) for c in nuisances if c.effect.name in own for column in c.columns]
    information = np.array([deviation**-2 for _, deviation in gains])
    columns = (*sensors.columns, *(column for column, _ in gains))
    return Biases(columns, np.concatenate([sensors.information, information]))


def shared_unknowns(nuisances: Sequence[Candidate], thresholds: CommandCurveThresholds) -> Biases:
    """The gain, the motors' gains and the curve's bend, about their neutral values."""
    columns = [column for c in nuisances for column in c.columns]
    deviations = [prior_deviation(c.effect, thresholds) for c in nuisances]
    expected = [c.effect.parameters[0].neutral - c.at[c.effect.parameters[0].name] for c in nuisances]
    return Biases(tuple(columns), np.array(deviations) ** -2.0, np.array(expected))
