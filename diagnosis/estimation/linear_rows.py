"""Residuals, slopes and instruments of the parameters of a joint fit, along a segment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from diagnosis.data.filters import slow
from diagnosis.data.segment import Segment
from diagnosis.estimation.fitted import with_candidates
from diagnosis.models import channels
from diagnosis.models.prediction import Prediction
from diagnosis.models.predictor import Predictor
from diagnosis.selection.candidates import Candidate, make_instruments, scales_rotors, shifts_rotors, without_lag
from diagnosis.thresholds import Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import EffectUse, Vehicle


class Fitted(Protocol):
    """Data of a fit: a regression's segments on its vehicle, or a planned flight."""

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle whose model is completed."""
        ...

    @property
    def catalogue(self) -> Mapping[str, Effect]:
        """All effects by name."""
        ...

    @property
    def segments(self) -> Sequence[Segment]:
        """Of which the first has the kinds of channel that all have."""
        ...

    @property
    def thresholds(self) -> Thresholds:
        """Of prediction and fit."""
        ...


class LinearRows:
    """The full model of some candidates on a vehicle, linearised in their free parameters.

    free: (candidate, parameter) of each. names: the same as the model names them. predictor: of the model.
    of_commands: whether rotor speeds follow from commands.
    """

    def __init__(self, regression: Fitted, candidates: Sequence[Candidate], vehicle: Vehicle) -> None:
        self._regression, self._vehicle = regression, vehicle
        self.free = [(c, name) for c in candidates for name in _free(c)]
        self.names = [f"{c.key}.{name}" for c, name in self.free]
        self.linear = [f"{c.key}.{n}" for c in candidates for n in c.free]
        uses = with_candidates(vehicle, candidates, {}).effects
        self.predictor = self._model(uses, self.linear)
        self._lags = {f"{c.key}.{n}" for c, n in self.free if shifts_rotors(c)}
        self._instrumented = [scales_rotors(c) for c, _ in self.free]
        example = regression.segments[0]
        self.of_commands = example.rotor_source != "measured"
        cutoff = example.filters.command_cutoff if self.of_commands else example.filters.slow_cutoff
        self._cutoff, self._lag_cutoff = cutoff, example.filters.slow_cutoff
        self._instruments = self.predictor
        if self.predictor.model.rotor_speed_places:  # its rotors turn behind their commands, whatever speeds are given
            self._instruments = self._model(without_lag(uses, regression.catalogue), self.linear)

    def at(self, segment: Segment, changed: Mapping[str, float]) -> tuple[Floats, Floats, Floats]:
        """Residual (m, 12), slopes (m, 12, k) and instruments (m, 12, k) at changed parameters."""
        names = [name for name in self.names if name not in self.linear]
        steps = [self._step(changed[name]) for name in names]
        moved = [
            self.predictor.predict(segment, {**changed, name: changed[name] + step})
            for name, step in zip(names, steps, strict=True)
        ]
        plain = self.predictor.slopes(segment, changed) if self.linear else []
        scaling, at_speed = self._at_instruments(segment, changed)
        together = [self.predictor.predict(segment, changed), *moved, *plain, *at_speed]
        base, *columns = np.moveaxis(channels.predicted(segment, together), 2, 0)  # all are filtered at once
        slopes = dict(zip([*names, *self.linear], columns[: len(moved) + len(plain)], strict=True))
        slopes |= {name: (slopes[name] - base) / step for name, step in zip(names, steps, strict=True)}
        instruments = slopes | dict(zip(scaling, columns[len(slopes) :], strict=True))
        for name in self._lags:
            instruments[name] = slow(slopes[name], segment.decimated_rate, self._lag_cutoff)
        x, z = (np.stack([of[name] for name in self.names], axis=2) for of in (slopes, instruments))
        return channels.measured(segment) - base, x, z

    def _step(self, value: float) -> float:
        return self._regression.thresholds.equation_error.difference_step * max(abs(value), 1e-3)

    def _at_instruments(self, segment: Segment, changed: Mapping[str, float]) -> tuple[list[str], list[Prediction]]:
        """Parameters that scale the rotors' forces, and their slopes at rotor speeds free of the disturbance."""
        names = [n for n, scales in zip(self.names, self._instrumented, strict=True) if scales and n in self.linear]
        if not names:
            return [], []
        logged = self.predictor.rotor_speed(segment, self.predictor.values(changed))
        vehicle, slow_thrust = self._regression.vehicle, self.of_commands
        speed = make_instruments(segment, vehicle, logged, self._cutoff, slow_thrust=slow_thrust).rotor_speed
        own = self._instruments.model.parameter_names
        at = {name: value for name, value in changed.items() if name in own}
        return names, self._instruments.slopes(segment, at, rotor_speed=speed, free=names)

    def _model(self, uses: Sequence[EffectUse], free: Sequence[str]) -> Predictor:
        r = self._regression
        measured = r.segments[0].rotor_source == "measured"
        return Predictor(
            self._vehicle, uses, r.catalogue, free, speed_measured=measured, thresholds=r.thresholds.prediction
        )


def _free(candidate: Candidate) -> tuple[str, ...]:
    if candidate.fixed_shape:
        return tuple(candidate.at)
    return (*candidate.free, *candidate.effect.refine, *candidate.effect.assumed)
