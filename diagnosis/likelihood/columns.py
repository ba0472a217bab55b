"""Columns of what may be missing: inputs of the filter by a unit of each parameter, of candidates and of nuisances.

Nuisances are errors that every log has, with a prior on their size: biases and clocks of each flight's sensors, and a
share of the model's own motion that it never meets. What lies between a motor command and thrust is free, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.likelihood import priors
from diagnosis.likelihood.features import Discrepancy
from diagnosis.likelihood.flight_rows import FlightRows
from diagnosis.likelihood.gain import KINDS, unread
from diagnosis.likelihood.rigid_body import OUTPUTS, SPEEDS, Along, FlightModel, before_reading
from diagnosis.models.command_effects import COMMAND_EFFECTS
from diagnosis.selection.candidates import Candidate, make_candidates
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle


@dataclass(frozen=True, eq=False)
class Column:
    """One parameter of a candidate.

    candidate: place among the candidates. name: of the parameter, "" for the size of a fixed shape.
    """

    candidate: int
    name: str


@dataclass(frozen=True, eq=False)
class Nuisance:
    """An error of every log. kind, place: which. std: before any flight. lasts: in which it is one and the same.

    of: the hidden state whose start is unknown, in each part of a flight anew.
    """

    kind: str
    place: int
    std: float
    lasts: Literal["always", "flight", "part", "block"]
    of: str = ""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Effects that may be missing, each at points about which it is linear.

    columns: of all, one after another. discrepancies: what no effect is, asked beside a set; its columns are the last.
    not_followed: effects that are left out at all points of their grids, since these logs' rate is too low for them.
    """

    all: tuple[Candidate, ...]
    columns: tuple[Column, ...]
    nuisances: tuple[Nuisance, ...]
    discrepancies: tuple[Discrepancy, ...] = ()
    not_followed: tuple[str, ...] = ()

    def places(self, number: int) -> list[int]:
        """Columns of a candidate."""
        return [i for i, column in enumerate(self.columns) if column.candidate == number]

    def with_errors_of(self, segment: Segment) -> Candidates:
        """Candidates beside the errors of logs of the kind of a segment."""
        return replace(self, nuisances=nuisances(segment))

    @property
    def of_commands(self) -> list[int]:
        """Columns of what lies between a motor command and thrust: the last ones, free in every set."""
        return [i for i, c in enumerate(self.columns) if self.all[c.candidate].effect.name in COMMAND_EFFECTS]

    @property
    def of_discrepancies(self) -> range:
        """Columns of discrepancies."""
        return range(len(self.columns) + len(self.nuisances), self.width)

    @property
    def width(self) -> int:
        """Number of columns, nuisances and discrepancies included."""
        return len(self.columns) + len(self.nuisances) + sum(len(one) for one in self.discrepancies)


@dataclass(frozen=True, eq=False)
class Starts:
    """Offsets from hover of hidden states at a flight's start, by name.

    fitted: of the model about which all is linear. candidates: of others, by number.
    """

    fitted: Mapping[str, float] = field(default_factory=dict)
    candidates: Mapping[int, Mapping[str, float]] = field(default_factory=dict)

    def of(self, layer: Sequence[int]) -> dict[str, float]:
        """Of a model with some candidates in it."""
        made = dict(self.fitted)
        for number in layer:
            made |= self.candidates.get(number, {})
        return made


def candidates(vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment]) -> Candidates:
    """The effects that these flights could show: at each grid point where they are not linear, once where they are."""
    every, taken, lost = [], set(), set()
    possible = make_candidates(vehicle, catalogue, segments)
    for candidate in sorted(possible, key=lambda c: c.effect.name in COMMAND_EFFECTS):
        effect = candidate.effect
        if candidate.fixed_shape and effect.rotor_speed is None:  # smooth at its present values, all free
            if candidate.key in taken:
                continue
            at = candidate.present or {p.name: p.neutral for p in effect.parameters}
            candidate = Candidate(effect, candidate.rotor, at, tuple(at), candidate.present)
        if effect.rotor_speed is not None and candidate.present is not None:
            if candidate.key in taken:
                continue
            candidate = Candidate(effect, candidate.rotor, candidate.present, effect.time_constants, candidate.present)
        if has_states(effect) and not _is_followed(candidate, vehicle, catalogue, segments):
            lost.add(effect.name)
            continue
        taken.add(candidate.key)
        every.append(candidate)
    lost -= {candidate.effect.name for candidate in every}
    return Candidates(tuple(every), _columns(every), nuisances(segments[0]), not_followed=tuple(sorted(lost)))


