"""From a fit and what it leaves to the answer: the gust beside the effects, and the verdict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.estimation.evaluation import floor_norms
from diagnosis.estimation.fitted import Fit, ParameterEstimate
from diagnosis.estimation.refusal import Refused
from diagnosis.likelihood.gust import Gust
from diagnosis.likelihood.left_over import Left
from diagnosis.models import channels
from diagnosis.report import ChannelError, Considered, MissingEffect, Outcome, ParameterValue, Verdict
from diagnosis.selection.candidates import Candidate
from diagnosis.tried import Tried
from dynamics.arrays import Floats


def with_gust(effects: tuple[MissingEffect, ...], gust: Gust, log_odds: float) -> tuple[MissingEffect, ...]:
    """The effects and the gust beside them, first or second. log_odds: of the effects against none."""
    parameter = gust.effect.parameters[0]
    strength = {parameter.name: ParameterValue(gust.intensity, gust.std, parameter.unit)}
    place = 0 if gust.log_odds > log_odds else min(1, len(effects))
    return (
        *effects[:place],
        MissingEffect(gust.effect.name, None, strength, gust.probability, ()),
        *effects[place:],
    )


def parameters_of(accepted: Fit, candidate: Candidate) -> dict[str, ParameterValue]:
    """The fitted parameters of a candidate, then those that were held."""
    fitted = {name: _value(estimate) for (key, name), estimate in accepted.estimates.items() if key == candidate.key}
    held = {
        p.name: ParameterValue(candidate.at[p.name], 0.0, p.unit)
        for p in candidate.effect.parameters
        if p.name not in fitted
    }
    return {**fitted, **held}


def _value(estimate: ParameterEstimate) -> ParameterValue:
    return ParameterValue(estimate.value, estimate.std, estimate.unit)


def judge(effects: Sequence[MissingEffect], left: Sequence[Left]) -> Verdict:
    """The verdict: `unknown` where something is left that no effect is, whatever effects were named."""
    if left:
        return "unknown"
    if not effects:
        return "explained"
    return "ambiguous" if any(effect.ambiguous_with for effect in effects) else "effect"


def considered(
    tried: Sequence[Tried], effects: Sequence[MissingEffect], refused: Sequence[Refused]
) -> tuple[Considered, ...]:
    """Every effect that the flights could show, at the point that fits best, and what became of it."""
    named = {effect.name for effect in effects}
    rejected = {one.name for one in refused}

    def entry(one: Tried) -> Considered:
        name = one.candidate.effect.name
        outcome: Outcome = "not_selected" if one.score is not None else "impossible"
        if name in named or name in rejected:
            outcome = "named" if name in named else "refused"
        return Considered(name, one.candidate.rotor, one.score, outcome)

    return tuple(entry(one) for one in tried)


def channel_errors(
    before: Sequence[Floats], after: Sequence[Floats], floor: Floats, sensors: Floats
) -> dict[str, ChannelError]:
    """Error of each kind that there is, before and after, over its floor.

    floor, sensors: (12,) of the same rows; the sensors' noise is at most the floor.
    """
    was, now, levels, heard = channels.norms(before), channels.norms(after), floor_norms(floor), floor_norms(sensors)
    return {
        kind: ChannelError(
            before=was[kind],
            after=now[kind],
            floor=levels[kind],
            unit=channels.UNITS[kind],
            sensors=heard[kind],
            fast_remainder=float(np.sqrt(max(levels[kind] ** 2 - heard[kind] ** 2, 0.0))),
        )
        for kind in channels.KINDS
        if levels[kind] > 0
    }
