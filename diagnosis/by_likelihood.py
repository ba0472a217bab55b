"""The likelihood's answer about a data set: the effects it names, their values, and the noise of the residuals."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import Accepted
from diagnosis.estimation.channel_noise import ChannelNoise
from diagnosis.estimation.evaluation import require_followed
from diagnosis.estimation.fitted import Fit, ParameterEstimate, with_candidates
from diagnosis.estimation.refusal import Refused
from diagnosis.likelihood.columns import candidates
from diagnosis.likelihood.evidence import IMPOSSIBLE, Search
from diagnosis.likelihood.flight_rows import rows_by_kind
from diagnosis.likelihood.identify import Identified, command_values, deviations, identify
from diagnosis.likelihood.left_over import LeftOver
from diagnosis.likelihood.named import Doubted, Named, named_effects
from diagnosis.likelihood.noise_fit import NoiseFit, likeliest, structures_of
from diagnosis.likelihood.problem import Problem
from diagnosis.models.command_effects import seen_as, with_command_effects
from diagnosis.report import MissingEffect
from diagnosis.selection.candidates import Identity
from diagnosis.thresholds import DEFAULT, Thresholds
from diagnosis.verdict import parameters_of
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.errors import DataError
from dynamics.progress import Progress, no_progress
from dynamics.vehicle import Vehicle


@contextmanager
def filter_required() -> Iterator[None]:
    """Raise DataError for flights whose readings no stationary filter has."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise DataError(
            f"no filter can follow the readings of these logs ({error}). Wanted gyro and rotors, and best a pose and "
            "an accelerometer: look at them with `alula inspect`."
        ) from error


@dataclass(frozen=True, eq=False)
class LikelihoodAnswer:
    """The named effects by the likelihood.

    result: the best set. noise: of the residuals beside it.
    """

    result: Identified
    named: tuple[Named, ...]
    noise: ChannelNoise
    accepted: Accepted

    @property
    def search(self) -> Search:
        """About the best set."""
        return self.result.search

    def missing(self) -> tuple[MissingEffect, ...]:
        """The named effects, the surest first."""
        commanded = self.noise.segments[0].rotor_source == "command"
        by_identity = {c.identity: c for c in self.accepted.fit.candidates}
        effects = []
        for one in self.named:
            candidate = by_identity[one.candidate.identity]
            name, rivals = candidate.effect.name, list(one.rivals)
            rivals += seen_as([name, *rivals], self.noise.catalogue) if commanded else []
            effects.append(
                MissingEffect(
                    name=name,
                    rotor=candidate.rotor,
                    parameters=parameters_of(self.accepted.fit, candidate),
                    confidence=one.probability,
                    ambiguous_with=tuple(dict.fromkeys(rival for rival in rivals if rival != name)),
                )
            )
        return tuple(effects)

    @property
    def vehicle_without(self) -> Vehicle:
        """The vehicle without the named effects, its commands as they fit best then."""
        return fit_of(self.search, ()).vehicle

    def without(self, refused: Sequence[Refused]) -> LikelihoodAnswer:
        """The answer without effects that are refused afterwards."""
        out = {(one.name, one.rotor) for one in refused}
        rest = tuple(one for one in self.named if one.candidate.identity not in out)
        accepted = _accepted(self.search, rest, (*self.accepted.refused, *refused))
        return replace(self, named=rest, accepted=accepted)

    def with_noise(self, fits: Sequence[NoiseFit], *, slow: bool) -> LikelihoodAnswer:
        """The answer with the noise beside what it leaves. slow: whether a slow force is noise."""
        return replace(self, noise=replace(self.noise, fits=fits, slow=slow))


def answer_by_likelihood(
    dataset: Dataset,
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    thresholds: Thresholds = DEFAULT,
    progress: Progress = no_progress,
    one_of: Collection[Identity] | None = None,
) -> LikelihoodAnswer:
    """Which effects are missing.

    one_of: effects, each on a rotor or none, of which one may be missing beside corrections of the file's own; by
    default all of the catalogue may. Raises DataError where no stationary filter has such readings.
    """
    problems = problems_of(dataset, vehicle, catalogue, thresholds)
    every = problems[0].what.all
    some = None if one_of is None else [i for i, c in enumerate(every) if c.identity in one_of]
    result = _identified(problems, progress, one_of=some)
    named, doubted = named_effects(result)
    refused = tuple(_refused(one, result.search.problem.thresholds.named) for one in doubted)
    noise = ChannelNoise(dataset.fitted, result.problems, result.noise, thresholds)
    return LikelihoodAnswer(result, named, noise, _accepted(result.search, named, refused))


def noise_of(
    dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect], thresholds: Thresholds = DEFAULT
) -> ChannelNoise:
    """The noise of the fitted flights beside all that may be missing.

    A slow force is none of it, unless an estimator made the pose: what drifts there looks like it. Raises DataError
    where no stationary filter has such readings.
    """
    problems = problems_of(dataset, vehicle, catalogue, thresholds)
    with filter_required():
        fits = [likeliest(one, structures_of(one.flights[0].segment)) for one in problems]
    noise = ChannelNoise(dataset.fitted, problems, fits, thresholds)
    return replace(noise, slow=noise.drifts)