def nuisances(segment: Segment) -> tuple[Nuisance, ...]:
    """Errors of logs of the kind of one segment."""
    estimated = segment.pose_source == "estimator"
    level, clock = (priors.LEVEL_OF_ESTIMATOR, priors.FILTER_DELAY) if estimated else (priors.LEVEL, priors.CLOCK)
    force = priors.ACCELEROMETER_OF_AUTOPILOT if estimated else priors.ACCELEROMETER
    own = [Nuisance("gyro", i, priors.GYRO, "flight") for i in range(3)]
    own += [Nuisance("accelerometer", i, force, "flight") for i in range(3)]
    own += [Nuisance("level", i, level, "flight") for i in range(3)]
    turn = priors.FILTER_DELAY if estimated else priors.ATTITUDE_CLOCK
    own += [Nuisance("clock", 0, clock, "flight"), Nuisance("attitude_clock", 0, turn, "flight")]
    if segment.rotor_source == "measured":
        own.append(Nuisance("rotor_clock", 0, priors.CLOCK, "flight"))
        if segment.rotor_share is None:  # where it is told from the flights, a segment's speeds are their mean already
            own.append(Nuisance("rotor_clock", 0, priors.HOLD / segment.rate, "always"))
    blocks = [Nuisance(kind, i, priors.DISCREPANCY, "block") for kind in ("force", "turning") for i in range(3)]
    return (*own, *blocks)


def has_states(effect: Effect) -> bool:
    """Whether it has hidden states that the vehicle's motion drives, and not a lag of the rotors."""
    return bool(effect.hidden) and effect.rotor_speed is None


def about(
    what: Candidates, vehicle: Vehicle, catalogue: Mapping[str, Effect], fitted: Mapping[int, Mapping[str, float]]
) -> Candidates:
    """Candidates about the values of some: where these have hidden states, all that is on their grid is free, too, and
    so are the hidden states' starts."""
    every = list(what.all)
    names = [every[i].effect.name for i in fitted] + [use.name for use in vehicle.effects]
    if not any(has_states(catalogue[name]) for name in names):
        return what
    for number, values in fitted.items():
        candidate = every[number]
        if has_states(candidate.effect):
            grid = [name for name in candidate.effect.refine if name not in candidate.free]
            at = {**candidate.at, **{name: values[name] for name in grid if name in values}}
            free = (*candidate.free, *grid)
            every[number] = Candidate(candidate.effect, candidate.rotor, at, free, candidate.present)
    starts = _starts(FlightModel(vehicle, fitted_uses(vehicle, every, fitted), catalogue))
    return replace(what, all=tuple(every), columns=_columns(every), nuisances=(*what.nuisances, *starts))


def fitted_uses(
    vehicle: Vehicle, every: Sequence[Candidate], fitted: Mapping[int, Mapping[str, float]]
) -> list[EffectUse]:
    """The vehicle file's effects with the candidates that are fitted."""
    used = {(use.name, use.rotor): use for use in vehicle.effects}
    for number, values in fitted.items():
        candidate = every[number]
        used[candidate.identity] = EffectUse(candidate.effect.name, {**candidate.at, **values}, candidate.rotor)
    return list(used.values())


def _columns(every: Sequence[Candidate]) -> tuple[Column, ...]:
    return tuple(Column(i, name) for i, c in enumerate(every) for name in (c.free or ("",)))


def _starts(model: FlightModel) -> list[Nuisance]:
    """The starts of a model's hidden states."""
    starts = model.hidden.starts
    return [Nuisance("start", place, std, "part", name) for name, (place, std) in starts.items()]


def _is_followed(
    candidate: Candidate, vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment]
) -> bool:
    """Whether these logs' rate is high enough for a candidate's hidden states."""
    model = FlightModel(vehicle, [EffectUse(candidate.effect.name, dict(candidate.at), candidate.rotor)], catalogue)
    period = 1 / min(segment.rate for segment in segments)
    return model.hidden.is_followed(period, model.model.parameter_values)


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of the filter along a flight whose innovations are the flight's own, then their slopes in columns.

    B: (N, i, 1 + u) of the error state at a row's end. D: (N, m, 1 + u) of the readings. used: (u,) numbers of the
    columns; all others have none.
    """

    B: Floats
    D: Floats
    used: tuple[int, ...]

    def places(self, columns: Sequence[int]) -> list[int]:
        """Where some columns are, behind the flight's own."""
        return [1 + self.used.index(column) for column in columns]


