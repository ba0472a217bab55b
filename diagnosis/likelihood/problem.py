"""Flights with the noise's model: passes of the filter, the noise's fit, and sums from which sets are scored."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from diagnosis.likelihood.beginnings import beginning
from diagnosis.likelihood.columns import Candidates, Inputs, Starts, about, fitted_uses, has_states, inputs
from diagnosis.likelihood.features import Discrepancy
from diagnosis.likelihood.flight_rows import FlightRows, Reference
from diagnosis.likelihood.gain import Gain, NoiseSlopes, Plant
from diagnosis.likelihood.innovations import start
from diagnosis.likelihood.rigid_body import Along, FlightModel, moved_reference
from diagnosis.noise.component import hover
from diagnosis.selection.candidates import Candidate
from diagnosis.thresholds import DEFAULT, LikelihoodThresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle

FEW = 4  # flights of which the mean slope is hover's
TINY = 1e-9
BETWEEN = 17  # points between the neighbours of a grid's point


@dataclass(frozen=True, eq=False)
class Information:
    """Sums of a segment over blocks of time, of whitened innovations nu and of their slopes -X in the parameters.

    group: number of the flight. M: (blocks, k, k) sums of X' X. g: (blocks, k) sums of X' nu. squares: (blocks,) sums
    of nu' nu. count: readings in all blocks. rows: of them. log_likelihood: of all blocks.
    """

    group: int
    M: Floats
    g: Floats
    squares: Floats
    count: int
    rows: int
    log_likelihood: float


@dataclass(eq=False)
class Problem:
    """Flights, their model, and what may be missing in it.

    uses: effects of the model about which everything is linear. fitted: of these the candidates, by number.
    starts: of the hidden states, less hover's, by flight and name.
    """

    vehicle: Vehicle
    catalogue: Mapping[str, Effect]
    flights: Sequence[FlightRows]
    what: Candidates
    fitted: dict[int, dict[str, float]] = field(default_factory=dict)
    references: dict[int, Reference] = field(default_factory=dict)
    thresholds: LikelihoodThresholds = DEFAULT.likelihood
    starts: dict[int, dict[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._bare, self.what = self.what, about(self.what, self.vehicle, self.catalogue, self.fitted)
        self._beginnings: dict[Hashable, tuple[dict[str, float], float]] = {}

    def move_to(self, fitted: dict[int, dict[str, float]], starts: dict[int, dict[str, float]]) -> None:
        """The model about which all is linear becomes that with these values of candidates, by number, and these
        starts of hidden states, by flight and name; those that are new begin as they did as candidates."""
        fresh = [i for i in fitted if i not in self.fitted and has_states(self.what.all[i].effect)]
        along = [self.along(place) for place in range(len(self.flights))] if fresh else []
        nearest = {i: self._nearest(i, fitted[i], along) for i in fresh}
        self.fitted = fitted | {i: {**one.at, **fitted[i]} for i, one in nearest.items()}
        self.starts = {}
        for place in range(len(self.flights)):
            self.starts[place] = dict(starts.get(place, {}))
            for candidate in nearest.values():
                self.starts[place] |= self._begun(place, candidate, along[place], all_of_it=True)[0]
        self.what = about(self._bare, self.vehicle, self.catalogue, self.fitted)

    def with_discrepancies(self, discrepancies: Sequence[Discrepancy]) -> Problem:
        """Problem of these flights about these values, with some discrepancies among the columns."""
        made = replace(self, what=replace(self._bare, discrepancies=tuple(discrepancies)))
        made._beginnings = self._beginnings
        return made

    def of(self, flights: Sequence[FlightRows]) -> Problem:
        """Other flights of the same kind of logs, with nothing fitted and no discrepancies."""
        bare = replace(self._bare, discrepancies=())
        return replace(self, flights=flights, what=bare, fitted={}, references={}, starts={})

    @property
    def uses(self) -> list[EffectUse]:
        """The vehicle file's effects with the candidates that are fitted."""
        return fitted_uses(self.vehicle, self.what.all, self.fitted)

    def plant(self) -> Plant:
        """The rigid body about hover."""
        rows = self.flights[0]
        conditions = hover(self.vehicle, rows.period, rows.segment.rate, rows.segment.rate)
        model = FlightModel(self.vehicle, self.uses, self.catalogue)
        some = range(min(FEW, len(self.flights)))
        along = [model.along(self.flights[i], self.reference(i), conditions.specific_force) for i in some]
        slope = np.mean([one.slope.mean(0) for one in along], axis=0)
        slope[:, 3:6] = 0.0  # its mean over headings
        slope[np.abs(slope) < TINY] = 0.0
        by_rotor = np.mean([one.by_rotor.mean(0) for one in along], axis=0)
        return Plant(conditions, slope, by_rotor, rows.readings)

    def reference(self, place: int) -> Reference:
        """The present reference of a flight: its own readings, until a pass has predicted better ones."""
        if place not in self.references:
            self.references[place] = self.flights[place].measured_reference()
        return self.references[place]

    def along(self, place: int) -> Along:
        """The model along a flight about its reference."""
        lift = np.array([0.0, 0.0, GRAVITY])
        model = FlightModel(self.vehicle, self.uses, self.catalogue)
        return model.along(self.flights[place], self.reference(place), lift, self.starts.get(place))

    def relinearise(self, gain: Gain, places: Iterable[int] | None = None) -> None:
        """The reference of each flight, or of some, becomes what the filter predicts from earlier rows."""
        for place in range(len(self.flights)) if places is None else places:
            along = self.along(place)
            _, states = start(gain, 1).advance(along.model, *data(along), path=True)
            self.references[place] = moved_reference(along.reference, states)

    def inputs(self, place: int, along: Along, only: Sequence[int] | None = None) -> Inputs:
        """Of a flight, of candidates, all or some, and of nuisances along it."""
        what = self.what
        chosen = [i for i in (range(len(what.all)) if only is None else only) if i not in self.fitted]
        begun = {i: self._beginning(place, i, along) for i in chosen if has_states(what.all[i].effect)}
        starts, model = Starts(self.starts.get(place, {}), begun), (self.vehicle, self.catalogue, self.uses)
        return inputs(self.flights[place], along, *model, what, self.fitted, only, starts)

    def _beginning(self, place: int, number: int, along: Along) -> dict[str, float]:
        """Where the hidden states of a candidate begin in a flight."""
        return self._begun(place, self.what.all[number], along)[0]

    def _begun(
        self, place: int, candidate: Candidate, along: Along, *, all_of_it: bool = False
    ) -> tuple[dict[str, float], float]:
        key = _key(place, candidate), all_of_it
        if key not in self._beginnings:
            model = candidate, self.uses, self.vehicle, self.catalogue
            self._beginnings[key] = beginning(*model, self.flights[place], along, all_of_it=all_of_it)
        return self._beginnings[key]

    def _nearest(self, number: int, fitted: Mapping[str, float], along: Sequence[Along]) -> Candidate:
        """A candidate at the point between those of its grid that leaves least of the specific force, unless its
        fitted values have one.

        A swing's phase has several best lengths, of which the linear model knows the nearest.
        """
        candidate = self.what.all[number]
        for name in candidate.effect.refine:
            grid = [c.at[name] for c in self.what.all if c.identity == candidate.identity]
            low = max((v for v in grid if v < candidate.at[name]), default=candidate.at[name])
            high = min((v for v in grid if v > candidate.at[name]), default=candidate.at[name])
            points = [fitted[name]] if name in fitted else np.linspace(low, high, BETWEEN).tolist()
            near = [replace(candidate, at={**candidate.at, name: v}) for v in points]
            left = [
                sum(self._begun(place, one, here, all_of_it=True)[1] for place, here in enumerate(along))
                for one in near
            ]
            candidate = near[int(np.argmin(left))]
        return candidate

    def information(self, gain: Gain, noise: NoiseSlopes, only: Sequence[int] | None = None) -> list[Information]:
        """Each flight's sums; the noise's hyperparameters are the last columns."""
        made, inverse = [], np.linalg.inv(gain.whitening)
        for place, rows in enumerate(self.flights):
            along = self.along(place)
            own = self.inputs(place, along, only)
            white, states = start(gain, own.B.shape[2]).advance(along.model, own.B, own.D, path=True)
            moved = noise.inputs(states, white[:, :, 0] @ inverse.T)
            by_noise, _ = start(gain, len(noise.V)).advance(along.model, *moved)
            made.append(self._summed(rows, own.used, white, by_noise, gain, noise))
        return made

    def _summed(
        self, rows: FlightRows, used: Sequence[int], white: Floats, by_noise: Floats, gain: Gain, noise: NoiseSlopes
    ) -> Information:
        """Of innovations and their slopes in the used columns (N, m, 1 + u), and in the noise's values (N, m, h)."""
        first, length = int(self.thresholds.burn_in / rows.period), max(1, int(self.thresholds.block / rows.period))
        begins, width, H = range(first, len(white), length), self.what.width, len(noise.V)
        M, g = np.zeros((len(begins), width + H, width + H)), np.zeros((len(begins), width + H))
        squares, counted, columns = np.zeros(len(begins)), 0, np.array(used, dtype=int)
        for place, begin in enumerate(begins):
            part, moved = (x[begin : begin + length] for x in (white, by_noise))
            own, other = part.reshape(-1, part.shape[2]), moved.reshape(-1, H)
            sums, across = own.T @ own, own.T @ other
            squares[place], g[place, columns] = sums[0, 0], sums[0, 1:]
            M[place][np.ix_(columns, columns)] = sums[1:, 1:]
            M[place, columns, width:], M[place, width:, columns] = -across[1:], -across[1:]
            M[place, width:, width:] = other.T @ other + noise.information(len(part))
            g[place, width:] = noise.score(part[:, :, 0]) - across[0]
            counted += len(part)
        likelihood = -(squares.sum() + counted * gain.log_determinant) / 2  # but for a constant
        return Information(rows.group, M, g, squares, counted * white.shape[1], counted, float(likelihood))


def _key(place: int, candidate: Candidate) -> Hashable:
    """Of a candidate's beginning in a flight."""
    return place, candidate.key, tuple(candidate.at.items())


def data(along: Along) -> tuple[Floats, Floats]:
    """Inputs of the filter by which a pass gives a flight's own innovations."""
    return np.ascontiguousarray(along.defect[:, :, None]), np.ascontiguousarray(along.difference[:, :, None])
