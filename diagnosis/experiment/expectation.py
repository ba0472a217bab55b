"""Which intervals of the effects' parameters a manoeuvre lets expect, from the regressors that a fit would have.

The Fisher information of the instruments of the joint fit (`estimation.linear_rows`) along the planned motion, with
usual noise on the twelve channels and the parameters' priors: what the estimator would make of such a flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.estimation.linear_rows import LinearRows
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.visibility import can_show
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect, Span
from dynamics.errors import RequestError
from dynamics.references.flatness import ReferenceSamples
from dynamics.vehicle import Vehicle

RATE = 25.0  # Hz of the planned rows
EDGE = 0.5  # s before and after a lap, which the filters use up
TRIALS, TRIAL_PARAMETERS = (200, 400), 12_000  # least and most evaluations; these times parameters: some 10 s
# Standard deviation of a row of each channel at the regression's rate, of the size that flights of small quadrotors
# leave: accelerometer and pose acceleration, m/s^2; angular acceleration, rad/s^2; attitude rate, rad/s.
NOISE = np.repeat([0.3, 0.3, 2.0, 0.03], 3)


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


@dataclass(frozen=True, eq=False)
class _Plan:
    """Data of a fit along a plan: see `estimation.linear_rows.Fitted`."""

    vehicle: Vehicle
    catalogue: Mapping[str, Effect]
    segments: Sequence[Segment]
    thresholds: Thresholds


class Expectation:
    """Expected intervals of the parameters of some effects on a vehicle."""

    def __init__(
        self, vehicle: Vehicle, catalogue: Mapping[str, Effect], effects: Sequence[str], example: ReferenceSamples
    ) -> None:
        """effects: names of those that are to be shown; none for all that can be. example: a motion of the vehicle.

        Raises RequestError where none of them shows in any flight.
        """
        self._vehicle = vehicle
        segment = planned_segment(example, vehicle)
        shown = [e for e in catalogue.values() if not e.stochastic and can_show(e, [segment], vehicle, catalogue)]
        to_show = [e for e in shown if (e.name in effects if effects else _is_planned_for(e))]
        if not to_show:
            raise RequestError(
                f"no manoeuvre shows {', '.join(effects)} better than another one: leave it out of for=. Effects that "
                f"one can be planned for: {', '.join(e.name for e in shown)}."
            )
        names = [e.name for e in to_show]
        faults = [e for e in shown if e not in to_show and e.sensor_prior is not None]
        candidates = [c for e in (*to_show, *faults) for c in _candidates(e, vehicle)]
        plan = _Plan(vehicle, catalogue, [segment], DEFAULT)
        self._rows = [LinearRows(plan, group, vehicle) for group in _groups(candidates)]
        self._free = [free for rows in self._rows for free in rows.free]
        self._prior = np.array([_prior_deviation(c, name, vehicle) for c, name in self._free])
        owners = [c.effect.name for c, _ in self._free]
        self._weight = _weights(owners, names)
        healthy = {e.name for e in shown if e.sensor_prior is not None}
        # those that are named are fitted jointly; of a whole catalogue each with what it is confounded with
        fits = [(set(names), set(names))] if effects else [({e.name}, {e.name, *e.confounded_with}) for e in to_show]
        self._fits = [(_places(owners, own), _places(owners, joint | healthy)) for own, joint in fits]

    @property
    def trials(self) -> int:
        """As many evaluations as a search can afford: each takes longer for more parameters."""
        return int(np.clip(TRIAL_PARAMETERS // len(self._prior), *TRIALS))

    def gain(self, motion: ReferenceSamples, laps: float) -> float:
        """Mean of ln(prior / expected standard deviation) over the effects. motion: a lap and the edges about it."""
        return float(self._weight @ np.log(self._prior / self._deviations(motion, laps)))

    def intervals(self, motion: ReferenceSamples, laps: float) -> tuple[ExpectedInterval, ...]:
        """Expected intervals of the effects that are to be shown."""
        rows = zip(self._free, self._prior, self._deviations(motion, laps), self._weight, strict=True)
        return tuple(
            ExpectedInterval(f"{c.key}.{name}", _unit(c.effect, name), c.at[name], float(prior), float(std))
            for (c, name), prior, std, weight in rows
            if weight > 0
        )

    def _deviations(self, motion: ReferenceSamples, laps: float) -> Floats:
        """(k,) expected standard deviations of the free parameters after some laps."""
        segment = planned_segment(motion, self._vehicle)
        instruments = np.concatenate([rows.at(segment, _values(rows))[2] for rows in self._rows], axis=2)
        white = (instruments / NOISE[:, None] * self._prior).reshape(-1, len(self._prior))
        white = np.where(np.isfinite(white).all(axis=0), white, 0.0)  # what cannot be followed is not shown
        information = laps * (white.T @ white) + np.eye(len(self._prior))
        variance = np.ones(len(self._prior))
        for own, joint in self._fits:
            inverse = np.linalg.inv(information[np.ix_(joint, joint)])
            variance[own] = [inverse[i, i] for i in map(joint.index, own)]
        return np.asarray(self._prior * np.sqrt(variance))


def planned_segment(motion: ReferenceSamples, vehicle: Vehicle) -> Segment:
    """A planned motion as a segment of a flight with perfect sensors and rotors that follow their commands."""
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
    )


def lap_times(lap: float) -> Floats:
    """(n,) s of the rows of a lap, with the edges before and after it."""
    count = round((lap + 2 * EDGE) * RATE)
    return np.asarray(np.arange(count) / RATE - EDGE)


def _is_planned_for(effect: Effect) -> bool:
    """Whether a flight is planned for an effect that nobody named: not for faults of sensors, not for what depends on
    things that no log holds, not for what swings by itself, whose resonance would be sought."""
    unlogged = effect.excitation is not None and effect.excitation.unlogged
    return effect.moves_vehicle and not unlogged and not _swings(effect)


def _swings(effect: Effect) -> bool:
    return bool(effect.hidden) and effect.rotor_speed is None


def _candidates(effect: Effect, vehicle: Vehicle) -> list[Candidate]:
    """An effect at the vehicle's own values, or at usual ones; on each rotor where it acts on one."""
    grid = [] if effect.grid is None else list(effect.grid(vehicle, Span((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))))
    free = tuple(p.name for p in effect.parameters if not grid or p.name not in grid[0])
    candidates = []
    for rotor in range(vehicle.rotors.count) if effect.per_rotor else (None,):
        own = next((u for u in vehicle.effects if (u.name, u.rotor) == (effect.name, rotor)), None)
        present = None if own is None else {**effect.defaults(vehicle), **own.parameters}
        candidates.append(Candidate(effect, rotor, present or effect.defaults(vehicle), free, (), present))
    return candidates


