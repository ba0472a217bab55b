"""Which effects are missing: the noise's fit, then sets by evidence, each time linear about the last answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.likelihood.evidence import Scored, Search, present
from diagnosis.likelihood.noise_fit import NoiseFit, fit_noise, likeliest, structures_of
from diagnosis.likelihood.problem import Problem
from dynamics.arrays import Floats
from dynamics.progress import Progress, no_progress


@dataclass(frozen=True, eq=False)
class Identified:
    """The best set about its own values."""

    noise: NoiseFit
    search: Search
    best: Scored
    chi_square: float


def identify(problem: Problem, structures: Sequence[str] | None = None, progress: Progress = no_progress) -> Identified:
    """The best set of effects. structures: of the noise, among which the likelihood decides; by default all."""
    t = problem.thresholds
    progress(0.0, "the noise of the flights")
    noise = likeliest(problem, structures or structures_of(problem.flights[0].segment))
    members: tuple[int, ...] = ()
    for number in range(t.rounds):
        progress(0.4 + 0.6 * number / t.rounds, "the effects that explain what is left")
        problem.relinearise(noise.gain)
        if number == 0:
            problem.relinearise(noise.gain)
        information = problem.information(noise.gain, noise.slopes)
        settled = number >= t.settled_rounds
        search = Search(problem, information, noise.slopes, settled=settled)
        best = search.best(members)
        values = search.named_values(best)
        step = _step(problem, search, best)
        chi = sum(i.squares.sum() for i in information) / sum(i.count for i in information)
        same = set(best.members) == set(members)
        members = best.members
        if (same and step < t.settled_step and settled) or number == t.rounds - 1:
            break
        problem.fitted = values | command_values(search, best)
        if number == t.settled_rounds - 1:
            noise = fit_noise(problem, noise.structure, values=noise.values, only=members)
    return Identified(noise, search, best, float(chi))


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


def _step(problem: Problem, search: Search, best: Scored) -> float:
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
