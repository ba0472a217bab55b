"""Values and intervals of a set of effects that is given: of an effect that is added, of a vehicle file's numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.likelihood.evidence import IMPOSSIBLE, Search
from diagnosis.likelihood.identify import deviations, identify
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
    result = identify(problems, fixed_set=members)
    search, scored, what = result.search, result.best, problems[0].what
    if scored.evidence == IMPOSSIBLE:
        names = ", ".join(what.all[i].key for i in members)
        raise DataError(
            f"the values of {names} that fit these flights best are physically impossible. Leave one out, or fly "
            "what shows them apart."
        )
    places = search.places(scored)
    precision = search.coarse.M[np.ix_(places, places)] + np.diag(search.std[places] ** -2.0)
    own = np.sqrt(np.diag(np.linalg.inv(precision)))
    values = search.named_values(scored)
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
        members.append(min(own, key=lambda i: problem.what.all[i].distance(use.parameters)))
    return members
