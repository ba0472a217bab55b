"""From a segment to residuals and the columns of all candidates, with the models built once.

Candidates that vanish at their neutral values do not disturb each other there, so that one model with all of them in it
gives all their slopes at once; those that are tried at several values, bring hidden states or move the air stand in
models of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.filters import slow
from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.models.prediction import Prediction, Predictor
from diagnosis.selection.candidates import ANGULAR, Candidate, Instruments, make_instruments, make_predictor
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle

AT_ONCE = 120_000  # rows times columns that are filtered at once: more does not stay near the processor


@dataclass(frozen=True, eq=False)
class _Group:
    """Candidates whose slopes one predictor gives in one evaluation. rotors: whether they scale the rotors' forces."""

    candidates: tuple[Candidate, ...]
    predictor: Predictor
    rotors: bool


class Pipeline:
    """The present model of a vehicle and all candidates beside it. example: any of the segments."""

    def __init__(
        self, vehicle: Vehicle, catalogue: Mapping[str, Effect], candidates: Sequence[Candidate], example: Segment
    ) -> None:
        self._vehicle = vehicle
        self._width = max((i for c in candidates for i in c.columns), default=-1) + 1
        measured = example.rotor_source == "measured"
        self._present = Predictor(vehicle, vehicle.effects, catalogue, speed_measured=measured)
        together = [c for c in candidates if _stands_beside_others(c, candidates)]
        groups = [
            _joint(vehicle, catalogue, [c for c in together if _scales_rotors(c) is rotors], rotors, measured)
            for rotors in (False, True)
        ]
        self._groups = [g for g in groups if g is not None]
        shared: dict[tuple[str, tuple[str, ...]], Predictor] = {}
        for c in candidates:
            if c in together:
                continue
            if (c.key, c.free) not in shared:
                shared[c.key, c.free] = make_predictor(vehicle, catalogue, c, example)
            self._groups.append(_Group((c,), shared[c.key, c.free], _scales_rotors(c)))

    def run(self, segment: Segment, *, instrumented: bool = True) -> tuple[Floats, Floats]:
        """(m, 12) residuals of the present model, and (m, 12, k) columns; for detection if instrumented, else plain."""
        base = channels.predicted(segment, [self._present.predict(segment)])
        instruments = make_instruments(segment, self._vehicle) if instrumented else None
        found = np.empty((len(base), channels.CHANNELS, self._width))
        waiting: list[tuple[int, Prediction, Candidate]] = []
        for group in self._groups:
            waiting += _predictions(group, segment, instruments)
            if len(waiting) * len(segment) > AT_ONCE:
                _fill(found, segment, waiting, base, instruments)
                waiting = []
        _fill(found, segment, waiting, base, instruments)
        return channels.measured(segment) - base[:, :, 0], found


def _stands_beside_others(candidate: Candidate, candidates: Sequence[Candidate]) -> bool:
    effect = candidate.effect
    alone = sum(c.key == candidate.key for c in candidates) == 1
    moves = effect.hidden or effect.wind is not None or effect.rotor_speed is not None or effect.resists_air
    return alone and not candidate.whole and not moves


def _scales_rotors(candidate: Candidate) -> bool:
    return candidate.effect.physics is not None


def _joint(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], candidates: Sequence[Candidate], rotors: bool, measured: bool
) -> _Group | None:
    if not candidates:
        return None
    mine = {(c.effect.name, c.rotor) for c in candidates}
    kept = [use for use in vehicle.effects if (use.name, use.rotor) not in mine]
    free = [f"{c.key}.{name}" for c in candidates for name in c.free]
    uses = [*kept, *(c.use() for c in candidates)]
    predictor = Predictor(vehicle, uses, catalogue, free, speed_measured=measured)
    return _Group(tuple(candidates), predictor, rotors)


def _predictions(
    group: _Group, segment: Segment, instruments: Instruments | None
) -> list[tuple[int, Prediction, Candidate]]:
    """(place of the column, slope or whole prediction, candidate) of a group's columns."""
    first = group.candidates[0]
    if first.whole:
        return [(first.columns[0], group.predictor.predict(segment, first.values), first)]
    speed = instruments.rotor_speed if instruments is not None and group.rotors else None
    acceleration = instruments.rotor_acceleration if instruments is not None else None
    values = {name: value for c in group.candidates for name, value in c.values.items()}
    slopes = group.predictor.slopes(segment, values, rotor_speed=speed, rotor_acceleration=acceleration)
    owners = [(place, c) for c in group.candidates for place in c.columns]
    return [(place, slope, c) for (place, c), slope in zip(owners, slopes, strict=True)]


def _fill(
    found: Floats, segment: Segment, waiting: Sequence[tuple[int, Prediction, Candidate]], base: Floats,
    instruments: Instruments | None,
) -> None:  # fmt: skip
    """Write filtered columns to their places in found (m, 12, k)."""
    if not waiting:
        return
    columns = channels.predicted(segment, [prediction for _, prediction, _ in waiting])
    for i, (place, _, candidate) in enumerate(waiting):
        column = columns[:, :, i]
        if candidate.whole:
            column = column - base[:, :, 0]
            if instruments is not None and candidate.effect.rotor_speed is not None:
                column[:, ANGULAR] = slow(column[:, ANGULAR], instruments.reduced_rate)
        found[:, :, place] = column
