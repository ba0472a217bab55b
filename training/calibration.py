"""How well an ensemble's disagreement predicts its error: rank of the worst rows, coverage of the intervals."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE
from training.checkpoint import TrainedModel
from training.data.features import outputs_from
from training.data.labelled_rows import LabelledRows
from training.prediction import member_outputs, predict

WORST_SHARE = 0.1  # share of the rows that disagreement should find


class Calibration(msgspec.Struct, frozen=True):
    """Calibration of an ensemble on flights that it was not trained on.

    auroc: of the disagreement as a predictor of the worst tenth of the rows, 0.5 for chance.
    coverage: share of the outputs within their 90 % interval.
    faded: share of the rows whose residual is not added in full.
    """

    auroc: float
    coverage: float
    faded: float


def calibration(model: TrainedModel, data: LabelledRows, label: Floats) -> Calibration | None:
    """Calibration on flights that the model was not trained on; None for a single network.

    label: (n, 6) body accelerations, NaN where unknown.
    """
    prediction = predict(model, data)
    if prediction.disagreement is None or prediction.half_width is None or prediction.gate is None:
        return None
    ends = data.ends
    base = None if data.base is None else data.base[ends]
    target = outputs_from(model.config, model.vehicle, label[ends], base, data.state[ends, ATTITUDE])
    error = member_outputs(model, data).mean(axis=0) - target
    labelled = np.isfinite(error).all(axis=1)
    size = np.sqrt(np.mean((error[labelled] / model.scaling.output_std) ** 2, axis=1))
    worst = size > np.quantile(size, 1 - WORST_SHARE)
    covered = np.abs(error[labelled]) <= prediction.half_width[labelled]
    return Calibration(
        auroc(prediction.disagreement[labelled], worst),
        float(covered.mean()),
        float(np.mean(prediction.gate[labelled] < 1)),
    )


def auroc(score: Floats, positive: NDArray[np.bool_]) -> float:
    """Area under the curve of true over false alarms: the chance that a positive scores above a negative.

    score: (m,), ties counting half. NaN when all or none are positive.
    """
    _, inverse, counts = np.unique(score, return_inverse=True, return_counts=True)
    rank = (np.cumsum(counts) - 0.5 * (counts - 1))[inverse]
    hits = int(positive.sum())
    if hits in (0, len(score)):
        return float("nan")
    return float((rank[positive].sum() - 0.5 * hits * (hits + 1)) / (hits * (len(score) - hits)))
