"""From a fit and what it leaves to the answer: the gust beside the effects, the tests that reject, the verdict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.estimation.evaluation import floor_norms
from diagnosis.estimation.fitted import Fit, ParameterEstimate
from diagnosis.estimation.refusal import Refused
from diagnosis.models import channels
from diagnosis.report import ChannelError, Considered, MissingEffect, Outcome, ParameterValue, Verdict
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import AirMotion, Gust, signal_of, turbulence_of
from diagnosis.selection.regression import Regression
from diagnosis.selection.residual_tests import Rejection, ResidualTests
from diagnosis.thresholds import DEFAULT, VerdictThresholds
from diagnosis.tried import Tried
from dynamics.arrays import Floats


def gust_refusal(
    regression: Regression, air: AirMotion, tests: ResidualTests, thresholds: VerdictThresholds = DEFAULT.verdict
) -> Refused | None:
    """Why a gust that was detected is not named, None where it is named or none was detected.

    Air in motion is no function of the vehicle's state nor of its position: what a function of these predicts on
    flights left out is no gust. Nor has it a line in its spectrum, as a load that swings. Nor is one named that would
    not raise the error of any axis by what matters.
    """
    if not air.detected or air.gust.effect is None:
        return None
    if (small := _small_gust(regression, air.gust)) is not None:
        return small
    gained = max(air.gust.gain / max(regression.total, 1), 1e-12)
    shares = {
        where: tests.statistics[test] / gained
        for test, where in (("predictable_from_state", "state"), ("position_dependent", "position"))
        if tests.over_floor(test) > thresholds.min_over_floor
    }
    where, required = max(shares, key=lambda place: shares[place], default=""), thresholds.max_gust_predictable
    if not where or shares[where] <= required:
        where, required = "line", thresholds.max_line_in_gust
        shares[where] = _share_of_line(regression, air.gust, tests)
    if shares[where] <= required:
        return None
    strength = {air.gust.effect.parameters[0].name: air.gust.intensity}
    detail = {"share": shares[where], "required": required}
    return Refused(air.gust.effect.name, None, "predictable", detail, where, strength)


def _share_of_line(regression: Regression, gust: Gust, tests: ResidualTests) -> float:
    """Power of a line in the spectrum of a force over that of a gust there, where the line is one beyond doubt."""
    limits, line = regression.thresholds.verdict, tests.findings.get("spectral_line")
    signal = turbulence_of(gust, regression)
    if line is None or signal is None or signal[line.channel] <= 0:
        return 0.0
    is_line = tests.spectral_line > max(limits.max_line, tests.line_by_chance)
    return float((line.rms / signal[line.channel]) ** 2) if is_line and line.over_floor > limits.min_over_floor else 0.0


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


def rejections(
    after: ResidualTests,
    before: ResidualTests,
    chi_squares: tuple[float, float] | None,
    *,
    gusty: bool,
    thresholds: VerdictThresholds = DEFAULT.verdict,
    slight: Floats | None = None,
) -> tuple[Rejection, ...]:
    """The tests of the residuals that reject, and find something large enough to matter.

    after, before: residual tests with the effects and without them.
    chi_squares: reduced, of a typical held-out window, before and after; None beside a load that swings, which cannot
        be predicted on wild flights.
    slight: (12,) RMS in each channel below which a finding does not matter, whatever the floor.
    gusty: whether a gust is among the effects. What it leaves is compared with it then (`run_residual_tests`), and must
        exceed it. That the state or the position predicts residuals has refused the gust before (`gust_refusal`).
    """
    sizes = after.statistics

    def limit(lowest: float, before: float, over_floor: float) -> float:
        """The lowest one; or the share of what was there that an imperfect form may leave, where it is small."""
        excused = over_floor <= thresholds.max_excused
        return max(lowest, thresholds.max_share * before) if excused else lowest

    max_line = thresholds.max_line if chi_squares is not None else thresholds.max_line_swinging
    limits = {"spectral_line": max(max_line, after.line_by_chance)}
    for test, lowest, earlier in (
        ("low_frequency_agreement", thresholds.max_agreement, before.low_frequency_agreement),
        ("predictable_from_state", thresholds.max_predictable, before.predictable_from_state),
    ):
        limits[test] = limit(lowest, earlier, after.over_floor(test))
    limits["position_dependent"] = thresholds.max_predictable
    if chi_squares is not None:
        sizes["typical_window"] = chi_squares[1]
        over_floor = np.sqrt(max(chi_squares[1] - 1, 0.0))
        limits["typical_window"] = limit(thresholds.max_chi_square, chi_squares[0], over_floor)

    def matters(test: str) -> bool:
        finding = after.findings.get(test)
        if slight is not None and finding is not None and finding.rms < slight[finding.channel]:
            return False
        in_air = gusty and test != "spectral_line"
        return after.over_floor(test) > (thresholds.min_over_gust if in_air else thresholds.min_over_floor)

    return tuple(
        Rejection(test, sizes[test], limit) for test, limit in limits.items() if sizes[test] > limit and matters(test)
    )


def above_floor(after: Sequence[Floats], floor: Floats) -> bool:
    """Whether any kind of channel has a larger error than its floor: without, nothing is left to be missing.

    after: (m, 12) residuals of each held-out flight. floor: (12,).
    """
    errors, floors = channels.norms(after), floor_norms(floor)
    return any(errors[kind] > floors[kind] > 0 for kind in channels.KINDS)


def judge(effects: Sequence[MissingEffect], rejected: Sequence[Rejection]) -> Verdict:
    """The verdict: `unknown` where a test of the residuals rejects, whatever effects were named."""
    if rejected:
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
