"""The likelihood's answer in the form of the regression's: the likelihood says which effects are missing, their values
are those of the joint fit, and the residuals of that fit tell whether something else is missing."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import Accepted
from diagnosis.estimation.equation_error import beyond_feedback, fit
from diagnosis.estimation.fitted import Fit, ParameterEstimate, left_out
from diagnosis.estimation.held_out import HeldOut
from diagnosis.estimation.pursuit import about
from diagnosis.estimation.refusal import Refused
from diagnosis.likelihood.columns import candidates
from diagnosis.likelihood.flight_rows import make_rows
from diagnosis.likelihood.identify import identify
from diagnosis.likelihood.named import Named, named_effects
from diagnosis.likelihood.problem import Problem
from diagnosis.models.command_effects import seen_as, with_command_effects
from diagnosis.report import MissingEffect
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import gust_beside
from diagnosis.selection.regression import Regression
from diagnosis.selection.search import Search
from diagnosis.selection.selected import Selection, with_gust_by
from diagnosis.verdict import parameters_of
from dynamics.progress import Progress, no_progress
from dynamics.vehicle import Vehicle


def tells_best(dataset: Dataset) -> bool:
    """Whether the likelihood is the one to ask: of a pose that an estimator makes from the sensors that are logged.

    Its errors are those of gyro and accelerometer once more, and the controller acts on them. A regression that assumes
    them independent names what is not there; the filter holds them as states.
    """
    return all(segment.pose_source == "estimator" and segment.has_pose for segment in dataset.fitted)


@dataclass(frozen=True, eq=False)
class LikelihoodAnswer:
    """The named effects by the likelihood, and what the tests of their fit's residuals need.

    regression: about that fit. selection: of the named effects, with the gust beside them.
    """

    regression: Regression
    selection: Selection
    accepted: Accepted
    named: tuple[Named, ...]

    def missing(self) -> tuple[MissingEffect, ...]:
        """The accepted effects, the likeliest first."""
        commanded = self.regression.segments[0].rotor_source == "command"
        by_identity = {c.identity: c for c in self.accepted.fit.candidates}
        effects = []
        for one in self.named:
            if (candidate := by_identity.get(one.candidate.identity)) is None:
                continue
            name, rivals = candidate.effect.name, list(one.rivals)
            rivals += seen_as([name, *rivals], self.regression.catalogue) if commanded else []
            alike = tuple(dict.fromkeys(rival for rival in rivals if rival != name))
            effects.append(
                MissingEffect(
                    name=name,
                    rotor=candidate.rotor,
                    parameters=parameters_of(self.accepted.fit, candidate),
                    confidence=one.probability,
                    ambiguous_with=alike,
                )
            )
        return tuple(effects)

    def without(self, refused: Sequence[Refused], dataset: Dataset) -> LikelihoodAnswer:
        """The answer without effects that are refused afterwards, the others fitted again."""
        out = {(one.name, one.rotor) for one in refused}
        rest = [one for one in self.named if one.candidate.identity not in out]
        kept = [c for c in self.accepted.fit.candidates if c.identity not in out]
        accepted = _accepted(self.regression, kept, rest, dataset, (*self.accepted.refused, *refused))
        return LikelihoodAnswer(self.regression, self.selection, accepted, tuple(rest))


def answer_by_likelihood(first: Regression, dataset: Dataset, progress: Progress = no_progress) -> LikelihoodAnswer:
    """Which effects are missing. first: the regression about the vehicle's own model."""
    problem = likelihood_problem(dataset, first.vehicle, first)
    named = named_effects(problem, identify(problem, progress=progress))
    chosen = [_of_regression(first, one.candidate, one) for one in named]
    together = [(one, candidate) for one, candidate in zip(named, chosen, strict=True) if candidate is not None]
    named, own = tuple(one for one, _ in together), [candidate for _, candidate in together]
    regression = first
    if own:
        start = _start(own, named)
        estimates = {key: ParameterEstimate(value, 0.0, "") for key, value in start.items()}
        again = about(first, first.candidates, first.nuisances, Fit(first.vehicle, estimates, tuple(own)))
        if again is not None:
            regression, own = again, [_same(again.candidates, candidate) for candidate in own]
    search, before = Search(regression), gust_beside(regression, [])
    selection = Selection(search.score(own), Search(first).singles(), gust_beside(first, []), before, False)
    selection = with_gust_by(regression, selection, own)
    return LikelihoodAnswer(regression, selection, _accepted(regression, own, named, dataset, ()), named)


def likelihood_problem(dataset: Dataset, vehicle: Vehicle, regression: Regression) -> Problem:
    """The fitted flights as the filter has them."""
    vehicle, catalogue = with_command_effects(vehicle, regression.catalogue, dataset.fitted)
    rows = [make_rows(segment, group) for segment, group in zip(dataset.fitted, dataset.flight_of, strict=True)]
    return Problem(vehicle, catalogue, rows, candidates(vehicle, catalogue, dataset.fitted))


def _accepted(
    regression: Regression,
    own: Sequence[Candidate],
    named: Collection[Named],
    dataset: Dataset,
    refused: Sequence[Refused],
) -> Accepted:
    """The joint fit of the effects, and what each is worth on the held-out flights."""
    lacking = fit(regression, ()).vehicle
    fitted = fit(regression, own, vehicle=lacking, start=_start(own, named)) if own else fit(regression, ())
    fitted = beyond_feedback(regression, fitted, lacking) if own else fitted
    judge = HeldOut(regression, dataset.held_out)
    floor = judge.floor(fitted.vehicle)
    changes = {
        c.key: judge.channel_changes(left_out(fitted, c, lacking)[1], fitted.vehicle, floor) for c in fitted.candidates
    }
    sure = {one.candidate.identity: one.probability for one in named}
    return Accepted(fitted, tuple(refused), changes, {c.key: sure[c.identity] for c in own}, floor)


def _start(own: Sequence[Candidate], named: Collection[Named]) -> dict[tuple[str, str], float]:
    """Values by (key, parameter) at which the joint fit begins."""
    values = {one.candidate.identity: {**one.candidate.at, **one.values} for one in named}
    return {(c.key, name): value for c in own for name, value in values[c.identity].items()}


def _of_regression(regression: Regression, candidate: Candidate, named: Named) -> Candidate | None:
    """The regression's candidate of an effect, at the grid point that is nearest its values; None where it has none."""
    values = {**candidate.at, **named.values}
    same = [c for c in regression.candidates if c.identity == candidate.identity]

    def distance(other: Candidate) -> float:
        held = [name for name in other.at if name not in other.free]
        return sum(abs(other.at[name] - values[name]) / (abs(values[name]) + 1e-9) for name in held)

    return min(same, key=distance, default=None)


def _same(others: Sequence[Candidate], candidate: Candidate) -> Candidate:
    return next(other for other in others if other.columns == candidate.columns)
