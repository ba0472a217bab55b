"""Residuals, slopes and instruments of the parameters of a joint fit, along a segment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from diagnosis.data.filters import slow
from diagnosis.data.segment import Segment
from diagnosis.estimation.fitted import with_candidates
from diagnosis.models import channels
from diagnosis.models.predictor import Predictor
from diagnosis.selection.candidates import Candidate, make_instruments, scales_rotors, shifts_rotors, without_lag
from diagnosis.thresholds import Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import EffectUse, Vehicle


class Fitted(Protocol):
    """What is fitted: a regression's segments on its vehicle, or a planned flight."""

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

    def __init__(
        self, regression: Fitted, candidates: Sequence[Candidate], vehicle: Vehicle, *, slower: float = 1.0
    ) -> None:
        """slower: by which the cutoff below which motion is slow, for instruments, is divided."""
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
        self._cutoff = cutoff / slower
        self._instruments = self.predictor
        if self.predictor.model.rotor_speed_places:  # its rotors turn behind their commands, whatever speeds are given
            self._instruments = self._model(without_lag(uses, regression.catalogue), self.linear)

    def at(self, segment: Segment, changed: Mapping[str, float]) -> tuple[Floats, Floats, Floats]:
        """Residual (m, 12), slopes (m, 12, k) and instruments (m, 12, k) at changed parameters."""
        base = channels.predicted(segment, [self.predictor.predict(segment, changed)])[:, :, 0]
        slopes: dict[str, Floats] = {}
        instruments: dict[str, Floats] = {}
        if self.linear:
            plain = channels.predicted(segment, self.predictor.slopes(segment, changed))
            slopes = {name: plain[:, :, i] for i, name in enumerate(self.linear)}
            scaling = [n for n, scales in zip(self.names, self._instrumented, strict=True) if scales and n in slopes]
            if scaling:
                logged = self.predictor.rotor_speed(segment, self.predictor.values(changed))
                vehicle = self._regression.vehicle
                speed = make_instruments(
                    segment, vehicle, logged, self._cutoff, slow_thrust=self.of_commands
                ).rotor_speed
                model = self._instruments.model
                at = {name: value for name, value in changed.items() if name in model.parameter_names}
                at_speed = self._instruments.slopes(segment, at, rotor_speed=speed, free=scaling)
                instruments = dict(zip(scaling, channels.predicted(segment, at_speed).transpose(2, 0, 1), strict=True))
        x, z = [], []
        for name, instrumented in zip(self.names, self._instrumented, strict=True):
            slope = slopes[name] if name in slopes else self._difference(segment, changed, name, base)
            x.append(slope)
            z.append(instruments[name] if instrumented and name in instruments else slope)
            if name in self._lags:
                z[-1] = slow(slope, segment.decimated_rate, segment.filters.slow_cutoff)
        return channels.measured(segment) - base, np.stack(x, axis=2), np.stack(z, axis=2)

    def _difference(self, segment: Segment, changed: Mapping[str, float], name: str, base: Floats) -> Floats:
        step = self._regression.thresholds.equation_error.difference_step * max(abs(changed[name]), 1e-3)
        moved = self.predictor.predict(segment, {**changed, name: changed[name] + step})
        return np.asarray((channels.predicted(segment, [moved])[:, :, 0] - base) / step)

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