def _values(rows: LinearRows) -> dict[str, float]:
    """Where a group is linearised, by the model's names."""
    return {f"{c.key}.{name}": c.at[name] for c, name in rows.free}


def _groups(candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Candidates that share a model: all but those that swing by themselves, whose motion the others would drive."""
    swinging = [c for c in candidates if _swings(c.effect)]
    return [[c for c in candidates if c not in swinging], *([c] for c in swinging)]


def _weights(effects: Sequence[str], shown: Sequence[str]) -> Floats:
    """(k,) weights of parameters, with the sum 1: every effect that is to be shown counts once, however many parameters
    and rotors it has. effects: (k,) names of the parameters' effects."""
    counts = {name: effects.count(name) for name in shown}
    return np.array([1 / (counts[name] * len(shown)) if name in counts else 0.0 for name in effects])


def _places(owners: Sequence[str], names: set[str]) -> list[int]:
    """Places of the parameters of some effects. owners: (k,) effect of each."""
    return [place for place, owner in enumerate(owners) if owner in names]


def _prior_deviation(candidate: Candidate, name: str, vehicle: Vehicle) -> float:
    """Standard deviation of a parameter before the flight: a healthy sensor's, else the effect's usual one."""
    parameter = next(p for p in candidate.effect.parameters if p.name == name)
    return candidate.effect.sensor_prior or parameter.prior(vehicle).std


def _unit(effect: Effect, name: str) -> str:
    return next(p.unit for p in effect.parameters if p.name == name)
