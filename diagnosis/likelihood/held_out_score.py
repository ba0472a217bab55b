"""How well a model predicts flights that nothing was fitted on: the log score of the filter's one-step predictions.

The log of the density that a model gave to what was then read is a strictly proper score: its expectation is greatest
for the truth (Gneiting and Raftery, Strictly proper scoring rules, prediction, and estimation, Journal of the American
Statistical Association 102, 2007). Of a flight of innovations nu with covariance V, with slopes X in its own nuisances
of prior precision P, it is

    -1/2 sum (nu' V^-1 nu + log det 2 pi V) + g' (M + P)^-1 g / 2 - log det(1 + P^-1 M) / 2,    M = sum X' V^-1 X

with g = sum X' V^-1 nu. A block of it counts by what it adds to that of the rows before it (Dawid, Statistical theory:
the prequential approach, Journal of the Royal Statistical Society A 147, 1984). Measured rotor speeds are given, as
commands are: nu and V are the other readings', about what the row's rotor speeds tell of them. How a controller moves
the rotors is no statement about the vehicle, and differs from flight to flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
import scipy

from diagnosis.data.segment import Segment
from diagnosis.likelihood.evidence import IMPOSSIBLE, Search, integrated
from diagnosis.likelihood.flight_rows import rows_by_kind
from diagnosis.likelihood.gain import Gain
from diagnosis.likelihood.identify import Identified, command_values
from diagnosis.likelihood.innovations import start
from diagnosis.likelihood.problem import Problem
from diagnosis.models.free_start import moved_start
from dynamics.arrays import Floats

MIN_BLOCKS = 2  # with which a difference has a deviation
PASSES = 2  # to predict a flight about its own predictions, as the first round of a search does


class HeldOutScore(msgspec.Struct, frozen=True):
    """Log score of one-step predictions on held-out flights, a second of flight.

    before, after: of the vehicle file, and with the named effects. Units of the readings are in both alike: their
        difference counts.
    gain, gain_std: the difference, and its standard deviation by the scatter of blocks of 2 s.
    chi_square: reduced, of the innovations after: 1 where the noise is as in the fitted flights.
    seconds: of flight that were judged.
    """

    before: float
    after: float
    gain: float
    gain_std: float
    chi_square: float
    seconds: float
    unit: str = "nats/s"


@dataclass(frozen=True)
class _Block:
    """A block of flight. log_score: what it adds to its flight's, nats. squares: of whitened innovations."""

    seconds: float
    log_score: float
    squares: float
    readings: int


def held_out_score(result: Identified, named: Sequence[int], segments: Sequence[Segment]) -> HeldOutScore | None:
    """Score of the vehicle file and of the file with the named effects, both with the fitted flights' noise.

    named: numbers of candidates. segments: held out; those of a kind of logs that was not fitted, and pieces that end
    before the filter has settled, are left out. None where less than two blocks are left, or no filter follows them.
    """
    try:
        before, after = (_blocks(result, _values(result.search, one), segments) for one in ((), named))
    except np.linalg.LinAlgError:
        return None
    if len(after) < MIN_BLOCKS:
        return None
    seconds = sum(block.seconds for block in after)
    change = np.array([b.log_score - a.log_score for a, b in zip(before, after, strict=True)])
    gain = float(change.sum() / seconds)
    scatter = change - gain * np.array([block.seconds for block in after])
    deviation = np.sqrt(len(after) / (len(after) - 1) * np.sum(scatter**2)) / seconds
    was, now = (sum(block.log_score for block in blocks) / seconds for blocks in (before, after))
    chi_square = sum(block.squares for block in after) / sum(block.readings for block in after)
    made = HeldOutScore(float(was), float(now), gain, float(deviation), float(chi_square), float(seconds))
    return made if np.isfinite([was, now, deviation, chi_square]).all() else None


def _values(search: Search, members: Sequence[int]) -> dict[int, dict[str, float]]:
    """Values of a set and, beside it, of what lies between command and thrust, as the fitted flights have them."""
    scored = search.score(members)
    if scored.evidence == IMPOSSIBLE:
        raise np.linalg.LinAlgError("the values of the named effects are impossible without the others of their set")
    return search.named_values(scored) | command_values(search, scored)


def _blocks(result: Identified, values: dict[int, dict[str, float]], segments: Sequence[Segment]) -> list[_Block]:
    """Blocks of all segments, in order, by a model with values of candidates."""
    limits, made = result.search.problem.thresholds, list[_Block]()
    flights = list(dict.fromkeys(segment.flight for segment in segments))
    kinds = zip(result.problems, result.noise, strict=True)
    fitted = {problem.flights[0].kind: (problem, noise.gain) for problem, noise in kinds}
    for rows in rows_by_kind(segments, [flights.index(s.flight) for s in segments], limits):
        settled = [one for one in rows if len(one) > int(limits.burn_in / one.period)]
        if rows[0].kind in fitted and settled:
            own, gain = fitted[rows[0].kind]
            problem = own.of(settled)
            problem.move_to(values, {})
            made += _scored(problem, gain)
    return made


