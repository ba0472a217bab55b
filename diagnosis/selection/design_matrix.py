"""Residuals and columns of all candidates for any segment, from models that are built once.

Candidates that vanish at their neutral values do not interact there, so that one model with all of them in it gives all
their slopes at once; those that have a grid, bring hidden states or move the air have models of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import msgspec
import numpy as np

from diagnosis.data.filters import slow
from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.models.channels import ANGULAR_ACCELERATION
from diagnosis.models.prediction import Prediction
from diagnosis.models.predictor import Predictor
from diagnosis.selection.candidates import (
    Candidate,
    Instruments,
    make_candidates,
    make_instruments,
    make_predictor,
    scales_rotors,
    shifts_rotors,
)
from diagnosis.thresholds import DEFAULT, PredictionThresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.errors import DataError
from dynamics.vehicle import EffectUse, Vehicle

MAX_BATCH = 120_000  # rows times columns that are filtered at once: more does not fit the cache


@dataclass(frozen=True, eq=False)
class _Group:
    """Candidates whose slopes one predictor gives in one evaluation.

    scale_rotors: whether they scale the rotors' forces.
    """

    candidates: tuple[Candidate, ...]
    make: Callable[[], Predictor]
    scale_rotors: bool

    @property
    def predictor(self) -> Predictor:
        """The predictor, made when it is needed first."""
        return self.make()


class DesignMatrix:
    """Residuals of a vehicle's model, and the columns of all candidates, for any segment.

    Candidates that an earlier fit holds are in the model that is linearised; what they contribute is added to its
    residuals by their columns, so that all coefficients count from the vehicle's own model.

    example: any of the segments.
    present: the model that is linearised.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        catalogue: Mapping[str, Effect],
        candidates: Sequence[Candidate],
        example: Segment,
        thresholds: PredictionThresholds = DEFAULT.prediction,
    ) -> None:
        self._vehicle = vehicle
        self._width = max((i for c in candidates for i in c.columns), default=-1) + 1
        held = [c for c in candidates if c.fitted is not None]
        self._coefficients = np.zeros(self._width)
        for candidate in held:
            self._coefficients[list(candidate.columns)] = candidate.coefficients
        own = {c.identity for c in held}
        uses = (*(u for u in vehicle.effects if (u.name, u.rotor) not in own), *(c.use() for c in held))
        self._source = _ModelSource(msgspec.structs.replace(vehicle, effects=uses), catalogue, example, thresholds)
        self.present = self._source.predictor(uses)
        self._without = {
            identity: self._source.predictor(_present_without(uses, vehicle, identity))
            for identity in {c.identity for c in candidates if c.fixed_shape and c.identity in own}
        }
        together = [c for c in candidates if _vanishes_beside_others(c, candidates)]
        joint = [[c for c in together if scales_rotors(c) is scaled] for scaled in (False, True)]
        self._groups = [self._source.joint(group) for group in joint if group]
        self._groups += self._source.alone([c for c in candidates if c not in together])

    def evaluate(self, segment: Segment, *, instrumented: bool = True) -> tuple[Floats, Floats]:
        """(m, 12) residuals of the present model, and (m, 12, k) columns.

        instrumented: columns for detection, which use instruments for the rotors' moments; else plain ones.
        """
        columns = np.empty((0, channels.CHANNELS, self._width))
        return self._evaluated(segment, columns, self._groups, instrumented=instrumented)

    def again(self, segment: Segment, columns: Floats) -> tuple[Floats, Floats]:
        """Rows with earlier columns (m, 12, k), but for those of what the model holds, of air and of what shares a
        model with others."""
        changed = [g for g in self._groups if len(g.candidates) > 1 or _is_held_or_air(g.candidates[0])]
        return self._evaluated(segment, columns, changed, instrumented=True)

    def _evaluated(
        self, segment: Segment, earlier: Floats, groups: Sequence[_Group], *, instrumented: bool
    ) -> tuple[Floats, Floats]:
        present = channels.predicted(segment, [self.present.predict(segment)])[:, :, 0]
        bases = {i: channels.predicted(segment, [p.predict(segment)])[:, :, 0] for i, p in self._without.items()}
        base = _Bases(present, bases)
        instruments = make_instruments(segment, self._vehicle, self.present.rotor_speed(segment))
        columns = earlier.copy() if len(earlier) else np.empty((len(present), channels.CHANNELS, self._width))
        lagged = bool(self.present.model.rotor_speed_places)  # rotor speeds are hidden states, which nothing replaces
        waiting: list[tuple[int, Prediction, Candidate]] = []
        for group in groups:
            waiting += _predictions(group, segment, instruments, instrumented=instrumented)
            if len(waiting) * len(segment) > MAX_BATCH:
                _fill(columns, segment, waiting, base, instrumented=instrumented, lagged=lagged)
                waiting = []
        _fill(columns, segment, waiting, base, instrumented=instrumented, lagged=lagged)
        rows = channels.measured(segment) - present
        if np.any(self._coefficients):
            rows = rows + columns @ self._coefficients
        return rows, columns


