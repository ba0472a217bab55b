"""Which effects are missing: the noise's fit, then sets by evidence, each time linear about the last answer."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.likelihood.evidence import IMPOSSIBLE, Kind, Scored, Search, present
from diagnosis.likelihood.noise_fit import NoiseFit, fit_noise, likeliest, structures_of
from diagnosis.likelihood.problem import Problem
from diagnosis.models.free_start import moved_start
from dynamics.arrays import Floats
from dynamics.progress import Progress, no_progress


@dataclass(frozen=True, eq=False)
class Identified:
    """The best set about its own values. problems, noise: of each kind of logs."""

    problems: tuple[Problem, ...]
    noise: tuple[NoiseFit, ...]
    search: Search
    best: Scored
    chi_square: float


def identify(
    problems: Sequence[Problem],
    structures: Sequence[str] | None = None,
    progress: Progress = no_progress,
    *,
    one_of: Collection[int] | None = None,
    fixed_set: Sequence[int] | None = None,
    begin: Sequence[NoiseFit] = (),
) -> Identified:
    """The best set of effects.

    problems: of the same candidates, one for each kind of logs. structures: of the noise, among which the likelihood
    decides; by default all that a kind may have. one_of: numbers of candidates of which one at most is there,
    beside corrections of the vehicle file's own effects. fixed_set: numbers of the candidates of a set whose values
    are sought instead; if these are impossible, so is what is returned. begin: noise of each kind near its best.
    """
    t = problems[0].thresholds
    progress(0.0, "the noise of the flights")
    if begin:
        noises = [fit_noise(one, n.structure, values=n.values) for one, n in zip(problems, begin, strict=True)]
    else:
        noises = [likeliest(one, structures or structures_of(one.flights[0].segment)) for one in problems]
    members: tuple[int, ...] = ()
    step, refitted = 0.0, False
    for number in range(t.rounds):
        progress(0.4 + 0.6 * number / t.rounds, "the effects that explain what is left")
        kinds = [_informed(one, noise, first=number == 0) for one, noise in zip(problems, noises, strict=True)]
        settled = refitted and (step < t.near or number == t.rounds - 1)
        search = Search(kinds, settled=settled, one_of=one_of)
        best = search.best(members) if fixed_set is None else search.score(fixed_set)
        if best.evidence == IMPOSSIBLE:
            break
        values = search.named_values(best)
        step = value_step(search, best)
        same = set(best.members) == set(members)
        members = best.members
        if (same and step < t.settled_step and settled) or number == t.rounds - 1:
            break
        fitted = values | command_values(search, best)
        refit = not refitted and (number == t.settled_rounds - 1 or (same and not fitted))  # the model is at rest
        for place, problem in enumerate(problems):
            problem.move_to(fitted, starts_of(kinds[place], search, best))
            fitted = problem.fitted
            if refit:
                noise = noises[place]
                noises[place] = fit_noise(problem, noise.structure, values=noise.values, only=members)
        refitted = refitted or refit
    sums = [part for kind in kinds for part in kind.information]
    chi_square = sum(part.squares.sum() for part in sums) / sum(part.count for part in sums)
    return Identified(tuple(problems), tuple(noises), search, best, float(chi_square))


def _informed(problem: Problem, noise: NoiseFit, *, first: bool) -> Kind:
    """The sums of one kind of logs, about what its filter predicts."""
    for _ in range(1 + first):
        problem.relinearise(noise.gain)
    return Kind(problem, problem.information(noise.gain, noise.slopes), noise.slopes)


def command_values(search: Search, scored: Scored) -> dict[int, dict[str, float]]:
    """Values of what lies between command and thrust, beside a set."""
    problem, what, own = search.problem, search.what, search.what.of_commands
    change = search.total.of_commands(search.places(scored), scored.values, len(own))
    made = {}
    for place, value in zip(own, present(problem)[own] + change, strict=True):
        number = what.columns[place].candidate
        name = what.columns[place].name
        made[number] = {name: what.all[number].at[name] + float(value)}
    return made


def starts_of(kind: Kind, search: Search, best: Scored) -> dict[int, dict[str, float]]:
    """Where hidden states begin in each part of a flight beside a set's values: their most probable offsets from hover,
    a step from the present ones."""
    problem, what = kind.problem, kind.problem.what
    own = [i for i, n in enumerate(what.nuisances) if n.kind == "start"]
    if not own:
        return {}
    change, made, places = -present(problem), {}, search.places(best)
    change[places] += best.values
    commands = what.of_commands
    change[commands] = search.total.of_commands(places, best.values, len(commands))
    lasting = [i for i, n in enumerate(what.nuisances) if n.lasts != "block"]
    columns = [len(what.columns) + i for i in lasting]
    std = np.array([what.nuisances[i].std for i in lasting])
    for place, part in enumerate(kind.information):
        begun = problem.starts.get(place, {})
        now = np.array([begun.get(what.nuisances[i].of, 0.0) for i in lasting])
        M, g = part.M.sum(0), part.g.sum(0)
        left = g[columns] - M[columns, : len(change)] @ change - now / std**2
        step = np.linalg.solve(M[np.ix_(columns, columns)] + np.diag(std**-2.0), left)
        after = moved_start(now, step, std)
        made[place] = {what.nuisances[i].of: float(v) for i, v in zip(lasting, after, strict=True) if i in own}
    return made


def value_step(search: Search, best: Scored) -> float:
    """Largest change of a value since the last round, in its standard deviations."""
    places = search.places(best)
    if not places:
        return 0.0
    change = best.values - search.total.now[places]
    return float(np.max(np.abs(change) / np.sqrt(np.diag(best.covariance))))


def deviations(search: Search, best: Scored) -> Floats:
    """(c,) standard deviations: the larger of the likelihood's and of the blocks' scatter (a sandwich)."""
    places = search.places(best)
    if not places:
        return np.zeros(0)
    total = search.total
    scores = total.g_blocks[:, places] - np.einsum("bij,j->bi", total.M_blocks[:, places][:, :, places], best.values)
    H = best.covariance
    sandwich = H @ (scores.T @ scores) @ H
    return np.asarray(np.sqrt(np.maximum(np.diag(H), np.diag(sandwich))))