def _scored(problem: Problem, gain: Gain) -> list[_Block]:
    """Blocks of a problem's flights. Where hidden states begin is sought first, if there are any."""
    flights = list(dict.fromkeys(rows.group for rows in problem.flights))
    begins = any(one.kind == "start" for one in problem.what.nuisances)
    made: list[_Block] = []
    for _ in range(problem.thresholds.rounds if begins else 1):
        for _ in range(PASSES):
            problem.relinearise(gain)
        made = []
        for flight in flights:
            places = [place for place, rows in enumerate(problem.flights) if rows.group == flight]
            made += FlightScore(problem, gain, places).blocks()
    return made


class FlightScore:
    """The log score of one flight, block by block. places: its parts among the problem's, in order."""

    def __init__(self, problem: Problem, gain: Gain, places: Sequence[int]) -> None:
        self._problem, self._gain, self._places = problem, gain, places
        self._whitening, self._log_determinant = _given_rotors(gain, problem)
        self._nuisances = problem.what.nuisances
        std = np.array([one.std for one in self._nuisances])
        lasts = [one.lasts for one in self._nuisances]
        block = [i for i, each in enumerate(lasts) if each == "block"]
        self._part = [i for i, each in enumerate(lasts) if each == "part"]
        self._flight = [i for i, each in enumerate(lasts) if each in ("flight", "always")]
        self._lasting, self._of_block = ([1 + i for i in some] for some in ([*self._flight, *self._part], block))
        self._block_std = std[block]
        self._std = np.concatenate([std[self._flight], np.tile(std[self._part], len(places))])
        begun = [problem.starts.get(place, {}).get(self._nuisances[i].of, 0.0) for place in places for i in self._part]
        self._begun = np.concatenate([np.zeros(len(self._flight)), begun])

    def blocks(self) -> list[_Block]:
        """Its blocks; the hidden states' starts move to where they are most probable."""
        size, made = len(self._std), list[_Block]()
        M, g, last = np.zeros((size, size)), np.zeros(size), (0.0, 0.0)
        for number, place in enumerate(self._places):
            first = len(self._flight) + number * len(self._part)
            own = [*range(len(self._flight)), *range(first, first + len(self._part))]
            for flat, seconds in self.parts(place):
                nu, X, inner = flat[:, 0], flat[:, self._lasting], flat[:, self._of_block]
                sums = inner.T @ inner, inner.T @ nu
                quadratic, log_determinant, change = integrated(*sums, self._block_std)
                slope = np.linalg.solve(sums[0] + np.diag(self._block_std**-2.0), inner.T @ X)
                M[np.ix_(own, own)] += X.T @ X - X.T @ inner @ slope
                g[own] += X.T @ (nu - inner @ change)
                here = integrated(M, g, self._std, self._begun)[:2]
                squares = float(nu @ nu) - quadratic - (here[0] - last[0])
                made.append(self._block_of(squares, log_determinant + here[1] - last[1], len(flat), seconds))
                last = here
        self._begin(integrated(M, g, self._std, self._begun)[2])
        return made

    def parts(self, place: int) -> list[tuple[Floats, float]]:
        """Whitened innovations and their slopes in the nuisances, (readings, 1 + k), of each block, and its seconds."""
        problem, rows, along = self._problem, self._problem.flights[place], self._problem.along(place)
        own = problem.inputs(place, along, [])
        white, _ = start(self._gain, own.B.shape[2]).advance(along.model, own.B, own.D)
        white = np.einsum("ij,tjk->tik", self._whitening, white, optimize=True)
        limits = problem.thresholds
        length = max(1, int(limits.block / rows.period))
        parts = [white[i : i + length] for i in range(int(limits.burn_in / rows.period), len(white), length)]
        return [(part.reshape(-1, part.shape[2]), len(part) * rows.period) for part in parts]

    def _block_of(self, squares: float, log_determinant: float, readings: int, seconds: float) -> _Block:
        noise = readings / len(self._whitening) * self._log_determinant + readings * np.log(2 * np.pi)
        return _Block(seconds, float(-(squares + noise + log_determinant) / 2), float(squares), readings)

    def _begin(self, change: Floats) -> None:
        """Move the starts by a step, as the fitted flights' do."""
        first = len(self._flight)
        for number, place in enumerate(self._places):
            begun = self._problem.starts.setdefault(place, {})
            for j, i in enumerate(self._part):
                at, std = first + number * len(self._part) + j, self._nuisances[i].std
                begun[self._nuisances[i].of] = float(moved_start(self._begun[at], change[at], std))


def _given_rotors(gain: Gain, problem: Problem) -> tuple[Floats, float]:
    """(m - rotors, m) from whitened innovations to those of the other readings where the row's rotor speeds are given,
    and the log of their covariance's determinant; all of them where no speeds were measured."""
    m = len(gain.V)
    rotors = problem.vehicle.rotors.count if "rotor_speed" in problem.flights[0].readings else 0
    order = [*range(m - rotors, m), *range(m - rotors)]
    cholesky = np.linalg.cholesky(gain.V[np.ix_(order, order)])
    whitening = scipy.linalg.solve_triangular(cholesky, np.linalg.inv(gain.whitening)[order], lower=True)
    return whitening[rotors:], float(2 * np.log(np.diag(cholesky)[rotors:]).sum())
