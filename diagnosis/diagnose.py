"""From flights and a vehicle to a verdict: which physical effect is missing, or that none in the catalogue fits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.by_likelihood import LikelihoodAnswer, answer_beside, answer_by_likelihood, fit_of
from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import Accepted, refused_of
from diagnosis.estimation.channel_noise import ChannelNoise
from diagnosis.estimation.command_gain import command_gain
from diagnosis.estimation.evaluation import reduced_chi_square
from diagnosis.estimation.fitted import Fit
from diagnosis.estimation.held_out import HeldOut
from diagnosis.estimation.refusal import Refused
from diagnosis.leftover import leftover
from diagnosis.likelihood.gust import Gust, gust_in
from diagnosis.likelihood.held_out_score import held_out_score
from diagnosis.likelihood.left_over import LeftOver, left_over
from diagnosis.likelihood.named import Named
from diagnosis.models.command_effects import AS_GAIN, BESIDE_THE_GAIN, without_command_effects
from diagnosis.next_flight import next_flight, next_reference
from diagnosis.one_thread import one_thread
from diagnosis.regimes import regime_maps, worst_cells
from diagnosis.report import CommandGain, Diagnosis, MissingEffect, ParameterValue
from diagnosis.selection.candidates import Identity
from diagnosis.thresholds import DEFAULT, CommandCurveThresholds, Thresholds
from diagnosis.tried import Tried, not_excited, tried_by_likelihood
from diagnosis.verdict import (
    channel_errors,
    considered,
    judge,
    with_gust,
)
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.progress import Progress, no_progress, part_of
from dynamics.rotor_places import rotor_names
from dynamics.vehicle import Vehicle
from flights.followed import FollowedFlight

REFUTING = ("another_form", "held_out_worse")


@dataclass(frozen=True, eq=False)
class DiagnosisDetails:
    """A diagnosis and what it was made from.

    diagnosis: the answer.
    vehicle: with the missing effects at their fitted values.
    noise: of the fitted flights.
    accepted: the named effects, and what was taken back.
    before, after: (m, 12) residuals on the held-out segments. floor: (12,) of their noise.
    chi_square_before, chi_square_after: reduced, of the same.
    notes: what the user should know of the data.
    tried: every effect that the flights could show.
    likelihood: the answer that all is about.
    followed: what the models of recorded flights followed that the diagnosis was compared with.
    """

    diagnosis: Diagnosis
    vehicle: Vehicle
    noise: ChannelNoise
    accepted: Accepted
    before: list[Floats]
    after: list[Floats]
    floor: Floats
    chi_square_before: float
    chi_square_after: float
    notes: tuple[str, ...]
    tried: tuple[Tried, ...]
    likelihood: LikelihoodAnswer
    followed: tuple[FollowedFlight, ...] = ()


@one_thread
def diagnose_dataset(
    dataset: Dataset,
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    thresholds: Thresholds = DEFAULT,
    progress: Progress = no_progress,
) -> DiagnosisDetails:
    """Name the physical effect that is missing from a vehicle's model.

    thresholds: all but those that are applied when flights are read. Raises DataError when the flights cannot answer.
    """
    require_answerable(dataset.everything, vehicle, thresholds)
    outcome = _borne_out(dataset, vehicle, catalogue, thresholds, part_of(progress, 0.0, 0.9))
    answer, rest, gust, judged = outcome.answer, outcome.left, outcome.gust, outcome.held_out
    accepted, refused = answer.accepted, answer.accepted.refused
    effects = answer.missing()
    if gust is not None:
        effects = with_gust(effects, gust, sum(one.log_odds for one in answer.named))
    before, after = judged.rows(answer.vehicle_without), judged.rows(accepted.fit.vehicle)
    floor = judged.floor(accepted.fit.vehicle)
    gain = _command_gain(dataset, accepted.fit, effects, thresholds.command_curve)
    if gain is not None:
        effects = _with_gain(effects, gain, dataset, thresholds, unknown=bool(rest.left))
    named = [one.number for one in answer.named]
    quiet, tried = not_excited(answer.search, named), tried_by_likelihood(answer.search, named)
    maps = regime_maps(dataset.held_out, before, answer.noise.floor, vehicle, thresholds.regimes)
    left = leftover(rest.left, dataset.fitted, answer.noise.floor, vehicle, thresholds)
    diagnosis = Diagnosis(
        verdict=judge(effects, rest.left),
        effects=effects,
        channels=channel_errors(before, after, floor, judged.sensors(accepted.fit.vehicle)),
        not_excited=quiet,
        fails_where=worst_cells(maps, thresholds.regimes),
        next_flight=next_flight(effects, left, refused, quiet, catalogue),
        refused=refused,
        candidates=considered(tried, effects, refused),
        leftover=left,
        rotors=rotor_names(vehicle),
        next_reference=next_reference(effects, refused, quiet, catalogue),
        command_gain=gain,
        held_out_score=held_out_score(answer.result, named, dataset.held_out),
    )
    return DiagnosisDetails(
        diagnosis=diagnosis,
        vehicle=without_command_effects(accepted.fit.vehicle),
        noise=answer.noise,
        floor=floor,
        accepted=accepted,
        before=before,
        after=after,
        chi_square_before=reduced_chi_square(before, answer.noise.floor),
        chi_square_after=reduced_chi_square(after, answer.noise.floor),
        notes=(*_notes(dataset, accepted.fit), *_not_followed(answer)),
        tried=tried,
        likelihood=answer,
    )


def _borne_out(
    dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect], thresholds: Thresholds, progress: Progress
) -> _Judged:
    """The answer without effects that held-out flights refute, beside what these made."""
    judged = _judged(*_answered(dataset, vehicle, catalogue, thresholds, part_of(progress, 0.0, 0.7)), dataset)
    refuted = _refuted_by(judged)
    if not refuted:
        return judged
    progress(0.7, "what is left without effects that other flights refute")
    answer = judged.answer.without(refuted)
    left = left_over(answer.result, _refuted(answer))
    if left.left:
        answer = answer_beside(answer, left, part_of(progress, 0.8, 1.0))
    return _judged(answer, left, dataset)


def _answered(
    dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect], thresholds: Thresholds, progress: Progress
) -> tuple[LikelihoodAnswer, LeftOver]:
    """The likelihood's answer, and what it leaves of the flights."""
    answer = answer_by_likelihood(dataset, vehicle, catalogue, thresholds, part_of(progress, 0.0, 0.7))
    progress(0.7, "what no effect explains")
    left = left_over(answer.result)
    if left.left:
        answer = answer_beside(answer, left, part_of(progress, 0.8, 1.0))
        if refuted := _refuted(answer):  # what those made is left as well
            left = left_over(answer.result, refuted)
    return answer, left


