"""Which intervals of the effects' parameters a manoeuvre lets expect, by the score that a diagnosis of its log has.

The expected information of the likelihood's columns (`likelihood.columns`) along the planned motion, through the filter
of an autopilot's log with the noise's medians before any flight. Nuisances are marginalised, priors are the evidence's,
and the likelihood is coarsened as there (`likelihood.evidence`): such intervals a diagnosis of the log states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.likelihood.columns import Candidates, Column, candidates
from diagnosis.likelihood.evidence import Kind, prior_stds, sums
from diagnosis.likelihood.flight_rows import make_rows
from diagnosis.likelihood.gain import NoiseSlopes, make_gain
from diagnosis.likelihood.innovations import start
from diagnosis.likelihood.noise_fit import compose, structures_of
from diagnosis.likelihood.problem import Information, Problem
from diagnosis.selection.candidates import Candidate
from diagnosis.thresholds import DEFAULT
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.errors import RequestError
from dynamics.references.flatness import ReferenceSamples
from dynamics.vehicle import Vehicle

RATE = DEFAULT.likelihood.row_rate  # Hz of the planned rows
EDGE = DEFAULT.likelihood.burn_in  # s before a lap, in which the filter settles
TRIALS, TRIAL_PARAMETERS = (200, 400), 12_000  # least and most evaluations; these times parameters: some 10 s
NO_SLOPES = NoiseSlopes(
    np.zeros((1, 0)), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros((0, 1, 1)), np.zeros(0), np.zeros(0)
)


@dataclass(frozen=True)
class ExpectedInterval:
    """A parameter before and after a flight.

    name: with its effect, as in "rotor_drag.coefficient".
    usual: its usual value on such a vehicle. prior: standard deviation before any flight. std: after this one.
    """

    name: str
    unit: str
    usual: float
    prior: float
    std: float

    @property
    def effect(self) -> str:
        """Name of its effect."""
        return self.name.partition(".")[0].partition("[")[0]


class Expectation:
    """Expected intervals of the parameters of some effects on a vehicle."""

    def __init__(
        self, vehicle: Vehicle, catalogue: Mapping[str, Effect], effects: Sequence[str], example: ReferenceSamples
    ) -> None:
        """effects: names of those that are to be shown; none for all that can be. example: a motion of the vehicle.

        Raises RequestError where none of them shows in any flight.
        """
        self._vehicle, self._catalogue = vehicle, catalogue
        segment = planned_segment(example, vehicle)
        possible = candidates(vehicle, catalogue, [segment])
        shown = {c.effect.name: c.effect for c in possible.all}
        to_show = [e for e in shown.values() if (e.name in effects if effects else _is_planned_for(e))]
        if not to_show:
            raise RequestError(
                f"no manoeuvre shows {', '.join(effects)} better than another one: leave it out of for=. Effects that "
                f"one can be planned for: {', '.join(shown)}."
            )
        names = [e.name for e in to_show]
        self._what = _usual(possible, names, vehicle)
        self._fitted = {
            number: {c.effect.time_constants[0]: c.effect.defaults(vehicle)[c.effect.time_constants[0]]}
            for number, c in enumerate(self._what.all)
            if not c.free
        }
        problem = self._problem(segment, self._what)
        composition = compose(structures_of(segment)[0], problem.flights[0].readings)
        self._gain = make_gain(composition, composition.medians(vehicle), problem.plant())
        self._prior = prior_stds(self._what, vehicle, list(self._fitted))
        owners = [self._what.all[column.candidate].effect.name for column in self._what.columns]
        self._weight = _weights(owners, names)
        # those that are named are fitted jointly; of a whole catalogue each with what it is confounded with
        fits = [(set(names), set(names))] if effects else [({e.name}, {e.name, *e.confounded_with}) for e in to_show]
        self._fits = [(_places(owners, own), _places(owners, joint)) for own, joint in fits]

    @property
    def trials(self) -> int:
        """As many evaluations as a search can afford: each takes longer for more parameters."""
        return int(np.clip(TRIAL_PARAMETERS // len(self._prior), *TRIALS))

    def gain(self, motion: ReferenceSamples, laps: float) -> float:
        """Mean of ln(prior / expected standard deviation) over the effects. motion: a lap and the edges about it."""
        return float(self._weight @ np.log(self._prior / self._deviations(motion, laps)))

    def intervals(self, motion: ReferenceSamples, laps: float) -> tuple[ExpectedInterval, ...]:
        """Expected intervals of the effects that are to be shown."""
        return tuple(
            self._interval(column, float(prior), float(std))
            for column, prior, std in zip(self._what.columns, self._prior, self._deviations(motion, laps), strict=True)
        )

    def _interval(self, column: Column, prior: float, std: float) -> ExpectedInterval:
        candidate = self._what.all[column.candidate]
        name = column.name or candidate.effect.time_constants[0]
        unit = next(p.unit for p in candidate.effect.parameters if p.name == name)
        usual = {**candidate.effect.defaults(self._vehicle), **(candidate.present or {})}[name]
        return ExpectedInterval(f"{candidate.key}.{name}", unit, usual, prior, std)

    def _deviations(self, motion: ReferenceSamples, laps: float) -> Floats:
        """(k,) expected standard deviations of the parameters after some laps."""
        # n laps are the sum of n equal blocks: as many times the information of one, with its nuisances' precision
        nuisances = tuple(
            replace(n, std=n.std / np.sqrt(laps)) if n.lasts == "block" else n for n in self._what.nuisances
        )
        problem = self._problem(planned_segment(motion, self._vehicle), replace(self._what, nuisances=nuisances))
        information = self._information(problem)
        seconds = laps * information.rows / RATE
        share = laps / (1 + seconds / problem.thresholds.trusted)
        M = sums([Kind(problem, [information], NO_SLOPES)], settled=False, share=share).M
        variance = self._prior**2
        for own, joint in self._fits:
            inverse = np.linalg.inv(M[np.ix_(joint, joint)] + np.diag(self._prior[joint] ** -2.0))
            variance[own] = [inverse[i, i] for i in map(joint.index, own)]
        return np.asarray(np.sqrt(variance))

    def _problem(self, segment: Segment, what: Candidates) -> Problem:
        return Problem(self._vehicle, self._catalogue, [make_rows(segment, 0)], what, dict(self._fitted))

    def _information(self, problem: Problem) -> Information:
        """Expected sums of a lap: of the columns alone, since a model that is right leaves white innovations."""
        along, (rows,), t = problem.along(0), problem.flights, problem.thresholds
        own = problem.inputs(0, along)
        white, _ = start(self._gain, own.B.shape[2]).advance(along.model, own.B, own.D)
        white = white[:, :, 1:]
        white = np.where(np.isfinite(white).all(axis=(0, 1)), white, 0.0)  # what cannot be followed is not shown
        first, length = round(EDGE / rows.period), round(t.block / rows.period)
        parts = [white[i : i + length].reshape(-1, white.shape[2]) for i in range(first, len(white), length)]
        M = np.array([part.T @ part for part in parts])
        return Information(0, M, np.zeros(M.shape[:2]), np.zeros(len(M)), white.shape[1], len(white) - first, 0.0)


def planned_segment(motion: ReferenceSamples, vehicle: Vehicle) -> Segment:
    """A planned motion as a segment of an autopilot's log, with rotors that follow their commands."""
    force = np.zeros((len(motion.time), 3))
    force[:, 2] = motion.collective_thrust / vehicle.body.mass
    return Segment(
        flight="planned",
        start=float(motion.time[0]),
        rate=RATE,
        position=motion.position,
        velocity=motion.velocity,
        attitude=motion.attitude,
        gyro=motion.rate_body,
        specific_force=force,
        rotor_speed=motion.rotor_speed,
        rotor_source="speed_command",
        battery_ratio=None,
        pose_source="estimator",
    )