def _is_held_or_air(candidate: Candidate) -> bool:
    return candidate.fitted is not None or candidate.effect.wind is not None


def _present_without(
    uses: Sequence[EffectUse], vehicle: Vehicle, identity: tuple[str, int | None]
) -> tuple[EffectUse, ...]:
    """Effects with the vehicle's own values of one, or without it where the vehicle has none."""
    own = tuple(u for u in vehicle.effects if (u.name, u.rotor) == identity)
    return (*(u for u in uses if (u.name, u.rotor) != identity), *own)


@dataclass(frozen=True, eq=False)
class _Bases:
    """Predictions (m, 12) from which fixed shapes are differences.

    present: of the model that is linearised.
    without: of the same without one effect, by name and rotor, where it holds that.
    """

    present: Floats
    without: Mapping[tuple[str, int | None], Floats]

    def of(self, candidate: Candidate) -> Floats:
        """Columns of a candidate."""
        return self.without.get(candidate.identity, self.present)


@dataclass(frozen=True, eq=False)
class EvaluatedDesign:
    """Candidates with their rows and columns on some segments.

    candidates: all whose columns are finite.
    rows: (m, 12) residuals of the present model, a segment each.
    columns: (m, 12, k), a segment each.
    not_followed: effects that are left out at all points of their grids, since these logs' rate is too low for them.
    """

    candidates: tuple[Candidate, ...]
    matrix: DesignMatrix
    rows: list[Floats]
    columns: list[Floats]
    not_followed: tuple[str, ...]


def evaluate_design(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    thresholds: PredictionThresholds = DEFAULT.prediction,
) -> EvaluatedDesign:
    """The design matrix of all effects that these segments could show.

    Raises DataError when the vehicle's own model cannot be followed along them.
    """
    candidates = everything = make_candidates(vehicle, catalogue, segments, thresholds)
    while True:
        design = DesignMatrix(vehicle, catalogue, candidates, segments[0], thresholds)
        rows, columns = map(list, zip(*(design.evaluate(s) for s in segments), strict=True))
        if not all(np.isfinite(row).all() for row in rows):
            hidden = ", ".join(use.name for use in vehicle.effects if catalogue[use.name].hidden) or "its effects"
            raise DataError(
                f"the vehicle file's model has no finite prediction along these flights of {segments[0].rate:.0f} Hz. "
                f"Check the values of {hidden}, or log faster."
            )
        finite = np.all([np.isfinite(x).all(axis=(0, 1)) for x in columns], axis=0)
        followed = [c for c in candidates if finite[list(c.columns)].all()]
        if len(followed) == len(candidates):
            lost = {c.effect.name for c in everything} - {c.effect.name for c in candidates}
            return EvaluatedDesign(candidates, design, rows, columns, tuple(sorted(lost)))
        candidates = _renumbered(followed)


