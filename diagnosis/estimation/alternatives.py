"""Alternatives to selected effects that the full model decides on the fitted flights: rotors, pairs, rivals.

The search decides by columns that are linear about one fit, and that turbulence does not reach.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.evaluation import reduced_chi_square, residuals_in
from diagnosis.estimation.refusal import Refused
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.rivals import akin, declared_alike, near_rivals, rivals_of, to_fit
from diagnosis.selection.search import IMPOSSIBLE, Search, Set
from dynamics.vehicle import Vehicle

Pair = tuple[Candidate, Candidate]


def on_decided_rotors(regression: Regression, chosen: Sequence[Candidate], vehicle: Vehicle) -> list[Candidate]:
    """The selected effects, those of one rotor on the rotor with which the full model fits best.

    The search decides by columns that turbulence does not reach; the torque that a weak rotor lost and a cant of the
    same one then share what is the cant of another. The fitted flights alone decide, among rotors of a similar score.
    """
    limits, search, best = regression.thresholds, Search(regression), list(chosen)
    required = limits.rivals.score_margin / max(regression.total, 1)
    for place in [i for i, c in enumerate(chosen) if c.effect.per_rotor]:
        others, keys = [c for i, c in enumerate(best) if i != place], {c.key for c in best}
        alike = [c for c in regression.candidates if c.effect is best[place].effect and c.key not in keys]
        alone, own = search.score(others).score, search.score(best).score
        lowest = alone + limits.search.min_contender_share * (own - alone)
        near = sorted(
            (s for s in search.scores([(*others, c) for c in alike]) if s.score >= lowest), key=lambda s: -s.score
        )
        for scored in near[: limits.acceptance.max_rivals]:
            trial = [*best[:place], scored.candidates[-1], *best[place + 1 :]]
            level = fit(regression, best, vehicle=vehicle).chi_square
            if fit(regression, trial, vehicle=vehicle, level=level, goal=level).chi_square < level - required:
                best = trial
    return best


def merged_pairs(regression: Regression, chosen: Sequence[Candidate], vehicle: Vehicle) -> list[Candidate]:
    """The selected effects, pairs replaced by one effect where the full model fits as well with it.

    A rotor that lost thrust is also one whose speed is misread beside another one that lost torque, and a drag at the
    rotors a drag of the body beside a damping. What either is beyond linear decides by the columns; the fit decides by
    the penalty of the coefficients that are saved.
    """
    search, best = Search(regression), list(chosen)
    while (merged := _merged_pair(regression, search, best, vehicle)) is not None:
        best = merged
    return best


def _merged_pair(
    regression: Regression, search: Search, chosen: list[Candidate], vehicle: Vehicle
) -> list[Candidate] | None:
    trials, level = _for_pairs(search, chosen), 0.0
    for pair, candidates in trials:
        level = level or fit(regression, chosen, vehicle=vehicle).chi_square
        saved = (sum(map(search.penalty, pair)) - search.penalty(candidates[-1])) / regression.total
        trial = fit(regression, candidates, vehicle=vehicle, level=level, goal=level + saved)
        if not trial.unsettled and trial.chi_square - level < saved:
            return list(candidates)
    return None


def _for_pairs(search: Search, chosen: list[Candidate]) -> list[tuple[Pair, Set]]:
    """Sets with one effect in place of two: of two that act alike one of theirs, of others one that is like either.

    What is like one of two must lose less than what the weaker one adds.
    """
    limits, own, sets = search.regression.thresholds, search.score(chosen).gain, list[tuple[Pair, Set]]()
    share = 1.0 - limits.search.min_contender_share
    added = {c.key: own - search.score([o for o in chosen if o is not c]).gain for c in chosen}
    for pair in itertools.combinations(chosen, 2):
        one, other = pair
        rest = [c for c in chosen if c is not one and c is not other]
        width, names, alike = len(one.columns) + len(other.columns), {one.effect.name, other.effect.name}, _alike(*pair)
        new = names - {c.effect.name for c in rest} if alike else _like_either(search, pair, chosen)
        some = [c for c in search.regression.candidates if c.effect.name in new and len(c.columns) < width]
        trials = search.scores([(*rest, c) for c in some if c is not one and c is not other])
        loss = share * (own - search.score(rest).gain) if alike else min(added[c.key] for c in pair)
        near = sorted((s for s in trials if s.score > IMPOSSIBLE and s.gain >= own - loss), key=lambda s: -s.score)
        sets += [(pair, scored.candidates) for scored in near[: limits.acceptance.max_rivals]]
        if one.rotor is not None and one.rotor == other.rotor:  # they may cancel, whatever columns about them say
            sets += [(pair, (*rest, c)) for c in pair]
    return sets


def _like_either(search: Search, pair: Pair, chosen: Sequence[Candidate]) -> set[str]:
    """Effects that are not chosen, and that the catalogue declares to look like one of two, or that are drags, too."""
    taken = {c.effect.name for c in chosen}
    free = [c for c in search.regression.candidates if c.effect.name not in taken]
    return {c.effect.name for c in free for one in pair if akin(c, one)}


def _alike(one: Candidate, other: Candidate) -> bool:
    """Whether both act on single rotors, or the catalogue declares that they look alike."""
    return declared_alike(one, other) or (one.effect.per_rotor and other.effect.per_rotor)


def decided_rivals(
    regression: Regression, chosen: Sequence[Candidate], vehicle: Vehicle
) -> tuple[list[Candidate], list[Refused]]:
    """The selected effects, the leading ones in favour of near rivals with which the full model fits clearly better.

    To the linear regression a wrong mass and a wrong thrust constant are the same; beside a strong drag they are not.
    The fitted flights alone decide.
    """
    thresholds = regression.thresholds.acceptance
    search, best, refused, level = Search(regression), list(chosen), list[Refused](), 0.0

    def chi_square(candidates: Sequence[Candidate], of_best: float = math.inf) -> float:
        fitted = fit(regression, candidates, vehicle=vehicle, level=of_best, goal=of_best)
        return reduced_chi_square(residuals_in(regression, fitted.vehicle, regression.segments), regression.noise)

    for place in range(len(chosen)):
        explained = place >= thresholds.leading and (level or chi_square(best)) < regression.explained
        if explained:
            break
        others = [c for i, c in enumerate(best) if i != place]
        near = near_rivals(search, others, rivals_of(search, others, best[place]))
        trials = [s.candidates[-1] for s in to_fit(near, best[place], thresholds.max_rivals)]
        level = level or (chi_square(best) if trials else 0.0)
        if level >= regression.explained:
            trials += [kin for kin in _drags(search, others, best[place]) if kin not in trials]
        for rival in trials:
            trial = [*best[:place], rival, *best[place + 1 :]]
            trial_level = chi_square(trial, level)
            if thresholds.max_redundant_ratio * trial_level < level:
                numbers = {"chi_square": level, "of_rival": trial_level}
                refused.append(Refused(best[place].effect.name, best[place].rotor, "worse_than_rival", numbers))
                best, level = trial, trial_level
    return best, refused


def _drags(search: Search, others: Sequence[Candidate], chosen: Candidate) -> list[Candidate]:
    """The other drags in place of one, those too that the columns hold for impossible.

    Columns are linear about the vehicle that the search began with. Beside a centre of mass that is off and canted
    rotors what a drag at the rotors adds to the moments is another thing, and its coefficient may come out negative.
    """
    taken = {chosen.effect.name, *(c.effect.name for c in others)}
    return [
        c
        for c in search.regression.candidates
        if c.effect.resists_air and chosen.effect.resists_air and c.effect.name not in taken
    ]
