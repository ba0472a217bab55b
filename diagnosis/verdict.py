"""What is said of a selection and a fit: effects with their rivals, the verdict, what was not excited."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.estimation.equation_error import Estimate, Fit
from diagnosis.estimation.evaluation import floor_norms, held_out_floor
from diagnosis.models import channels
from diagnosis.report import ChannelError, FoundEffect, ParameterValue, Verdict
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.residual_tests import Leftover
from diagnosis.selection.rivals import near_rivals, rivals_of
from diagnosis.selection.search import MIN_GAIN, Scored, Search, Selection
from dynamics.arrays import Floats
from dynamics.effect import Parameter
from dynamics.vehicle import Vehicle

RESAMPLES = 40
MAX_SET = 2  # effects that are named as not told apart; a third is as near as they are, and says no more
# Beyond these something is left; a share of what was there before is the effects' own imperfect form.
LEFT_AGREEMENT, LEFT_LEARNABLE, LEFT_LINE = 5.5, 0.01, 10.0
LEFT_MISFIT = 1.5
SWINGING_LINE = 30.0  # beside what swings by itself, whose phase is lost on wild flights
LEFT_SHARE = 0.03
GUST_LEARNABLE = 0.35  # of a gust's gain that may be learned from the state at most


def found_effects(regression: Regression, selection: Selection, result: Fit) -> tuple[FoundEffect, ...]:
    """The accepted effects with their intervals, rivals and share of resamples; a gust where one blows."""
    search = Search(regression)
    effects = []
    for candidate in result.candidates:
        others = [c for c in result.candidates if c is not candidate]
        rivals = rivals_of(search, others, candidate)
        parameters = {
            name: _value(estimate) for (key, name), estimate in result.estimates.items() if key == candidate.key
        }
        held = {
            p.name: ParameterValue(candidate.at[p.name], 0.0, p.unit)
            for p in candidate.effect.parameters
            if p.name not in parameters
        }
        name = candidate.effect.name
        close = tuple(s.candidates[-1].effect.name for s in near_rivals(search, others, rivals))[: MAX_SET - 1]
        share = _confidence(search, rivals)
        effects.append(FoundEffect(name, candidate.rotor, {**parameters, **held}, share, close))
    gust = selection.gust
    if selection.blows and gust.effect is not None:
        intensity = gust.effect.parameters[0]
        strength = {intensity.name: ParameterValue(gust.intensity, gust.intensity / 2, intensity.unit)}
        blown = FoundEffect(gust.effect.name, None, strength, 1.0, ())
        at = 0 if not selection.chosen.candidates or selection.gust_before.score > selection.chosen.score else 1
        effects.insert(min(at, len(effects)), blown)
    return tuple(effects)


def _value(estimate: Estimate) -> ParameterValue:
    return ParameterValue(estimate.value, estimate.std, estimate.unit)


def _confidence(search: Search, rivals: Sequence[Scored]) -> float:
    """Share of flight resamples in which the first of the rivals wins."""
    regression, random, wins = search.regression, np.random.default_rng(0), 0
    penalties = [sum(search.penalty(c) for c in s.candidates) for s in rivals]
    for _ in range(RESAMPLES):
        flights = random.choice(len(regression.flights), len(regression.flights)).tolist()
        scores = [regression.gain(s.columns, flights) - p for s, p in zip(rivals, penalties, strict=True)]
        wins += int(np.argmax(scores)) == 0
    return wins / RESAMPLES


def judge(
    effects: Sequence[FoundEffect],
    left: Leftover,
    at_first: Leftover,
    misfits: tuple[float, float] | None,
    gust_share: float,
    *,
    gusty: bool,
) -> Verdict:
    """The verdict: whether something is left that no effect explains comes before what was found.

    misfits: of a typical held-out window, before and after; None where something swings by itself, which nobody can
        foretell on wild flights.
    gust_share: gain of a gust over the number of whitened residuals.
    gusty: a gust is among the effects; what it leaves is no surprise, unless it can be learned from the state or comes
        back in its place.
    """
    regular = max(left.learnable, left.returning) > GUST_LEARNABLE * gust_share
    agrees = left.agreement > max(LEFT_AGREEMENT, LEFT_SHARE * at_first.agreement)
    learnable = left.learnable > max(LEFT_LEARNABLE, LEFT_SHARE * at_first.learnable)
    misfitting = misfits is not None and misfits[1] > max(LEFT_MISFIT, LEFT_SHARE * misfits[0])
    line = left.line > (LEFT_LINE if misfits is not None else SWINGING_LINE)
    if line or (regular if gusty else agrees or learnable or misfitting):
        return "unknown"
    if not effects:
        return "explained"
    return "ambiguous" if any(effect.ambiguous_with for effect in effects) else "effect"


def not_excited(regression: Regression, chosen: Scored) -> tuple[str, ...]:
    """Effects that would not have shown at their usual size: they are not absent, they were not looked at."""
    search = Search(regression)
    seen: dict[str, bool] = {}
    gram: Floats = np.sum(regression.gram, axis=0)
    for candidate in regression.candidates:
        name = candidate.effect.name
        specified = candidate.columns[0] in regression.biases.columns  # every flight has some of these
        if name in chosen.names or seen.get(name) or specified or not _is_usual(candidate, regression):
            continue
        seen[name] = _usual_gain(regression, gram, candidate, chosen.columns) > MIN_GAIN + search.penalty(candidate)
    return tuple(name for name, shown in seen.items() if not shown)


def _is_usual(candidate: Candidate, regression: Regression) -> bool:
    """Whether a variant's held parameters are the effect's usual ones, or no variant's are."""
    usual = candidate.effect.defaults(regression.vehicle)

    def matches(other: Candidate) -> bool:
        return all(np.isclose(v, usual[n]) for n, v in other.at.items() if n not in other.free)

    family = [c for c in regression.candidates if c.effect is candidate.effect and not c.whole]
    return matches(candidate) or not any(map(matches, family))


def _usual_gain(regression: Regression, gram: Floats, candidate: Candidate, chosen: Sequence[int]) -> float:
    """Gain that the effect at its usual size would bring beyond the chosen effects and the biases."""
    own = list(candidate.columns)
    rest = [i for i in chosen if i not in own]
    across = gram[np.ix_(rest, own)]
    inner = gram[np.ix_(rest, rest)]
    left = gram[np.ix_(own, own)] - across.T @ np.linalg.lstsq(inner, across, rcond=None)[0]
    parameters = {p.name: p for p in candidate.effect.parameters}
    usual = [1.0] if candidate.whole else [_usual(parameters[n], regression.vehicle) for n in candidate.free]
    return float(np.array(usual) @ left @ np.array(usual))


def _usual(parameter: Parameter, vehicle: Vehicle) -> float:
    """The parameter's usual distance from where its effect vanishes."""
    prior = parameter.prior(vehicle)
    return prior.mean - parameter.neutral or prior.std


def channel_errors(
    before: Sequence[Floats], after: Sequence[Floats], regression: Regression, held_out: Sequence[Segment] = ()
) -> dict[str, ChannelError]:
    """Error of each kind that there is, before and after, over its floor.

    held_out: the segments of before and after, whose floor is theirs; without them it is that of the fitted flights.
    """
    level = held_out_floor(regression, held_out, after) if held_out else regression.noise.floor
    was, now, floor = channels.norms(before), channels.norms(after), floor_norms(level)
    return {
        kind: ChannelError(was[kind], now[kind], floor[kind], channels.UNITS[kind])
        for kind in channels.KINDS
        if floor[kind] > 0
    }