def _renumbered(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """The candidates with columns that follow each other."""
    result, count = [], 0
    for c in candidates:
        result.append(replace(c, columns=tuple(range(count, count + len(c.columns)))))
        count += len(c.columns)
    return tuple(result)


@dataclass(frozen=True, eq=False)
class _ModelSource:
    """Common part of all models of a design matrix."""

    vehicle: Vehicle
    catalogue: Mapping[str, Effect]
    example: Segment
    thresholds: PredictionThresholds

    def predictor(self, uses: Sequence[EffectUse], free: Sequence[str] = ()) -> Predictor:
        measured = self.example.rotor_source == "measured"
        return Predictor(self.vehicle, uses, self.catalogue, free, speed_measured=measured, thresholds=self.thresholds)

    def joint(self, candidates: Sequence[Candidate]) -> _Group:
        """One model with all candidates in it."""
        own = {(c.effect.name, c.rotor) for c in candidates}
        others = [use for use in self.vehicle.effects if (use.name, use.rotor) not in own]
        free = [f"{c.key}.{name}" for c in candidates for name in c.free]
        make = partial(self.predictor, [*others, *(c.use() for c in candidates)], free)
        return _Group(tuple(candidates), cache(make), scales_rotors(candidates[0]))

    def alone(self, candidates: Sequence[Candidate]) -> list[_Group]:
        """A group for each candidate; those at several points of one grid share a model."""
        shared: dict[tuple[str, tuple[str, ...]], Callable[[], Predictor]] = {}
        groups = []
        for c in candidates:
            make = partial(make_predictor, self.vehicle, self.catalogue, c, self.example, self.thresholds)
            groups.append(_Group((c,), shared.setdefault((c.key, c.free), cache(make)), scales_rotors(c)))
        return groups


def _vanishes_beside_others(candidate: Candidate, candidates: Sequence[Candidate]) -> bool:
    effect = candidate.effect
    alone = sum(c.key == candidate.key for c in candidates) == 1
    moves = effect.hidden or effect.wind is not None or effect.rotor_speed is not None or effect.resists_air
    return alone and not candidate.fixed_shape and not moves


def _predictions(
    group: _Group, segment: Segment, instruments: Instruments, *, instrumented: bool
) -> list[tuple[int, Prediction, Candidate]]:
    """(place of the column, slope or prediction of the fixed shape, candidate) of a group's columns.

    instrumented: whether the rotors' forces are those of the instruments, or of the rotors' speeds.
    """
    first = group.candidates[0]
    if first.fixed_shape:
        return [(first.columns[0], group.predictor.predict(segment, first.values), first)]
    logged = instruments.logged if segment.rotor_share is None else None  # the predictor's own, with their means
    scaled = instruments.rotor_speed if instrumented else logged
    speed = scaled if group.scale_rotors else None
    acceleration = instruments.rotor_acceleration if instrumented else None
    values = {name: value for c in group.candidates for name, value in c.values.items()}
    slopes = group.predictor.slopes(segment, values, rotor_speed=speed, rotor_acceleration=acceleration)
    owners = [(place, c) for c in group.candidates for place in c.columns]
    return [(place, slope, c) for (place, c), slope in zip(owners, slopes, strict=True)]


def _fill(
    matrix: Floats,
    segment: Segment,
    waiting: Sequence[tuple[int, Prediction, Candidate]],
    base: _Bases,
    *,
    instrumented: bool,
    lagged: bool,
) -> None:
    """Write filtered columns to their places in the matrix (m, 12, k). lagged: whether the rotors have a lag."""
    if not waiting:
        return
    places, predictions, candidates = zip(*waiting, strict=True)
    columns = channels.predicted(segment, predictions)
    for i, candidate in enumerate(candidates):
        if candidate.fixed_shape:
            columns[:, :, i] -= base.of(candidate)
    slow_only = [i for i, c in enumerate(candidates) if shifts_rotors(c) or (lagged and scales_rotors(c))]
    if instrumented and slow_only:
        columns[:, :, slow_only] = with_slow_moments(columns[:, :, slow_only], segment)
    matrix[:, :, places] = columns


def with_slow_moments(columns: Floats, segment: Segment) -> Floats:
    """Columns (m, 12, ...) with the moments of slow motion alone, instruments: turbulence turns the vehicle, and within
    30 ms the controller's commands answer, which would look like lag."""
    result = columns.copy()
    angular = columns[:, ANGULAR_ACCELERATION]
    result[:, ANGULAR_ACCELERATION] = slow(angular, segment.decimated_rate, segment.filters.slow_cutoff)
    return result
