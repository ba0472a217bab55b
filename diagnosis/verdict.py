"""From a fit and what it leaves to the answer: the gust beside the effects, the tests that reject, the verdict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.estimation.evaluation import floor_norms
from diagnosis.estimation.fitted import Fit, ParameterEstimate
from diagnosis.estimation.refusal import Refused
from diagnosis.likelihood.features import Line
from diagnosis.likelihood.left_over import Left
from diagnosis.models import channels
from diagnosis.report import ChannelError, Considered, MissingEffect, Outcome, ParameterValue, Verdict
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import AirMotion, Gust, signal_of
from diagnosis.selection.regression import Regression
from diagnosis.thresholds import DEFAULT, VerdictThresholds
from diagnosis.tried import Tried
from dynamics.arrays import Floats


def gust_refusal(
    regression: Regression, air: AirMotion, left: Sequence[Left], thresholds: VerdictThresholds = DEFAULT.verdict
) -> Refused | None:
    """Why a gust that was detected is not named, None where it is named or none was detected.

    Air in motion is no function of the vehicle's state, its place or time, and has no line where it moves: where a
    force that is one has more than some share of a gust's power, it is none. Nor is one named that would not raise the
    error of any axis by what matters.
    """
    if not air.detected or air.gust.effect is None:
        return None
    if (small := _small_gust(regression, air.gust)) is not None:
        return small
    signal = signal_of(air.gust, regression)
    highest = regression.thresholds.gust.max_frequency
    slow = [one for one in left if not isinstance(of := one.discrepancy.of, Line) or of.frequency <= highest]
    forces = [one for one in slow if one.channel < channels.AXES]
    if signal is None or not forces:
        return None
    power = np.sum(signal[channels.SPECIFIC_FORCE] ** 2) or np.sum(signal[channels.POSE_ACCELERATION] ** 2)
    share = float(sum(one.rms**2 for one in forces) / power)
    if share <= thresholds.max_gust_predictable:
        return None
    where = max(forces, key=lambda one: one.rms).discrepancy.of.kind
    detail = {"share": share, "required": thresholds.max_gust_predictable}
    strength = {air.gust.effect.parameters[0].name: air.gust.intensity}
    return Refused(air.gust.effect.name, None, "predictable", detail, where, strength)


def _small_gust(regression: Regression, gust: Gust) -> Refused | None:
    """The refusal of a gust whose air pushes by less than what matters, as an estimate errs; None otherwise.

    Air that only turns the vehicle is none: a torque of turbulence is taken for it where flapping is in the model.
    """
    signal, floor = signal_of(gust, regression), regression.noise.floor
    if signal is None or gust.effect is None:
        return None
    active = regression.noise.active
    forces = [i for i in active if i < channels.POSE_ACCELERATION.stop] or list(active)
    axis = max(forces, key=lambda i: signal[i] / floor[i])
    if np.hypot(signal[axis], floor[axis]) >= (1 + regression.thresholds.relevance.min_rise) * floor[axis]:
        return None
    detail = {"signal": float(signal[axis]), "floor": float(floor[axis])}
    strength = {gust.effect.parameters[0].name: gust.intensity}
    return Refused(gust.effect.name, None, "too_small", detail, channels.KINDS[axis // channels.AXES], strength)


def with_gust(effects: tuple[MissingEffect, ...], air: AirMotion, log_odds: float) -> tuple[MissingEffect, ...]:
    """The effects and the gust beside them, first or second. log_odds: of the effects against none."""
    gust = air.gust
    if gust.effect is None:
        return effects
    parameter = gust.effect.parameters[0]
    strength = {parameter.name: ParameterValue(gust.intensity, gust.std, parameter.unit)}
    place = 0 if air.before.score > 2 * log_odds else min(1, len(effects))
    return (
        *effects[:place],
        MissingEffect(gust.effect.name, None, strength, gust.share, (), by_resamples=True),
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
