"""The path of hidden states along rows of motion: how many steps it needs, a step, and the rows between two steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from diagnosis.models.batched_function import Recurrence
from diagnosis.thresholds import PredictionThresholds
from dynamics.arrays import Floats
from dynamics.effect import Expression
from dynamics.integrators import MAX_STEP_IN_LAGS, exponential_steps, lag_places, relaxation_of
from dynamics.model import Model
from dynamics.state import RIGID_BODY_STATES

Slope = Callable[[Expression, Expression, Expression], Expression]  # (row, hidden states, parameters) -> (h,)


@dataclass(frozen=True)
class Pace:
    """How fast the hidden states of a model are.

    lags: places of all time constants among the parameters. bounding: of those that bound an integration step.
    """

    lags: tuple[int, ...]
    bounding: tuple[int, ...]

    def stride(self, rate: float, values: Floats, limits: PredictionThresholds) -> int:
        """Rows at a rate, Hz, from one step of the hidden states to the next: one where they are fast."""
        slowest = min((values[place] for place in self.lags), default=np.inf) * limits.hidden_rate
        return 1 if slowest < 1 else max(1, int(rate / limits.hidden_rate))

    def substeps(self, period: float, values: Floats, limits: PredictionThresholds) -> int | None:
        """Integration steps over a period, s; None if more than are taken."""
        lag = min((values[place] for place in self.bounding), default=np.inf)
        required = max(1, math.ceil(period / (MAX_STEP_IN_LAGS * lag))) if lag > 0 else limits.max_substeps + 1
        return required if required <= limits.max_substeps else None


def pace_of(model: Model) -> Pace:
    """The pace of a model's hidden states."""
    lags, bounding = lag_places(model)
    return Pace(tuple(lags), tuple(bounding))


def advance(model: Model, slope: Slope, steps: int) -> Recurrence:
    """(hidden, before, after, p, dt) -> hidden states after a stride, in `steps` steps between the rows' motion.

    Between two rows motion and rotors' speeds or commands change linearly. slope: of the hidden states.
    """
    width = RIGID_BODY_STATES + model.input_count + 2
    before, after, dt = ca.SX.sym("before", width), ca.SX.sym("after", width), ca.SX.sym("dt")
    h, p = ca.SX.sym("h", model.hidden_count), ca.SX.sym("p", len(model.parameter_names))

    def driven(hidden: Expression, share: float) -> Expression:
        return slope((1 - share) * before + share * after, hidden, p)

    following = exponential_steps(driven, h, relaxation_of(driven(h, 0.0), h), dt, steps=steps)
    return Recurrence(ca.Function("advance", [h, before, after, p, dt], [following]), shared=(3, 4))


def between(values: Floats, stride: int, count: int) -> Floats:
    """(count, k) values (m, k) of every stride-th row, linear between them, the last one held."""
    if stride == 1:
        return values
    place = np.minimum(np.arange(count) / stride, len(values) - 1)
    before = np.minimum(place.astype(int), len(values) - 2)
    share = (place - before)[:, None]
    return np.asarray((1 - share) * values[before] + share * values[before + 1])
