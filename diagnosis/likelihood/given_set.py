"""Values and intervals of a set of effects that is given: of an effect that is added, of a vehicle file's numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.likelihood.evidence import IMPOSSIBLE, Kind, Search
from diagnosis.likelihood.identify import command_values, deviations, starts_of, value_step
from diagnosis.likelihood.noise_fit import fit_noise, likeliest, structures_of
from diagnosis.likelihood.problem import Problem
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.vehicle import EffectUse


@dataclass(frozen=True, eq=False)
class SetFit:
    """A set about its own values.

    values: by (effect's key, parameter), by all of the likelihood. deviations: (c,) of them in this order, by the share
    of the likelihood that counts as evidence, as an answer states them.
    """

    search: Search
    members: tuple[int, ...]
    values: Mapping[tuple[str, str], float]
    deviations: Floats


def fit_set(problems: Sequence[Problem], members: Sequence[int]) -> SetFit:
    """Fit the noise, then the set's values, each round linear about the last one's.

    problems: of the same candidates, one for each kind of logs. members: numbers of the set's candidates.
    Raises DataError where the values that fit best are physically impossible.
    """
    t, what = problems[0].thresholds, problems[0].what
    noises = [likeliest(one, structures_of(one.flights[0].segment)) for one in problems]
    step, settled = 0.0, False
    for number in range(t.rounds):
        kinds, last = [], settled
        settled = number >= t.settled_rounds and (step < t.near or number == t.rounds - 1)
        for place, problem in enumerate(problems):
            if number == t.settled_rounds:
                noise = noises[place]
                noises[place] = fit_noise(problem, noise.structure, values=noise.values, only=members)
            for _ in range(1 + (number == 0)):
                problem.relinearise(noises[place].gain)
            information = problem.information(noises[place].gain, noises[place].slopes)
            kinds.append(Kind(problem, information, noises[place].slopes))
        search = Search(kinds, settled=settled)
        scored = search.score(members)
        if scored.evidence == IMPOSSIBLE:
            names = ", ".join(what.all[i].key for i in members)
            raise DataError(
                f"the values of {names} that fit these flights best are physically impossible. Leave one out, or fly "
                "what shows them apart."
            )
        values, step = search.named_values(scored), value_step(search, scored)
        fitted = values | command_values(search, scored)
        for problem, kind in zip(problems, kinds, strict=True):
            problem.move_to(fitted, starts_of(kind, search, scored))
            fitted = problem.fitted
        if settled and last:
            break
    places = search.places(scored)
    precision = search.coarse.M[np.ix_(places, places)] + np.diag(search.std[places] ** -2.0)
    own = np.sqrt(np.diag(np.linalg.inv(precision)))
    by_name = {(what.all[i].key, name): value for i, each in values.items() for name, value in each.items()}
    return SetFit(search, scored.members, by_name, np.maximum(own, deviations(search, scored)))


def nearest_members(problem: Problem, uses: Sequence[EffectUse]) -> list[int]:
    """Numbers of the candidates of some effects, each at the grid point that is nearest an effect's values.

    Raises DataError for one that these flights cannot show.
    """
    members = []
    for use in uses:
        own = [i for i, c in enumerate(problem.what.all) if c.identity == (use.name, use.rotor)]
        if not own:
            raise DataError(f"these flights cannot show {use.label}. Leave it out, or log what it acts on.")
        members.append(min(own, key=lambda i: _distance(problem, i, use)))
    return members


def _distance(problem: Problem, number: int, use: EffectUse) -> float:
    candidate = problem.what.all[number]
    held = [name for name in candidate.at if name not in candidate.free]
    return sum(abs(candidate.at[name] - use.parameters[name]) / (abs(use.parameters[name]) + 1e-9) for name in held)