def lap_times(lap: float) -> Floats:
    """(n,) s of the rows of a lap, with the edge before it."""
    count = round((lap + EDGE) * RATE)
    return np.asarray(np.arange(count) / RATE - EDGE)


def _is_planned_for(effect: Effect) -> bool:
    """Whether a flight is planned for an effect that nobody named: not for faults of sensors, not for what depends on
    things that no log holds."""
    unlogged = effect.excitation is not None and effect.excitation.unlogged
    return effect.moves_vehicle and not unlogged and not (effect.hidden and effect.rotor_speed is None)


def _usual(possible: Candidates, names: Sequence[str], vehicle: Vehicle) -> Candidates:
    """Some effects' candidates, each at the grid point that is nearest its usual values."""
    best = dict[str, Candidate]()
    for candidate in possible.all:
        if candidate.effect.name in names:
            usual = candidate.effect.defaults(vehicle)
            best[candidate.key] = min(best.get(candidate.key, candidate), candidate, key=lambda c: c.distance(usual))
    columns = tuple(Column(i, name) for i, c in enumerate(best.values()) for name in (c.free or ("",)))
    return Candidates(tuple(best.values()), columns, possible.nuisances)


def _weights(effects: Sequence[str], shown: Sequence[str]) -> Floats:
    """(k,) weights of parameters, with the sum 1: every effect that is to be shown counts once, however many parameters
    and rotors it has. effects: (k,) names of the parameters' effects."""
    counts = {name: effects.count(name) for name in shown}
    return np.array([1 / (counts[name] * len(shown)) if name in counts else 0.0 for name in effects])


def _places(owners: Sequence[str], names: set[str]) -> list[int]:
    """Places of the parameters of some effects. owners: (k,) effect of each."""
    return [place for place, owner in enumerate(owners) if owner in names]