def answer_beside(answer: LikelihoodAnswer, left: LeftOver, progress: Progress = no_progress) -> LikelihoodAnswer:
    """An answer beside what it leaves, which may have passed for an effect, or for noise.

    Of its named effects remain those that leave little of what they make, and are likely beside that, by all of the
    likelihood and by its evidence, with their values there; each of the others is refused.
    """
    limits, values = answer.search.problem.thresholds, answer.search.named_values(answer.result.best)
    required = limits.named
    fitting = [one for one in answer.named if left.shares[one.number] <= limits.form]
    sure = [one for one in fitting if left.odds[one.number] >= required]
    problems = [
        problem.with_discrepancies([one.discrepancy for one in left.left]) for problem in answer.result.problems
    ]
    while True:
        numbers = [one.number for one in sure]
        result = _identified(problems, progress, fixed_set=numbers, begin=answer.result.noise)
        odds = {one.number: _odds(result.search, sure, one) for one in sure}
        if all(each >= required for each in odds.values()):
            break
        sure.remove(min(sure, key=lambda one: odds[one.number]))
    named = tuple(replace(one, log_odds=min(one.log_odds, odds[one.number])) for one in sure)
    refused = list(answer.accepted.refused)
    for one in answer.named:
        if one not in fitting:
            detail, own = {"share": left.shares[one.number], "required": limits.form}, one.candidate
            refused.append(Refused(own.effect.name, own.rotor, "another_form", detail, "", values[one.number]))
        elif one not in sure:
            log_odds = min(left.odds[one.number], _odds(result.search, [*sure, one], one))
            refused.append(_refused(Doubted(one.candidate, values[one.number], float(np.exp(log_odds)), 0.0), required))
    noise = replace(answer.noise, problems=result.problems, fits=result.noise)
    return LikelihoodAnswer(result, named, noise, _accepted(result.search, named, refused))


def _odds(search: Search, named: Sequence[Named], one: Named) -> float:
    """Log of the odds of one of some effects, beside the others."""
    numbers = [each.number for each in named]
    together, rest = (search.score(some).evidence for some in (numbers, [i for i in numbers if i != one.number]))
    return -np.inf if together == IMPOSSIBLE else float(together - rest)


def _identified(problems: Sequence[Problem], progress: Progress, **choices: Any) -> Identified:
    with filter_required():
        return identify(problems, progress=progress, **choices)


def _refused(one: Doubted, log_odds: float) -> Refused:
    """Why an effect of the best set is not named. log_odds: that are required."""
    required, effect = float(np.exp(log_odds)), one.candidate.effect
    if one.odds < required:
        detail = {"odds": one.odds, "required": required}
        return Refused(effect.name, one.candidate.rotor, "unsure", detail, "", one.values)
    detail = {"size": one.size, "required": effect.min_detectable}
    return Refused(effect.name, one.candidate.rotor, "too_small", detail, "", one.values)


def problems_of(
    dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect], thresholds: Thresholds = DEFAULT
) -> list[Problem]:
    """The fitted flights of each kind of logs as its filter has them, and what may be missing in a vehicle.

    Raises DataError where the vehicle's own model cannot be followed along them.
    """
    require_followed(vehicle, catalogue, dataset.fitted, thresholds.prediction)
    limits = thresholds.likelihood
    vehicle, catalogue = with_command_effects(vehicle, catalogue, dataset.fitted)
    every = candidates(vehicle, catalogue, dataset.fitted)
    return [
        Problem(vehicle, catalogue, own, every.with_errors_of(own[0].segment), thresholds=limits)
        for own in rows_by_kind(dataset.fitted, dataset.flight_of, limits)
    ]


def fit_of(search: Search, members: Sequence[int]) -> Fit:
    """Values of a set and of what lies between command and thrust beside it, by all of the likelihood; their
    covariance by the share of it that counts as evidence: what makes an effect sure makes its value."""
    what, scored = search.what, search.score(members)
    values, commands = search.named_values(scored), command_values(search, scored)
    places, count = search.places(scored), len(what.of_commands)
    prior = np.concatenate([search.std[places] ** -2.0, np.zeros(count)])
    covariance = np.linalg.inv(search.coarse.information(places, count) + np.diag(prior))
    own = np.sqrt(np.diag(covariance)[: len(places)])
    scatter = np.concatenate([np.maximum(deviations(search, scored) / own, 1.0), np.ones(count)])
    covariance = covariance * scatter * scatter[:, None]
    estimates = _estimates(search, values, covariance)
    of_commands = _estimates(search, commands, covariance[len(places) :, len(places) :])
    chosen, nuisances = (tuple(what.all[i] for i in numbers) for numbers in (values, commands))
    full = {f"{what.all[i].key}.{name}": v for i in values for name, v in {**what.all[i].at, **values[i]}.items()}
    full |= {f"{key}.{name}": one.value for (key, name), one in of_commands.items()}
    return Fit(
        vehicle=with_candidates(search.problem.vehicle, (*chosen, *nuisances), full),
        estimates=estimates,
        candidates=chosen,
        covariance=covariance,
        information=search.total.information(places, count),
        nuisances=nuisances,
        commands=of_commands,
    )


def _estimates(
    search: Search, values: dict[int, dict[str, float]], covariance: Floats
) -> dict[tuple[str, str], ParameterEstimate]:
    """Values by (key, parameter), with their deviations. covariance: (c, c) in the order of all."""
    made, std = dict[tuple[str, str], ParameterEstimate](), np.sqrt(np.diag(covariance))
    for number, own in values.items():
        candidate = search.what.all[number]
        units = {p.name: p.unit for p in candidate.effect.parameters}
        for name, value in own.items():
            made[candidate.key, name] = ParameterEstimate(value, float(std[len(made)]), units[name])
    return made


def _accepted(search: Search, named: Sequence[Named], refused: Sequence[Refused]) -> Accepted:
    return Accepted(fit_of(search, [one.number for one in named]), tuple(refused))
