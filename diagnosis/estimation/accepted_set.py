"""The set of effects that is named: what was selected, with those rivals in place that need less, or leave less.

Held-out flights judge each set (`diagnosis.estimation.acceptance`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from itertools import chain

from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import Accepted, deviations_from_neutral, fit_that_keeps, judged_fit
from diagnosis.estimation.alternatives import decided_rivals, merged_pairs, on_decided_rotors
from diagnosis.estimation.equation_error import beyond_feedback, fit
from diagnosis.estimation.exchanges import with_exchanges
from diagnosis.estimation.held_out import HeldOut
from diagnosis.estimation.sure_part import as_good_as, sure_part
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.rivals import near_rivals, rivals_of, to_fit
from diagnosis.selection.search import Search
from diagnosis.selection.selected import Selection
from dynamics.vehicle import Vehicle


def accepted_fit(
    regression: Regression, selection: Selection, dataset: Dataset, vehicle: Vehicle | None = None
) -> Accepted:
    """Of the selected effects those that held-out flights bear out, fitted jointly on the others.

    vehicle: that lacks them, by default the regression's. Its own effects are fitted again beside them, since they
    were fitted without them and may have absorbed a part of them.
    """
    lacking = regression.vehicle if vehicle is None else vehicle
    decided = on_decided_rotors(regression, selection.chosen.candidates, lacking)
    chosen, worse = decided_rivals(regression, merged_pairs(regression, decided, lacking), lacking)
    accepted = judged_fit(regression, chosen, dataset, lacking, refused=worse)
    preferred = {c.key for c in chosen} - {c.key for c in selection.chosen.candidates}
    if not preferred <= set(accepted.fit.keys):  # a rival that is refused itself refuses nothing
        own = judged_fit(regression, selection.chosen.candidates, dataset, lacking)
        accepted = own if len(own.fit.keys) >= len(accepted.fit.keys) else accepted
    accepted = _with_rivals_of_refused(regression, accepted, selection.chosen.candidates, dataset, lacking)
    accepted = _replace_by_sparser_rivals(regression, accepted, dataset, lacking)
    if not regression.pose.there:  # an estimator's errors are as slow
        in_gust = selection.gust_variance > 0
        accepted = with_exchanges(regression, accepted, dataset, lacking, in_gust=in_gust)
    accepted = _replace_partly_significant(regression, accepted, dataset, lacking)
    return _prefer_rotor_damage_over_sensor_fault(regression, accepted, dataset, lacking)


def _with_rivals_of_refused(
    regression: Regression, accepted: Accepted, chosen: Sequence[Candidate], dataset: Dataset, vehicle: Vehicle
) -> Accepted:
    """Accepted set with a near rival in place of each effect that made a kind of channel worse, where it holds.

    A wrong mass and a wrong thrust constant push alike: what the moments of the one spoil, the other leaves alone. They
    are tried first with all that was selected: what was refused after it may have failed for its sake.
    """
    search, max_rivals = Search(regression), regression.thresholds.acceptance.max_rivals
    spoiling = {(one.name, one.rotor) for one in accepted.refused if one.reason == "channel_worse"}
    for candidate in [c for c in chosen if c.identity in spoiling]:
        if candidate.key in accepted.fit.keys:  # as the rival of another one
            continue
        sets = [[c for c in chosen if c is not candidate], list(accepted.fit.candidates)]
        of_sure_part = _rivals_of_sure_part(regression, accepted, candidate, vehicle)
        for others, rival in chain(of_sure_part, _rivals_in(search, sets, candidate, spoiling, max_rivals)):
            needed = {rival.key, *accepted.fit.keys}
            trial = fit_that_keeps(regression, [*others, rival], needed, dataset, vehicle, refused=accepted.refused)
            if trial is not None:
                accepted = _with_judged_again(regression, trial, candidate, chosen, dataset, vehicle)
                break
    return accepted


def _rivals_of_sure_part(
    regression: Regression, accepted: Accepted, candidate: Candidate, vehicle: Vehicle
) -> Iterator[tuple[Sequence[Candidate], Candidate]]:
    """Candidates that explain as much as the sure part of a candidate beside the accepted effects, if any does."""
    search, others = Search(regression), accepted.fit.candidates
    lacking = fit(regression, (), vehicle=vehicle).vehicle
    fitted = beyond_feedback(regression, fit(regression, [*others, candidate], vehicle=lacking), lacking)
    part = sure_part(search, fitted, candidate, lacking)
    if part is not None and (rival := as_good_as(search, others, part)) is not None:
        yield others, rival


def _rivals_in(
    search: Search,
    sets: Sequence[Sequence[Candidate]],
    candidate: Candidate,
    spoiling: Collection[tuple[str, int | None]],
    count: int,
) -> Iterator[tuple[Sequence[Candidate], Candidate]]:
    """Near rivals of a candidate beside each of some sets, so many of each, none that spoils a channel itself."""
    for others in sets:
        near = near_rivals(search, others, rivals_of(search, others, candidate))
        for scored in [s for s in near if s.candidates[-1].identity not in spoiling][:count]:
            yield others, scored.candidates[-1]


def _with_judged_again(
    regression: Regression,
    accepted: Accepted,
    spoiling: Candidate,
    chosen: Sequence[Candidate],
    dataset: Dataset,
    vehicle: Vehicle,
) -> Accepted:
    """Accepted set, refused effects judged again beside the rival that has replaced a candidate, where they hold.

    While neither was in the model its error was open, beside which chance makes a kind of channel worse.
    """
    order = [(one.name, one.rotor) for one in accepted.refused]
    later = set(order[order.index(spoiling.identity) + 1 :])
    taken = {c.identity for c in accepted.fit.candidates}
    again = [c for c in chosen if c.identity in later - taken]
    if not again:
        return accepted
    earlier = [one for one in accepted.refused if (one.name, one.rotor) not in {c.identity for c in again}]
    together = [*accepted.fit.candidates, *again]
    trial = fit_that_keeps(regression, together, accepted.fit.keys, dataset, vehicle, refused=earlier)
    return accepted if trial is None or len(trial.fit.keys) == len(accepted.fit.keys) else trial


def _replace_by_sparser_rivals(
    regression: Regression, accepted: Accepted, dataset: Dataset, vehicle: Vehicle
) -> Accepted:
    """Accepted set with rivals in place of effects where the full model fits better, or as well with fewer others.

    A thrust constant acts on force and moments, a mass on the force alone: the one beside the inertia that undoes its
    moments is the other. Turbulence lets the fit of an inertia gain more than further coefficients cost, so that what
    is left of it beside the right one decides. Where much is unexplained, nothing does.
    """
    held_out, tried = HeldOut(regression, dataset.held_out), set[frozenset[str]]()
    while len(accepted.fit.keys) > 1 and accepted.fit.chi_square <= regression.thresholds.search.still_explained:
        for keys, candidates in _fitted_rivals(regression, accepted, vehicle, tried):
            trial = fit_that_keeps(regression, candidates, keys, dataset, vehicle, refused=accepted.refused)
            if (
                trial is not None
                and set(trial.fit.keys) == keys
                and (
                    len(keys) < len(accepted.fit.keys)
                    or not held_out.worse_channels(accepted.fit.vehicle, trial.fit.vehicle)
                )
            ):
                accepted = trial
                break
        else:
            break
    return accepted


def _fitted_rivals(
    regression: Regression, accepted: Accepted, vehicle: Vehicle, tried: set[frozenset[str]]
) -> Iterator[tuple[set[str], Sequence[Candidate]]]:
    """Sets with a near rival in place of an effect that fit better, or as well and leave nothing of others.

    Each with the keys of those of which something is left. tried: sets that were fitted, of which none comes again.
    """
    limits, search, own = regression.thresholds, Search(regression), accepted.fit.candidates
    level = fit(regression, own, vehicle=vehicle).chi_square
    for candidate in own:
        others = [c for c in own if c is not candidate]
        near = near_rivals(search, others, rivals_of(search, others, candidate))
        for candidates in (rival.candidates for rival in to_fit(near, candidate, limits.acceptance.max_rivals)):
            if (keys := frozenset(c.key for c in candidates)) in tried:
                continue
            tried.add(keys)
            alike = limits.acceptance.max_redundant_ratio
            trial = fit(regression, candidates, vehicle=vehicle, level=level, goal=level * alike)
            ratio = trial.chi_square / level
            if trial.unsettled or ratio > alike:
                continue
            slow = beyond_feedback(regression, trial, vehicle)
            sure = {
                c.key for c in candidates if deviations_from_neutral(slow, c, vehicle) >= limits.relevance.deviations
            }
            if candidates[-1].key in sure and (len(sure) < len(keys) or ratio * alike < 1):
                yield sure, candidates


def _replace_partly_significant(
    regression: Regression, accepted: Accepted, dataset: Dataset, vehicle: Vehicle
) -> Accepted:
    """Accepted set, partly significant effects replaced by rivals that explain as much.

    An inertia about yaw is a torque constant, and what turbulence adds about roll and pitch is no reason against it.
    """
    search = Search(regression)
    for candidate in accepted.fit.candidates:
        others = [c for c in accepted.fit.candidates if c is not candidate]
        part = sure_part(search, accepted.fit, candidate, vehicle)
        rival = None if part is None else as_good_as(search, others, part)
        if rival is not None:
            needed = [rival.key, *(c.key for c in others)]
            trial = fit_that_keeps(regression, [*others, rival], needed, dataset, vehicle, refused=accepted.refused)
            if trial is not None:
                return trial
    return accepted


def _prefer_rotor_damage_over_sensor_fault(
    regression: Regression, accepted: Accepted, dataset: Dataset, vehicle: Vehicle
) -> Accepted:
    """Accepted set with rotor damage in place of a speed sensor's fault, where these flights cannot tell which.

    Propellers break, and a count of revolutions does not err by a few percent; whoever changes the sensor flies the
    broken propeller again. Sensors that read too low are told apart: no rotor gains thrust.
    """
    for candidate in [c for c in accepted.fit.candidates if c.effect.acts_on == "rotor_speed_reading"]:
        others = [c for c in accepted.fit.candidates if c is not candidate]
        damaged = next(
            (
                c
                for c in regression.candidates
                if c.effect.lost_thrust
                and c.rotor == candidate.rotor
                and c.effect.name in candidate.effect.confounded_with
                and all(c.key != other.key for other in others)
            ),
            None,
        )
        if damaged is not None:
            needed = [damaged.key, *(c.key for c in others)]
            trial = fit_that_keeps(regression, [*others, damaged], needed, dataset, vehicle, refused=accepted.refused)
            level = accepted.fit.chi_square * regression.thresholds.acceptance.max_redundant_ratio
            if trial is not None and trial.fit.chi_square <= level:
                accepted = trial
    return accepted
