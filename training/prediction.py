"""Predictions of a trained model along flights, their intervals, and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE
from training.card import FlightError
from training.checkpoint import Reliability, TrainedModel
from training.data.features import accelerations_from
from training.data.labelled_rows import LabelledRows

EVALUATION_BATCH = 8192  # windows
FADE_QUANTILE = 0.99  # quantile of the validation rows' disagreement from which on a residual fades
FLOOR_SHARE = 0.25  # share of the rows, those with the lowest disagreement, whose errors give the error floor
COVERAGE = 0.9  # of the errors lie within an interval
MIN_DISAGREEMENT = 1e-12  # members without any residual agree exactly


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction at every one of a data set's `ends`; all but body are None for a single network.

    body: (m, 6) body accelerations.
    disagreement: (m,) RMS over the outputs of the members' standardised deviation.
    half_width: (m, 6) of a 90 % interval, in the outputs' units.
    gate: (m,) share of the network's output that was added to the base.
    """

    body: Floats
    disagreement: Floats | None = None
    half_width: Floats | None = None
    gate: Floats | None = None


def predict(model: TrainedModel, data: LabelledRows, *, member: int | None = None, gated: bool = True) -> Prediction:
    """The ensemble's mean, or one member's prediction. data: made with the model's config and vehicle.

    gated: whether a grey box's residual fades where the members disagree more than on their own flights; on the
    nominal model it never does, because that is the worse fallback.
    """
    ends = data.ends
    base = None if data.base is None else data.base[ends]
    if not model.networks:
        assert base is not None
        return Prediction(base)
    outputs = member_outputs(model, data, member=member)
    mean, attitude = outputs.mean(axis=0), data.state[ends, ATTITUDE]
    if len(outputs) == 1 or model.reliability is None:
        return Prediction(accelerations_from(model.config, model.vehicle, mean, base, attitude))
    deviation = outputs.std(axis=0, ddof=1)
    disagreement = disagreement_of(outputs, model.scaling.output_std)
    gate = np.ones(len(ends))
    if gated and model.config.base == "grey_box":
        gate = gate_of(disagreement, model.reliability.disagreement)
    body = accelerations_from(model.config, model.vehicle, gate[:, None] * mean, base, attitude)
    reliability = model.reliability
    return Prediction(body, disagreement, np.hypot(reliability.error_floor, reliability.error_scale * deviation), gate)


def disagreement_of(outputs: Floats, output_std: Floats) -> Floats:
    """(m,) RMS over the outputs of the members' standardised deviation. outputs: (members, m, 6)."""
    deviation = outputs.std(axis=0, ddof=1) / output_std
    return np.asarray(np.sqrt(np.mean(deviation**2, axis=1)))


def gate_of(disagreement: Floats, threshold: float) -> Floats:
    """Share of a residual that is added: all of it up to the threshold, then falling with the square."""
    limit = max(threshold, MIN_DISAGREEMENT)
    return np.asarray((limit / np.maximum(disagreement, limit)) ** 2)


def member_outputs(model: TrainedModel, data: LabelledRows, *, member: int | None = None) -> Floats:
    """(members, m, 6) outputs of the networks at the data set's ends, in their units."""
    offsets = np.arange(1 - model.config.history, 1)
    parts = [
        model.outputs(data.inputs[data.ends[start : start + EVALUATION_BATCH, None] + offsets], member=member)
        for start in range(0, len(data.ends), EVALUATION_BATCH)
    ]
    return np.concatenate(parts, axis=1)


def judge_reliability(outputs: Floats, targets: Floats, output_std: Floats) -> Reliability | None:
    """Reliability of an ensemble's disagreement, from flights that no member was trained on; None for one member.

    outputs: (members, m, 6). targets: (m, 6) correct outputs.
    """
    if len(outputs) < 2:
        return None
    deviation = outputs.std(axis=0, ddof=1)
    disagreement = disagreement_of(outputs, output_std)
    error = np.abs(outputs.mean(axis=0) - targets)
    agreed = disagreement <= np.quantile(disagreement, FLOOR_SHARE)
    floor = np.quantile(error[agreed], COVERAGE, axis=0)
    beyond = np.sqrt(np.maximum(error**2 - floor**2, 0.0)) / np.maximum(deviation, 1e-12 * output_std)
    scale = np.quantile(beyond, COVERAGE, axis=0)
    return Reliability(float(np.quantile(disagreement, FADE_QUANTILE)), floor, scale)


def flight_errors(data: LabelledRows, body: Floats, label: Floats | None = None) -> tuple[FlightError, ...]:
    """Errors of body accelerations (m, 6) at the data set's ends, flight by flight.

    label: (n, 6) what they are compared with, by default the flights' own labels; rows of NaN are left out.
    """
    reference = (data.label if label is None else label)[data.ends]
    labelled = np.isfinite(reference).all(axis=1)
    flight, nominal = data.flight_of[data.ends], data.nominal[data.ends]
    base = None if data.base is None else data.base[data.ends]
    errors = []
    for place, name in enumerate(data.flights):
        rows = labelled & (flight == place)
        if not rows.any():
            continue
        linear, angular, combined = rmse(body[rows] - reference[rows])
        errors.append(
            FlightError(
                name,
                int(rows.sum()),
                linear,
                angular,
                combined,
                rmse(nominal[rows] - reference[rows])[2],
                None if base is None else rmse(base[rows] - reference[rows])[2],
            )
        )
    return tuple(errors)


def rmse(error: Floats) -> tuple[float, float, float]:
    """RMSE of linear (m/s^2), angular (rad/s^2) and all components of (m, 6) errors, each component counting alike."""
    square = np.mean(error**2, axis=0)
    linear, angular, combined = np.sqrt([square[:3].mean(), square[3:].mean(), square.mean()])
    return float(linear), float(angular), float(combined)


def pooled(errors: Sequence[FlightError]) -> FlightError:
    """All flights as one, every row counting alike."""
    rows = np.array([error.rows for error in errors], dtype=float)

    def over_all(values: Sequence[float]) -> float:
        return float(np.sqrt(np.average(np.square(values), weights=rows)))

    bases = [error.base for error in errors if error.base is not None]
    return FlightError(
        "all",
        int(rows.sum()),
        over_all([e.linear for e in errors]),
        over_all([e.angular for e in errors]),
        over_all([e.combined for e in errors]),
        over_all([e.nominal for e in errors]),
        over_all(bases) if len(bases) == len(errors) else None,
    )
