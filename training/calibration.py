"""Whether an ensemble knows where it errs: does its disagreement find the worst rows, do its error bars cover."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE
from training.checkpoint import TrainedModel
from training.data.dataset import Dataset
from training.data.features import outputs_from
from training.prediction import member_outputs, predict

WORST = 0.1  # share of the rows that disagreement should find


class Calibration(msgspec.Struct, frozen=True):
    """auroc: of the disagreement as a sign of the worst tenth of the rows, 0.5 for no sign at all.

    coverage: share of the outputs within their 90 % interval. faded: share of the rows whose residual is not fully
    believed.
    """

    auroc: float
    coverage: float
    faded: float


def calibration(model: TrainedModel, data: Dataset, label: Floats) -> Calibration | None:
    """From flights that the model has not seen; None for a single network. label: (n, 6), NaN where unknown."""
    said = predict(model, data)
    if said.disagreement is None or said.half_width is None or said.gate is None:
        return None
    ends = data.ends
    base = None if data.base is None else data.base[ends]
    wanted = outputs_from(model.config, model.vehicle, label[ends], base, data.state[ends, ATTITUDE])
    error = member_outputs(model, data).mean(axis=0) - wanted
    known = np.isfinite(error).all(axis=1)
    size = np.sqrt(np.mean((error[known] / model.scaling.output_std) ** 2, axis=1))
    worst = size > np.quantile(size, 1 - WORST)
    covered = np.abs(error[known]) <= said.half_width[known]
    return Calibration(
        auroc(said.disagreement[known], worst), float(covered.mean()), float(np.mean(said.gate[known] < 1))
    )


def auroc(score: Floats, positive: NDArray[np.bool_]) -> float:
    """Area under the curve of true over false alarms: the chance that a positive scores above a negative.

    score: (m,), ties counting half. NaN when there is only one kind.
    """
    ordered, inverse, counts = np.unique(score, return_inverse=True, return_counts=True)
    rank = (np.cumsum(counts) - 0.5 * (counts - 1))[inverse]
    hits = int(positive.sum())
    if hits in (0, len(ordered[inverse])):
        return float("nan")
    return float((rank[positive].sum() - 0.5 * hits * (hits + 1)) / (hits * (len(score) - hits)))