def inputs(
    rows: FlightRows,
    along: Along,
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    uses: Sequence[EffectUse],
    what: Candidates,
    fitted: Mapping[int, Mapping[str, float]],
    only: Sequence[int] | None = None,
    starts: Starts = Starts(),
) -> Inputs:
    """A flight and a unit of each parameter as the filter takes them in.

    A slope of the innovations counts as -d nu / d parameter, so that nu less slopes times parameters is what is left.
    uses: effects of the model along which it is linear. fitted: values of candidates that are in it, by number.
    only: candidates of which columns are chosen; those of others are left out. starts: of hidden states.
    """
    count = along.speed.shape[1]
    chosen = list(range(len(what.all)) if only is None else only)
    used = sorted(place for i in chosen for place in what.places(i))
    used += range(len(what.columns), what.width)
    at = {column: place for place, column in enumerate(used, 1)}
    acting, readings = np.zeros((len(rows), 6, 1 + len(used))), np.zeros((len(rows), 12 + count, 1 + len(used)))

    def set_outputs(columns: Sequence[int], slopes: Sequence[Floats]) -> None:
        for place, slope in zip([at[column] for column in columns], slopes, strict=True):
            acting[:, :, place] = slope[:, :6]
            for first, kind in enumerate(KINDS[:4]):
                readings[:, 3 * first : 3 * first + 3, place] = slope[:, OUTPUTS[kind]]
            speeds, age = slope[:, SPEEDS : SPEEDS + count], slope[:, SPEEDS + count, None]
            readings[:, 12:, place] = speeds - along.spin_up * age

    swinging = any(has_states(catalogue[use.name]) for use in uses)
    for layer in _layers(what, chosen, vehicle, catalogue):
        merged, free, columns = {(u.name, u.rotor): u for u in uses}, [], []
        for i in layer:
            candidate = what.all[i]
            values = {**candidate.at, **fitted.get(i, {})}
            merged[candidate.identity] = EffectUse(candidate.effect.name, values, candidate.rotor)
            free += [f"{candidate.key}.{name}" for name in candidate.free]
            columns += what.places(i)
        model = FlightModel(vehicle, list(merged.values()), catalogue)
        set_outputs(columns, _slopes(model, rows, along, starts.of(layer), free, through_states=swinging))
    for i in chosen:
        if what.all[i].effect.rotor_speed is not None:
            moved = np.einsum("tar,tr->ta", along.by_rotor, _moved_speeds(rows, along, what.all[i], i in fitted))
            for place in [at[column] for column in what.places(i)]:
                acting[:, :, place] += moved
                readings[:, 9:12, place] += moved[:, :3]
    unknown = {n.of: i for i, n in enumerate(what.nuisances, len(what.columns)) if n.kind == "start"}
    if unknown:
        own = FlightModel(vehicle, uses, catalogue)
        set_outputs([*unknown.values()], _slopes(own, rows, along, starts.of(()), [*unknown], through_states=True))
    first = 1 + len(used) - (what.width - len(what.columns))
    of_discrepancies = first + len(what.nuisances)
    errors = slice(first, of_discrepancies)
    _set_errors(what.nuisances, along, acting[:, :, errors], readings[:, :, errors])
    _set_discrepancies(
        what.discrepancies, rows, along, acting[:, :, of_discrepancies:], readings[:, :, of_discrepancies:]
    )
    B, D = over_rows(rows, acting, readings)
    np.negative(B, out=B)
    B[:, :, 0], D[:, :, 0] = along.defect, along.difference
    return Inputs(B, D, tuple(used))


def _moved_speeds(rows: FlightRows, along: Along, lag: Candidate, in_model: bool) -> Floats:
    """(N, rotors) change of the rotors' speeds by a unit of a lag, or by all of one of a fixed shape."""
    if lag.free or in_model:
        return np.zeros_like(along.speed) if along.lag is None else rows.slope_in_lag(along.lag)
    return rows.rotor_speed(lag.at[lag.effect.time_constants[0]]) - rows.rotor_speed(None)


def _set_errors(nuisances: Sequence[Nuisance], along: Along, acting: Floats, readings: Floats) -> None:
    """Set the inputs of the errors that every log has. acting: (N, 6, k). readings: (N, 12 + rotors, k)."""
    for column, nuisance in enumerate(nuisances):
        kind, place = nuisance.kind, nuisance.place
        if kind == "gyro":
            readings[:, 6 + place, column] = 1
        elif kind == "accelerometer":
            readings[:, 9 + place, column] = 1
        elif kind == "level":
            readings[:, 3 + place, column] = 1
        elif kind == "attitude_clock":
            readings[:, 3:6, column] = -along.rate
        elif kind == "clock":
            readings[:, 0:3, column] = -(along.force - GRAVITY * along.rotation[:, 2, :])
            readings[:, 3:6, column] = -along.rate
        elif kind == "rotor_clock":
            readings[:, 12:, column] = -along.spin_up
        elif kind in ("force", "turning"):
            motion = along.force if kind == "force" else along.turning
            acting[:, (3 if kind == "turning" else 0) + place, column] = motion[:, place] - motion[:, place].mean()
            readings[:, 9 + place, column] = acting[:, place, column] if kind == "force" else 0.0


