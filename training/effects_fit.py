"""Named effects fitted to a network's own labels: Gauss-Newton on the model's mean increments over whole flights.

`alula diagnose` finds which effects a vehicle has; here only their values are estimated, on the same rows, rotor speeds
and labels that the network on top of them learns from, so that the network's residual does not contain them.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE, motor_lag
from dynamics.errors import DataError, RequestError
from dynamics.own_effects import catalogue_of
from dynamics.state import ATTITUDE
from dynamics.vehicle import EffectUse, Vehicle
from training.config import ModelConfig
from training.data.labelled_rows import LabelledRows, labelled
from training.physics import RowModel

MAX_ITERATIONS = 6
RELATIVE_STEP = 0.02  # relative step of finite differences
TOLERANCE = 1e-3  # relative change of the parameters that ends the iterations
ROWS = 400_000  # about; whole segments spread over all flights, because few brisk ones determine the inertia
NEGLIGIBLE = 1e-8  # singular values below this share of the largest are noise


@dataclass(frozen=True, eq=False)
class _Problem:
    """A least-squares problem.

    segments: (first row, end) of every segment that is used.
    names: of the parameters, with their bounds (lower, upper) and usual size (scale).
    """

    config: ModelConfig
    model: RowModel
    data: LabelledRows
    segments: tuple[tuple[int, int], ...]
    names: tuple[str, ...]
    lower: Floats
    upper: Floats
    scale: Floats


def fit_effects(
    config: ModelConfig, vehicle: Vehicle, data: LabelledRows, catalogue: Mapping[str, Effect] = CATALOGUE
) -> Vehicle:
    """The vehicle with its effects at the values that fit the labels best, least squares weighted by the residual.

    Raises RequestError when the vehicle has no effect, DataError when no parameter has an influence on these flights.
    """
    if not vehicle.effects:
        raise RequestError(
            f"{vehicle.name} names no effect, so a grey box would be the nominal model. Let `alula diagnose` and "
            "`alula add` find some, or give --effect NAME; res_tcn is the residual on the nominal model."
        )
    problem = _problem(msgspec.structs.replace(config, base="grey_box"), vehicle, data, catalogue)
    model = problem.model.model
    values = np.array([model.parameter_values[model.parameter_index(name)] for name in problem.names])
    for _ in range(MAX_ITERATIONS):
        residual = _residual(problem, values)
        weight = 1 / residual.std(axis=0)
        slopes = np.stack([_slope(problem, values, residual, place) for place in range(len(values))], axis=2)
        matrix = (slopes * weight[None, :, None]).reshape(-1, len(values))
        size = np.linalg.norm(matrix, axis=0)
        if not np.any(size > 0):
            raise DataError(f"none of {', '.join(problem.names)} shows in these flights. Leave the effects out.")
        matrix = matrix / np.where(size > 0, size, 1.0)
        step = np.linalg.lstsq(matrix, (residual * weight).ravel(), rcond=NEGLIGIBLE)[0] / np.where(size > 0, size, 1.0)
        before, values = values, np.clip(values + step, problem.lower, problem.upper)
        if np.all(np.abs(values - before) <= TOLERANCE * problem.scale):
            break
    return _with_values(vehicle, dict(zip(problem.names, values.tolist(), strict=True)))


def with_rotor_lag(
    config: ModelConfig, vehicle: Vehicle, data: LabelledRows, catalogue: Mapping[str, Effect] = CATALOGUE
) -> Vehicle:
    """The vehicle with a lag between commands and rotors: where its file names none, one fitted to the flights.

    The other effects are fitted with it. Unchanged for measured rotor speeds, which have no lag.
    """
    catalogue = catalogue_of(vehicle, catalogue)
    named = any(catalogue[use.name].rotor_speed is not None for use in vehicle.effects)
    if named or config.motors == "measured":
        return vehicle
    return fit_effects(config, named_effects(vehicle, [EffectUse(motor_lag.EFFECT.name)], catalogue), data, catalogue)


def _problem(config: ModelConfig, vehicle: Vehicle, data: LabelledRows, catalogue: Mapping[str, Effect]) -> _Problem:
    model = RowModel(
        vehicle, vehicle.effects, dt=config.dt, label=config.label, motors=config.motors, catalogue=catalogue
    )
    free = [
        (f"{item.key}.{parameter.name}", parameter, item)
        for item in model.model.effects
        for parameter in item.effect.parameters
        if item.effect.moves_vehicle and not item.effect.stochastic
    ]
    scale = [max(abs(item.values[p.name]), abs(p.prior(vehicle).std), 1e-12) for _, p, item in free]
    return _Problem(
        config,
        model,
        data,
        _whole_segments(data),
        tuple(name for name, _, _ in free),
        np.array([p.lower for _, p, _ in free]),
        np.array([p.upper for _, p, _ in free]),
        np.array(scale),
    )


def _whole_segments(data: LabelledRows) -> tuple[tuple[int, int], ...]:
    """Whole segments, every n-th so that there are about ROWS rows."""
    gap = (np.diff(data.time) < 0) | (np.diff(data.flight_of) != 0) | (np.diff(data.time) > 1.5 * _period(data))
    edges = [0, *(np.flatnonzero(gap) + 1).tolist(), len(data.time)]
    segments = list(itertools.pairwise(edges))
    every = max(1, round(len(data.time) / ROWS))
    return tuple(segments[::every])


def _period(data: LabelledRows) -> float:
    return float(np.median(np.diff(data.time)))


def _residual(problem: _Problem, values: Floats) -> Floats:
    """(m, 6) label less model, over all segments, rows without a label left out."""
    p = problem.model.model.parameter_values.copy()
    for name, value in zip(problem.names, values, strict=True):
        p[problem.model.model.parameter_index(name)] = value
    data, residuals = problem.data, []
    for start, stop in problem.segments:
        state = data.state[start:stop]
        predicted = problem.model(state, data.rotor_speed[start:stop], parameters=p).body
        residuals.append(data.label[start:stop] - labelled(problem.config, predicted, state[:, ATTITUDE]))
    rows = np.vstack(residuals)
    return rows[np.isfinite(rows).all(axis=1)]


def _slope(problem: _Problem, values: Floats, residual: Floats, place: int) -> Floats:
    """(m, 6) change of the model by one parameter."""
    step = RELATIVE_STEP * problem.scale[place]
    if values[place] + step > problem.upper[place]:
        step = -step
    moved = values.copy()
    moved[place] += step
    return np.asarray((residual - _residual(problem, moved)) / step)


def _with_values(vehicle: Vehicle, values: dict[str, float]) -> Vehicle:
    def settled(use: EffectUse) -> EffectUse:
        key = use.label
        own = {
            name.removeprefix(f"{key}."): float(f"{value:.6g}")
            for name, value in values.items()
            if name.startswith(f"{key}.")
        }
        return msgspec.structs.replace(use, parameters={**use.parameters, **own})

    return msgspec.structs.replace(vehicle, effects=tuple(settled(use) for use in vehicle.effects))


def named_effects(vehicle: Vehicle, uses: Sequence[EffectUse], catalogue: Mapping[str, Effect] = CATALOGUE) -> Vehicle:
    """The vehicle with further effects, at their usual values where none are given."""
    catalogue = catalogue_of(vehicle, catalogue)
    return vehicle.with_effects(
        *[
            msgspec.structs.replace(use, parameters={**catalogue[use.name].defaults(vehicle), **use.parameters})
            for use in uses
        ]
    )
