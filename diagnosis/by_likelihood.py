"""The likelihood's answer in the form of the regression's, whose tests of the residuals tell what else is missing."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import Accepted
from diagnosis.estimation.fitted import Fit, ParameterEstimate, left_out, with_candidates
from diagnosis.estimation.held_out import HeldOut
from diagnosis.estimation.pursuit import about
from diagnosis.estimation.refusal import Refused
from diagnosis.likelihood.columns import candidates
from diagnosis.likelihood.evidence import Search
from diagnosis.likelihood.flight_rows import FlightRows, make_rows
from diagnosis.likelihood.identify import command_values, deviations, identify
from diagnosis.likelihood.named import Named, named_effects
from diagnosis.likelihood.problem import Problem
from diagnosis.models.command_effects import seen_as, with_command_effects
from diagnosis.report import MissingEffect
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import gust_beside
from diagnosis.selection.regression import Regression
from diagnosis.selection.search import Search as RegressionSearch
from diagnosis.selection.selected import Selection, gust_variance, with_gust_by
from diagnosis.verdict import parameters_of
from dynamics.arrays import Floats
from dynamics.progress import Progress, no_progress


@dataclass(frozen=True, eq=False)
class LikelihoodAnswer:
    """The named effects by the likelihood, and what the tests of their residuals need.

    search: about the best set. regression: about the named effects. selection: of them, with the gust beside them.
    """

    search: Search
    named: tuple[Named, ...]
    regression: Regression
    selection: Selection
    accepted: Accepted

    def missing(self) -> tuple[MissingEffect, ...]:
        """The named effects, the surest first."""
        commanded = self.regression.segments[0].rotor_source == "command"
        by_identity = {c.identity: c for c in self.accepted.fit.candidates}
        effects = []
        for one in self.named:
            candidate = by_identity[one.candidate.identity]
            name, rivals = candidate.effect.name, list(one.rivals)
            rivals += seen_as([name, *rivals], self.regression.catalogue) if commanded else []
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

    def without(self, refused: Sequence[Refused], dataset: Dataset) -> LikelihoodAnswer:
        """The answer without effects that are refused afterwards."""
        out = {(one.name, one.rotor) for one in refused}
        rest = tuple(one for one in self.named if one.candidate.identity not in out)
        accepted = _accepted(self.search, self.regression, rest, dataset, (*self.accepted.refused, *refused))
        return LikelihoodAnswer(self.search, rest, self.regression, self.selection, accepted)


def answer_by_likelihood(first: Regression, dataset: Dataset, progress: Progress = no_progress) -> LikelihoodAnswer:
    """Which effects are missing. first: the regression about the vehicle's own model, with which they are tested."""
    result = identify(likelihood_problems(dataset, first), progress=progress)
    search, testable = result.search, {c.identity for c in first.candidates}
    named = tuple(one for one in named_effects(result) if one.candidate.identity in testable)
    fitted = likelihood_fit(search, first, named)
    regression = (about(first, first.candidates, first.nuisances, fitted) if named else None) or first
    own = _in_regression(regression, named, fitted)
    air = gust_variance(regression, own)
    regression = regression.in_gust(air)
    before, singles = gust_beside(first, []), RegressionSearch(first).singles()
    chosen = RegressionSearch(regression).score(own)
    selection = with_gust_by(regression, Selection(chosen, singles, before, before, False, air), own)
    return LikelihoodAnswer(search, named, regression, selection, _accepted(search, regression, named, dataset, ()))