def _set_discrepancies(
    discrepancies: Sequence[Discrepancy], rows: FlightRows, along: Along, acting: Floats, readings: Floats
) -> None:
    """Set the inputs of what no effect is. acting: (N, 6, k). readings: (N, 12 + rotors, k)."""
    first, values = 0, {of: of.along(rows, along) for of in dict.fromkeys(one.of for one in discrepancies)}
    for one in discrepancies:
        columns = slice(first, first + len(one))
        one.act(acting[:, :, columns], values[one.of], along)
        first = columns.stop
    readings[:, 9:12] = acting[:, :3]


def _slopes(
    model: FlightModel,
    rows: FlightRows,
    along: Along,
    starts: Mapping[str, float],
    free: Sequence[str],
    *,
    through_states: bool,
) -> list[Floats]:
    """(N, 19 + rotors) slopes of the model's outputs in each parameter, or start of hidden states; zero in those of
    effects whose hidden states cannot be followed along this flight.

    through_states: whether parameters act through hidden states, too; through those of effects that are neutral no
    parameter does.
    """
    hidden, driving = model.hidden, model.driving(rows, along.reference)
    path = model.hidden_path(rows, driving, starts)
    finite = np.isfinite(path).all(axis=0)
    lost = hidden.keys_of(np.asarray(~finite))
    path = np.where(finite, path, model.model.hidden_initial)
    named = [name for name in free if name not in hidden.starts]
    slopes = {}
    if named:
        slopes = dict(zip(named, model.parameter_slopes(rows, along, named, path).transpose(1, 0, 2), strict=True))
    followed = [name for name in free if name.split(".")[0] not in lost]
    moving = [name for name in followed if name not in slopes or (through_states and hidden.depends_on(name))]
    if moving:
        here = model.outputs(rows, along, path)
        slopes |= {name: model.hidden_slope(rows, along, driving, starts, name, here) for name in moving}
    none = np.zeros((len(rows), SPEEDS + along.speed.shape[1] + 1))
    return [slopes[name] if name in followed else none for name in free]


def over_rows(rows: FlightRows, acting: Floats, readings: Floats) -> tuple[Floats, Floats]:
    """Inputs (N, i, k) of a row's end and (N, m, k) of its mean readings: force and angular acceleration are constant
    over a row. acting: (N, 6, k). readings: (N, 12 + rotors, k), which are changed."""
    dt, force, turning = rows.period, acting[:, :3], acting[:, 3:]
    rotors = readings.shape[1] - 12 if "rotor_speed" in rows.readings else 0
    B = np.zeros((len(rows), 9 + 2 * rotors, acting.shape[2]))
    for states, values, factor in ((0, force, dt), (3, turning, dt**2 / 2), (6, turning, dt)):
        np.multiply(values, factor, out=B[:, states : states + 3])
    B[:, unread(rows.readings)] = 0.0
    early = turning if rotors else before_reading(turning)
    for place, values, factor in ((0, force, dt / 2), (3, early, dt**2 / 6), (6, early, dt / 2)):
        readings[:, place : place + 3] += factor * values
    used = [3 * i + axis for i, kind in enumerate(KINDS[:4]) if kind in rows.readings for axis in range(3)]
    used += range(12, 12 + rotors)
    return B, readings if len(used) == readings.shape[1] else np.ascontiguousarray(readings[:, used])


def _layers(
    what: Candidates, chosen: Sequence[int], vehicle: Vehicle, catalogue: Mapping[str, Effect]
) -> list[list[int]]:
    """Candidates in groups that one model can hold: each effect and rotor once, the wind's own drag beside no other."""
    layers: list[list[int]] = []
    dragless = not any(catalogue[use.name].resists_air for use in vehicle.effects)
    for i in chosen:
        effect, key = what.all[i].effect, what.all[i].key
        if effect.rotor_speed is not None:
            continue
        for layer in layers:
            if any(what.all[j].key == key for j in layer):
                continue
            own_drag = [what.all[j].effect.wind is not None for j in layer]
            resists = [what.all[j].effect.resists_air for j in layer]
            if dragless and ((effect.wind is not None and any(resists)) or (effect.resists_air and any(own_drag))):
                continue
            layer.append(i)
            break
        else:
            layers.append([i])
    return layers