def _refuted(answer: LikelihoodAnswer) -> set[Identity]:
    """Effects that the form of what is left, or held-out flights, refute."""
    return {(one.name, one.rotor) for one in answer.accepted.refused if one.reason in REFUTING}


@dataclass(frozen=True, eq=False)
class _Judged:
    """An answer, its noise beside what it leaves, a gust that is surely there, and the held-out flights."""

    answer: LikelihoodAnswer
    left: LeftOver
    gust: Gust | None
    held_out: HeldOut


def _judged(answer: LikelihoodAnswer, left: LeftOver, dataset: Dataset) -> _Judged:
    gust = _gust(answer, left)
    answer = answer.with_noise(left.noise, slow=gust is None)
    return _Judged(answer, left, gust, HeldOut(answer.noise, dataset.held_out))


def _refuted_by(judged: _Judged) -> list[Refused]:
    """Effects with which an error of the held-out flights rises by more than chance, the worst first.

    What fits one set of flights and not the next is no physics, however sure the model of the noise makes it.
    """
    answer, held_out, refuted = judged.answer, judged.held_out, list[Refused]()
    while answer.named and held_out.worse_channels(answer.vehicle_without, answer.accepted.fit.vehicle):
        rises = [
            (change.rise, kind, change, one)
            for one in answer.named
            for kind, change in held_out.worse_channels(_without(answer, one), answer.accepted.fit.vehicle).items()
        ]
        if not rises:
            break
        _, kind, change, one = max(rises, key=lambda each: each[0])
        fitted = answer.accepted.fit
        candidate = next(c for c in fitted.candidates if c.identity == one.candidate.identity)
        sizes = {"before": change.before, "after": change.after}
        refuted.append(refused_of(fitted, candidate, "held_out_worse", kind, **sizes))
        answer = answer.without(refuted[-1:])
    return refuted


