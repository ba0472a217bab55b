"""Hidden states of effects along a reference, as a load that swings has: a known input, which the motion drives.

They are integrated along the reference's motion and the rotors' speeds, at each row's middle. What turbulence does to
them beyond the motion that is seen is left to the noise of the filter.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from functools import lru_cache, partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from diagnosis.models.hidden_path import advance, between, pace_of
from diagnosis.thresholds import DEFAULT
from dynamics.arrays import Floats
from dynamics.effect import Expression
from dynamics.model import Model
from dynamics.state import HIDDEN, RIGID_BODY_STATES

MAX_SAVED = 256


class HiddenStates:
    """The hidden states of a model: where they begin, what they depend on, and their path."""

    def __init__(self, model: Model) -> None:
        self.model, self.count = model, model.hidden_count
        self._functions = _functions_of(model) if self.count else None

    @property
    def starts(self) -> dict[str, tuple[int, float]]:
        """Place and standard deviation of each that may begin anywhere, by name."""
        made = {}
        for item in self.model.effects:
            for hidden in item.effect.hidden:
                entries = item.hidden[hidden.name]
                for place in range(entries.start, entries.stop) if hidden.start_std else ():
                    made[f"{item.key}.{hidden.name}[{place - entries.start}]"] = (
                        place - RIGID_BODY_STATES,
                        hidden.start_std,
                    )
        return made

    def begins_at(self, offsets: Mapping[str, float]) -> Floats:
        """(h,) in hover, with offsets by name."""
        start = self.model.hidden_initial.copy()
        for name, (place, _) in self.starts.items():
            start[place] += offsets.get(name, 0.0)
        return start

    def keys_of(self, which: NDArray[np.bool_]) -> set[str]:
        """Keys of the effects of which some of the hidden states are. which: (h,)."""
        offset = RIGID_BODY_STATES
        return {
            item.key
            for item in self.model.effects
            if any(which[place.start - offset : place.stop - offset].any() for place in item.hidden.values())
        }

    def depends_on(self, name: str) -> bool:
        """Whether their path depends on a parameter of the model."""
        return self._functions is not None and name in self._functions.parameters

    def is_followed(self, period: float, values: Floats) -> bool:
        """Whether rows of a period, s, are close enough to follow them."""
        return self._functions is None or self._functions.steps(period, values)[1] is not None

    def path(self, driving: Floats, period: float, start: Floats, values: Floats) -> Floats:
        """(N, h) from (h,) a start, not finite where rows are too far apart.

        driving: (N, 13 + rotors + 2) motion, rotors' speeds and environment. values: of the model's parameters.
        """
        if self._functions is None:
            return np.zeros((len(driving), 0))
        stride, steps = self._functions.steps(period, values)
        if steps is None:
            return np.full((len(driving), self.count), np.nan)
        here = np.ascontiguousarray(driving[::stride])
        with np.errstate(all="ignore"):
            advance = self._functions.advance(steps)
            path = np.vstack([start, advance(start, here[:-1], here[1:], values, np.array([stride * period]))])
        return between(path, stride, len(driving))


class _Functions:
    """Functions of the hidden states of one structure of model."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._pace = pace_of(model)
        row = ca.SX.sym("row", RIGID_BODY_STATES + model.input_count + 2)
        hidden, p = ca.SX.sym("h", model.hidden_count), ca.SX.sym("p", len(model.parameter_names))
        moving = ca.which_depends(self._slope(row, hidden, p), p, 1, False)
        self.parameters = {name for name, moves in zip(model.parameter_names, moving, strict=True) if moves}
        self.advance = lru_cache(partial(advance, model, self._slope))

    def steps(self, period: float, values: Floats) -> tuple[int, int | None]:
        """Rows from one step to the next, and integration steps between them, None if more than are taken."""
        limits = DEFAULT.prediction
        stride = self._pace.stride(1 / period, values, limits)
        return stride, self._pace.substeps(stride * period, values, limits)

    def _slope(self, row: Expression, hidden: Expression, p: Expression) -> Expression:
        """(h,) derivative of the hidden states."""
        model, n = self._model, self._model.input_count
        state = ca.vertcat(row[:RIGID_BODY_STATES], hidden)
        speed, environment = row[RIGID_BODY_STATES : RIGID_BODY_STATES + n], row[RIGID_BODY_STATES + n :]
        return model.derivative(state, speed, p, environment, ca.SX.zeros(model.hidden_count))[HIDDEN]


_functions: dict[Hashable, _Functions] = {}


def _functions_of(model: Model) -> _Functions:
    if model.structure not in _functions:
        if len(_functions) >= MAX_SAVED:
            _functions.clear()
        _functions[model.structure] = _Functions(model)
    return _functions[model.structure]