def likelihood_problems(dataset: Dataset, regression: Regression) -> list[Problem]:
    """The fitted flights of each kind of logs as its filter has them: in pieces, of which all columns fit into memory.

    Logs of one kind have readings of the same sensors at about the same rate.
    """
    vehicle, catalogue = with_command_effects(regression.vehicle, regression.catalogue, dataset.fitted)
    limits = regression.thresholds.likelihood
    every, rows = candidates(vehicle, catalogue, dataset.fitted), dict[tuple[object, ...], list[FlightRows]]()
    for segment, group in zip(dataset.fitted, dataset.flight_of, strict=True):
        count = math.ceil(segment.duration / limits.seconds)
        ends = [round(i * len(segment) / count) for i in range(count + 1)]
        made = [make_rows(segment.between(begin, end), group, limits) for begin, end in itertools.pairwise(ends)]
        kind = (made[0].readings, round(1 / made[0].period), segment.rotor_source, segment.pose_source)
        followed = [replace(after, before=last) for last, after in itertools.pairwise(made)]
        rows.setdefault(kind, []).extend([made[0], *followed])
    return [
        Problem(vehicle, catalogue, own, every.with_errors_of(own[0].segment), thresholds=limits)
        for own in rows.values()
    ]


def likelihood_fit(search: Search, regression: Regression, named: Sequence[Named]) -> Fit:
    """Values of the named effects and of what lies between command and thrust beside them, by all of the likelihood;
    their covariance by the share of it that counts as evidence: what makes an effect sure makes its value."""
    what, scored = search.what, search.score([one.number for one in named])
    values, commands = search.named_values(scored), command_values(search, scored)
    places, count = search.places(scored), len(what.of_commands)
    prior = np.concatenate([search.std[places] ** -2.0, np.zeros(count)])
    covariance = np.linalg.inv(search.coarse.information(places, count) + np.diag(prior))
    own = np.sqrt(np.diag(covariance)[: len(places)])
    scatter = np.concatenate([np.maximum(deviations(search, scored) / own, 1.0), np.ones(count)])
    covariance = covariance * scatter * scatter[:, None]
    estimates = _estimates(search, values, covariance)
    of_commands = _estimates(search, commands, covariance[len(places) :, len(places) :])
    chosen = _in_regression(regression, named, None)
    full = {f"{what.all[i].key}.{name}": v for i in values for name, v in {**what.all[i].at, **values[i]}.items()}
    full |= {f"{key}.{name}": one.value for (key, name), one in of_commands.items()}
    return Fit(
        vehicle=with_candidates(regression.vehicle, (*chosen, *regression.nuisances), full),
        estimates=estimates,
        candidates=chosen,
        covariance=covariance,
        information=search.total.information(places, count),
        nuisances=regression.nuisances,
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


def _accepted(
    search: Search, regression: Regression, named: Sequence[Named], dataset: Dataset, refused: Sequence[Refused]
) -> Accepted:
    """The named effects, and what each is worth on the held-out flights."""
    fitted, judge = likelihood_fit(search, regression, named), HeldOut(regression, dataset.held_out)
    floor = judge.floor(fitted.vehicle)
    fewer = {c.key: left_out(fitted, c, regression.vehicle)[1] for c in fitted.candidates}
    relevance = {key: judge.channel_changes(vehicle, fitted.vehicle, floor) for key, vehicle in fewer.items()}
    sure = {one.candidate.key: one.probability for one in named}
    return Accepted(fitted, tuple(refused), relevance, sure, floor)


def _in_regression(regression: Regression, named: Sequence[Named], fitted: Fit | None) -> tuple[Candidate, ...]:
    """The regression's candidates of the named effects, in the order of the likelihood's: at the grid points that are
    nearest their values. fitted: about which the regression is, None for the vehicle's own model."""
    if fitted is not None:
        return tuple(next(c for c in regression.candidates if c.columns == own.columns) for own in fitted.candidates)
    made = []
    for one in sorted(named, key=lambda each: each.number):
        same = [c for c in regression.candidates if c.identity == one.candidate.identity]
        distances = [_distance(c, one.candidate.at) for c in same]
        made.append(same[int(np.argmin(distances))])
    return tuple(made)


def _distance(candidate: Candidate, at: Mapping[str, float]) -> float:
    """How far a candidate's held values are from others, relatively."""
    held = [name for name in candidate.at if name not in candidate.free]
    return sum(abs(candidate.at[name] - at[name]) / (abs(at[name]) + 1e-9) for name in held)