def _without(answer: LikelihoodAnswer, one: Named) -> Vehicle:
    """The vehicle with the other named effects, their values as they fit best then."""
    return fit_of(answer.search, [each.number for each in answer.named if each is not one]).vehicle


def _gust(answer: LikelihoodAnswer, left: LeftOver) -> Gust | None:
    """A gust that is surely there. left: beside the named effects."""
    gust = gust_in(answer.result.problems, left)
    return None if gust is None or gust.log_odds < answer.search.problem.thresholds.named else gust


def _not_followed(answer: LikelihoodAnswer) -> list[str]:
    """A note on effects that these logs are too slow for."""
    if not answer.search.what.not_followed:
        return []
    names, rate = ", ".join(answer.search.what.not_followed), answer.noise.segments[0].rate
    return [f"not tried, since logs of {rate:.0f} Hz are too slow for its hidden states: {names}"]


def _command_gain(
    dataset: Dataset, accepted: Fit, effects: Sequence[MissingEffect], thresholds: CommandCurveThresholds
) -> CommandGain | None:
    """The gain of the commands beside the named effects, and what may be behind it."""
    ratio = None if dataset.curve is None else command_gain(accepted, dataset.curve.mass)
    if dataset.curve is None or ratio is None:
        return None
    mean = dataset.curve.mean_gain
    value, std = mean * ratio.value, mean * ratio.std
    change = abs(value - 1)
    sure = change > max(thresholds.min_gain_change, thresholds.gain_deviations * std)
    apart = [effect for effect in effects if effect.name not in BESIDE_THE_GAIN.values()]
    named = {name for effect in apart for name in (effect.name, *effect.ambiguous_with)}
    return CommandGain(value, std, AS_GAIN if sure and named.isdisjoint(AS_GAIN) else ())


def _with_gain(
    effects: tuple[MissingEffect, ...], gain: CommandGain, dataset: Dataset, thresholds: Thresholds, *, unknown: bool
) -> tuple[MissingEffect, ...]:
    """The effects with the one that a gain is of the vehicle file, where it surely is one.

    A file's thrust constant that is wrong is a gain, and a torque constant that undoes it: one cause. Without that a
    gain is named where nothing is left that no effect is. unknown: whether something is.
    """
    if not gain.look_alikes:
        return effects
    name, *others = gain.look_alikes
    values = {"ratio": ParameterValue(gain.value, gain.std, "1")}
    for effect in effects:
        if effect.name == BESIDE_THE_GAIN.get(name) and name in effect.ambiguous_with:
            ratio = effect.parameters["ratio"]
            undone, std = gain.value * ratio.value, math.hypot(gain.std * ratio.value, gain.value * ratio.std)
            if abs(undone - 1) < thresholds.relevance.deviations * std:
                alike = (effect.name, *(other for other in effect.ambiguous_with if other != name))
                one_cause = MissingEffect(name, None, values, effect.confidence, alike)
                return tuple(one_cause if one is effect else one for one in effects)
    share = _share_of_flights(gain, dataset, thresholds)
    return (
        effects if unknown else (*effects, MissingEffect(name, None, values, share, tuple(others), by_resamples=True))
    )


def _share_of_flights(gain: CommandGain, dataset: Dataset, thresholds: Thresholds) -> float:
    """Share of flight resamples whose gain is not 1, on the same side."""
    assert dataset.curve is not None
    means = np.array([flight.mean for flight in dataset.curve.gains.values()])
    resampled = np.random.default_rng(0).choice(means, size=(thresholds.verdict.resamples, means.size)).mean(axis=1)
    change = (resampled * gain.value / means.mean() - 1) * np.sign(gain.value - 1)
    return float(np.mean(change > thresholds.command_curve.min_gain_change))


def _notes(dataset: Dataset, accepted: Fit) -> tuple[str, ...]:
    """The data set's notes, that on commands with the gain of the joint fit."""
    gain = None if dataset.curve is None else command_gain(accepted, dataset.curve.mass)
    if dataset.curve is None or gain is None:
        return dataset.notes
    first, fitted = dataset.curve.note(), dataset.curve.note(gain.value, gain.std)
    return tuple(fitted if note == first else note for note in dataset.notes)
