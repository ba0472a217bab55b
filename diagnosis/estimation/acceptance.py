"""Acceptance of the selected effects: held-out flights judge, once, what was selected on the others.

An effect is named where its absence shows: the others are fitted again without it, and the error of a kind of channel
must rise by what matters, on no kind may it fall by more than chance. Its interval must exclude its neutral value and
most resamples of the flights must agree. What fails is refused with its reason, the weakest effect first, until all
that remain hold.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from diagnosis.data.dataset import Dataset
from diagnosis.estimation.equation_error import beyond_feedback, fit
from diagnosis.estimation.fitted import Fit, left_out, neutral_values, with_candidates
from diagnosis.estimation.held_out import HeldOut
from diagnosis.estimation.paired_errors import ErrorChange, total_change
from diagnosis.estimation.refusal import Reason, Refused
from diagnosis.estimation.significance import deviations_of
from diagnosis.models import channels
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.rivals import look_alikes, resample_share, rivals_of
from diagnosis.selection.search import Search
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Accepted:
    """The effects that are named.

    fit: of them.
    refused: what was selected and is not among them.
    relevance: by an effect's key and kind of channel, held-out error without it (`before`) and with it (`after`).
    agreement: share of flight resamples that name it or one that the flights cannot tell from it, by key.
    floor: (12,) noise floor of the held-out flights.
    """

    fit: Fit
    refused: tuple[Refused, ...]
    relevance: Mapping[str, Mapping[str, ErrorChange]]
    agreement: Mapping[str, float]
    floor: Floats


def judged_fit(
    regression: Regression,
    candidates: Sequence[Candidate],
    dataset: Dataset,
    vehicle: Vehicle,
    *,
    refused: Sequence[Refused] = (),
    resampled: bool = True,
    small: Collection[str] = (),
) -> Accepted:
    """Of certain effects those that held-out flights bear out, fitted jointly on the others, whatever their rivals.

    refused: effects that have been refused before. resampled: whether most flight resamples must agree. small: keys of
    those that may be too small on what is held out if they matter on the fitted flights.
    """
    return _judged(regression, candidates, dataset, vehicle, refused, resampled=resampled, small=small)


def fit_that_keeps(
    regression: Regression,
    candidates: Sequence[Candidate],
    needed: Collection[str],
    dataset: Dataset,
    vehicle: Vehicle,
    *,
    refused: Sequence[Refused] = (),
) -> Accepted | None:
    """Accepted set that keeps the needed effects, of these keys; None as soon as one of them fails.

    Most trials of rivals end so, and after that no fit of what remains says more.
    """
    try:
        return _judged(regression, candidates, dataset, vehicle, refused, needed=needed)
    except _NeededEffectError:
        return None


def _judged(
    regression: Regression,
    candidates: Sequence[Candidate],
    dataset: Dataset,
    vehicle: Vehicle,
    refused: Sequence[Refused],
    *,
    resampled: bool = True,
    small: Collection[str] = (),
    needed: Collection[str] = (),
) -> Accepted:
    lacking = fit(regression, (), vehicle=vehicle).vehicle  # with the gain of commands that fits without the effects
    trial = _Trial(regression, dataset, lacking, resampled=resampled, small=small, needed=needed)
    own = _own_effects(regression, candidates, refused)
    return trial.reduced([*candidates, *own], {c.key for c in candidates}, refused)


class _NeededEffectError(Exception):
    """An effect fails without which the rest of a trial is of no use."""


def _own_effects(regression: Regression, chosen: Sequence[Candidate], refused: Sequence[Refused]) -> list[Candidate]:
    """Corrections of the vehicle file's own effects that improve the score of the chosen ones, none that is refused."""
    if not chosen:
        return []
    names = {(u.name, u.rotor) for u in regression.vehicle.effects} - {(one.name, one.rotor) for one in refused}
    taken, search = {c.key for c in chosen}, Search(regression)
    own = [c for c in regression.candidates if c.identity in names and not c.fixed_shape and c.key not in taken]
    alone = search.score(chosen).score
    return [c for c in own if search.score([*chosen, c]).score > alone]


class _Trial:
    """The trial of effects that a vehicle lacks, on held-out flights."""

    def __init__(
        self,
        regression: Regression,
        dataset: Dataset,
        vehicle: Vehicle,
        *,
        resampled: bool,
        small: Collection[str],
        needed: Collection[str],
    ) -> None:
        self._small, self._needed = small, set(needed)
        self._regression, self._fitted, self._vehicle = regression, dataset.fitted, vehicle
        self._limits, self._search = regression.thresholds.relevance, Search(regression)
        self._held_out, self._resampled = HeldOut(regression, dataset.held_out), resampled
        self._fits: dict[frozenset[str], Fit] = {}
        self._shares: dict[tuple[frozenset[str], str], float] = {}
        self._by_itself: dict[tuple[Fit, str], dict[str, ErrorChange]] = {}

    def reduced(self, candidates: Sequence[Candidate], chosen: set[str], refused: Sequence[Refused]) -> Accepted:
        """Leave out the weakest effect that fails, until none does. chosen: keys of those that are not the file's.

        Raises _NeededEffectError.
        """
        best, refused = self._fit(candidates), list(refused)
        while True:
            relevance, floor = self._relevance(best)
            failing = [(c, r) for c in best.candidates if (r := self._failure(best, c, relevance[c.key])) is not None]
            failing = failing or self._channel_failure(best) or self._open_loop_failure(best)
            if not failing:
                break
            weakest, failure = min(failing, key=lambda pair: _strength(relevance[pair[0].key]))
            left = [
                c for c, _ in failing if c.key not in chosen
            ]  # corrections of the file's effects first, all at once
            if not left:
                left = [weakest]
                refused = [one for one in refused if (one.name, one.rotor) != weakest.identity]  # by another set
                refused.append(failure)
            if not self._needed.isdisjoint(c.key for c in left):
                raise _NeededEffectError
            best = self._fit([c for c in best.candidates if c not in left])
        agreement = {c.key: self._agreement(best, c) for c in best.candidates}
        named = {c.identity for c in best.candidates}  # beside other effects one of them may have been refused before
        still = tuple(one for one in refused if (one.name, one.rotor) not in named)
        return Accepted(best, still, relevance, agreement, floor)

    def _fit(self, candidates: Sequence[Candidate], start: Mapping[tuple[str, str], float] | None = None) -> Fit:
        keys = frozenset(c.key for c in candidates)
        if keys not in self._fits:
            fitted = fit(self._regression, candidates, vehicle=self._vehicle, start=start)
            self._fits[keys] = beyond_feedback(self._regression, fitted, self._vehicle)
        return self._fits[keys]

    def _relevance(self, best: Fit) -> tuple[dict[str, dict[str, ErrorChange]], Floats]:
        """Change of the errors by each effect, by key and kind of channel, and the held-out floor (12,)."""
        floor = self._held_out.floor(best.vehicle)
        return {c.key: self._error_changes(best, c, floor) for c in best.candidates}, floor

    def _error_changes(self, best: Fit, candidate: Candidate, floor: Floats) -> dict[str, ErrorChange]:
        """Errors without an effect and with it, by kind of channel, on the held-out flights if it shows there."""
        values, fewer = left_out(best, candidate, self._vehicle)
        judge = self._held_out
        if not all(np.isfinite(y).all() for y in judge.rows(fewer)):  # at bounds, as a rotor that is read as standing
            values, fewer = best.values, self._lacking(best, candidate)
        if not self._shows(judge, best.vehicle, fewer):
            judge, floor = self._others, self._regression.noise.floor
        return self._judged_by(judge, floor, best, candidate, fewer, values)

    def _judged_by(
        self,
        judge: HeldOut,
        floor: Floats,
        best: Fit,
        candidate: Candidate,
        fewer: Vehicle,
        values: Mapping[tuple[str, str], float],
    ) -> dict[str, ErrorChange]:
        """Changes of errors on certain flights. fewer: the vehicle without it, to first order; values: the others'."""
        thresholds = self._regression.thresholds.acceptance
        by_kind = judge.channel_changes(fewer, best.vehicle, floor)
        if self._limits.min_rise <= _strength(by_kind) < thresholds.max_linear_rise:
            again = self._fit([c for c in best.candidates if c is not candidate], values)
            by_kind = judge.channel_changes(again.vehicle, best.vehicle, floor)
        return by_kind

    @cached_property
    def _others(self) -> HeldOut:
        """The fitted flights, which judge what does not show on the held-out ones."""
        return HeldOut(self._regression, self._fitted)

    def _failure(self, best: Fit, candidate: Candidate, by_kind: Mapping[str, ErrorChange]) -> Refused | None:
        """The first test that an effect fails, None where it passes all."""
        limits, kinds = self._limits, list(by_kind)

        def refused(reason: Reason, where: str = "", **detail: float) -> Refused:
            return refused_of(best, candidate, reason, where, **detail)

        if candidate.key in best.unsettled:
            return refused("not_converged")
        if (bound := at_its_bounds(best, candidate, self._vehicle)) is not None:
            return refused("at_bound", bound)
        strongest = max(kinds, key=lambda kind: by_kind[kind].fall)
        if not by_kind[strongest].fall >= limits.min_rise and not self._matters_where_fitted(best, candidate):
            change = by_kind[strongest]
            numbers = {"before": change.before, "after": change.after, "floor": change.floor}
            replaced = _strength(self._alone(best, candidate)) >= limits.min_rise
            return refused("redundant" if replaced else "too_small", strongest, **numbers)
        if candidate.effect.moves_vehicle and (slight := self._slight(best, candidate)) is not None:
            return slight
        alone = self._alone(best, candidate).get("imu") if _is_force(candidate) else None
        if alone is not None and alone.is_contradicted(limits):
            numbers = {"before": alone.before, "after": alone.after, "floor": alone.floor, "size": alone.size}
            return refused("contradicted", "imu", **numbers)
        own = {kind: by_kind[kind] for kind in kinds if kind != "attitude_rate" or not candidate.effect.moves_vehicle}
        worst, not_confirmed = max(own, key=lambda kind: own[kind].rise), total_change(own) > 0
        if not not_confirmed and (acted := self._kind_of(best, candidate)) in own and own[acted].rise > 0:
            worst, not_confirmed = acted, True
        for kind, change in own.items():  # a motion's effect shows in the attitude rate by clocks alone
            if change.is_worse(limits) or (not_confirmed and kind == worst):
                numbers = {"before": change.before, "after": change.after, "floor": change.floor}
                return refused("channel_worse", kind, **numbers)
        deviations = deviations_from_neutral(best, candidate, self._vehicle)
        if deviations < limits.deviations:
            return refused("interval_holds_neutral", deviations=deviations, required=limits.deviations)
        share = self._agreement(best, candidate)
        if self._resampled and share < limits.min_agreement:
            return refused("few_resamples", share=share, required=limits.min_agreement)
        return None

    def _slight(self, best: Fit, candidate: Candidate) -> Refused | None:
        """The refusal of an effect that changes next to nothing of the motion of any channel; None of another one."""
        fewer = self._lacking(best, candidate)
        judge = self._held_out if self._shows(self._held_out, best.vehicle, fewer) else self._others
        shares = judge.shares_of_motion(fewer, best.vehicle)[list(self._regression.noise.active)]
        if not shares.max() < self._limits.min_motion:
            return None
        kind = channels.KINDS[self._regression.noise.active[int(np.argmax(shares))] // channels.AXES]
        return refused_of(best, candidate, "slight", kind, share=float(shares.max()), required=self._limits.min_motion)

    def _matters_where_fitted(self, best: Fit, candidate: Candidate) -> bool:
        """Whether an effect that may be too small on what is held out matters on the fitted flights."""
        if candidate.key not in self._small:
            return False
        values, fewer = left_out(best, candidate, self._vehicle)
        by_kind = self._judged_by(self._others, self._regression.noise.floor, best, candidate, fewer, values)
        return _strength(by_kind) >= self._limits.min_rise

    def _kind_of(self, best: Fit, candidate: Candidate) -> str:
        """The kind of channel in which an effect changes most, over its floor; empty where held-out flights show none.

        An inertia moves forces, too, by the clocks and the thrust of commands that fit beside it.
        """
        if not self._shows(self._held_out, best.vehicle, left_out(best, candidate, self._vehicle)[1]):
            return ""
        alone = self._alone(best, candidate)
        return max(alone, key=lambda kind: alone[kind].size / alone[kind].floor)

    def _shows(self, judge: HeldOut, one: Vehicle, other: Vehicle) -> bool:
        """Whether flights show the difference of two vehicles."""
        required = self._regression.thresholds.acceptance.min_held_out_change
        return _squared_change(judge.rows(one), judge.rows(other), self._regression) >= required

    def _alone(self, best: Fit, candidate: Candidate) -> dict[str, ErrorChange]:
        """Held-out errors without an effect and with it, by kind of channel, the others staying as they are."""
        place = (best, candidate.key)
        if place not in self._by_itself:
            fewer, floor = self._lacking(best, candidate), self._held_out.floor(best.vehicle)
            self._by_itself[place] = self._held_out.channel_changes(fewer, best.vehicle, floor)
        return self._by_itself[place]

    def _lacking(self, best: Fit, candidate: Candidate) -> Vehicle:
        """The fitted vehicle without an effect, the others staying as they are."""
        values = {f"{key}.{name}": value for (key, name), value in best.values.items()}
        others = [c for c in (*best.candidates, *best.nuisances) if c is not candidate]
        return with_candidates(self._vehicle, others, values)

    def _agreement(self, best: Fit, candidate: Candidate) -> float:
        """Share of flight resamples that name an effect, or one that these flights cannot tell from it."""
        place = (frozenset(best.keys), candidate.key)
        if place not in self._shares:
            others = [c for c in best.candidates if c is not candidate]
            rivals = rivals_of(self._search, others, candidate)
            near = look_alikes(self._search, others, rivals)
            self._shares[place] = resample_share(self._search, others, rivals, near)
        return self._shares[place]

    def _channel_failure(self, best: Fit) -> list[tuple[Candidate, Refused]]:
        """The effect without which a kind of channel is best that all together make worse; empty where none is worse.

        One by one they may make it better: two that oppose each other do, and are worse together than neither.
        """
        floor = self._held_out.floor(best.vehicle)

        def compare(before: Vehicle, after: Vehicle) -> dict[str, ErrorChange]:
            by_kind = self._held_out.channel_changes(before, after, floor)
            return {kind: change for kind, change in by_kind.items() if kind != "attitude_rate"}

        joint = self._worse_together(best, compare)
        if joint is None or len(joint.moving) < 2:  # one alone has been judged
            return []
        numbers = {"before": joint.change.before, "after": joint.change.after, "floor": joint.change.floor}
        return [(joint.culprit, refused_of(best, joint.culprit, "channel_worse", joint.place, **numbers))]

    def _open_loop_failure(self, best: Fit) -> list[tuple[Candidate, Refused]]:
        """The effect that makes an open-loop error worse, if any does; empty where none is worse."""
        joint = self._worse_together(best, self._held_out.open_loop_changes)
        if joint is None:
            return []
        numbers = {"before": joint.change.before, "after": joint.change.after, "motion": joint.change.motion}
        return [(joint.culprit, refused_of(best, joint.culprit, "open_loop_worse", joint.place, **numbers))]

    def _worse_together(
        self, best: Fit, compare: Callable[[Vehicle, Vehicle], Mapping[str, ErrorChange]]
    ) -> _Joint | None:
        """The error that all effects together make worse by most, None without any. compare: by place of the error."""
        moving = [c for c in best.candidates if c.effect.moves_vehicle]
        before = with_faults_of(best, self._vehicle)
        errors = compare(before, best.vehicle) if moving else {}
        worse = {place: change for place, change in errors.items() if change.is_worse(self._limits)}
        if worse and best.nuisances:
            alike = compare(with_nuisances_of(best, self._vehicle), best.vehicle)
            worse = {place: change for place, change in worse.items() if alike[place].is_worse(self._limits)}
        if not worse:
            return None
        place, change = max(worse.items(), key=lambda item: item[1].rise)

        def without(candidate: Candidate) -> float:
            return compare(before, left_out(best, candidate, self._vehicle)[1])[place].after

        return _Joint(place, change, moving, min(moving, key=without))


@dataclass(frozen=True, eq=False)
class _Joint:
    """An error that effects make worse together.

    place: of the error, a kind of channel or a quantity of the open loop. change: of it. moving: the effects.
    culprit: the one without which it is least.
    """

    place: str
    change: ErrorChange
    moving: Sequence[Candidate]
    culprit: Candidate


def refused_of(fitted: Fit, candidate: Candidate, reason: Reason, where: str = "", **detail: float) -> Refused:
    """The refusal of a fitted candidate, with its values."""
    values = {name: e.value for (key, name), e in fitted.estimates.items() if key == candidate.key}
    return Refused(candidate.effect.name, candidate.rotor, reason, detail, where, values)


def with_faults_of(fitted: Fit, vehicle: Vehicle) -> Vehicle:
    """A vehicle with the sensors' faults of a fit, which do not move it, so that both predict the same motion."""
    faults = [c for c in fitted.candidates if not c.effect.moves_vehicle]
    values = {f"{key}.{name}": estimate.value for (key, name), estimate in fitted.estimates.items()}
    return with_candidates(vehicle, faults, values)


def with_nuisances_of(fitted: Fit, vehicle: Vehicle) -> Vehicle:
    """Vehicle with the effects between command and thrust as in the fit.

    A gain that moves within its own deviation, as it does beside any effect, moves the open loop by that much: what
    rises against this vehicle as well is the effects' doing.
    """
    faults = [c for c in fitted.candidates if not c.effect.moves_vehicle]
    values = {f"{key}.{name}": value for (key, name), value in fitted.values.items()}
    return with_candidates(vehicle, [*faults, *fitted.nuisances], values)


def _strength(by_kind: Mapping[str, ErrorChange]) -> float:
    """By how much the error of some axis of a kind of channel would rise over its floor without an effect."""
    return max((change.fall for change in by_kind.values()), default=0.0)


def _squared_change(one: Sequence[Floats], other: Sequence[Floats], regression: Regression) -> float:
    """Squared whitened difference of residuals (m, 12)."""
    return sum(float(np.sum(regression.noise.whiten(a - b) ** 2)) for a, b in zip(one, other, strict=True))


def _is_force(candidate: Candidate) -> bool:
    """Whether an effect pushes the vehicle, which the accelerometer shows."""
    return candidate.effect.wrench is not None or candidate.effect.wind is not None


def deviations_from_neutral(best: Fit, candidate: Candidate, vehicle: Vehicle) -> float:
    """Standard deviations by which an effect's size differs from none, or from the vehicle file's own value.

    Over all parameters in which the effect is linear together; 2 is a probability of 95 %. The others, such as the
    length of a line, are as fitted: how large they are is no doubt that there is an effect. A rotor that lost torque
    alone is no rotor that lost thrust, whatever the torque.
    """
    values, neutral = list(best.estimates.values()), neutral_values(best, candidate, vehicle)
    names, lost = [name for _, name in best.estimates], candidate.effect.lost_thrust
    places = [i for i in neutral if lost in ("", names[i])]
    if not places:
        return 0.0
    distance = np.array([values[i].value - neutral[i] for i in places])
    others = [i for i in best.of(candidate) if i not in neutral]
    covariance = best.covariance[np.ix_(places, places)]
    if others:
        across = best.covariance[np.ix_(places, others)]
        covariance = covariance - across @ np.linalg.pinv(best.covariance[np.ix_(others, others)]) @ across.T
    return deviations_of(distance, covariance)


def at_its_bounds(trial: Fit, candidate: Candidate, vehicle: Vehicle) -> str | None:
    """The parameter that a fit has driven to a physical bound, where it likely absorbs another effect, if any.

    The vehicle file may name an effect that does not exist: its own one may go to its neutral value.
    """
    if not candidate.effect.moves_vehicle:  # a sensor may well be dead
        return None
    own = any((use.name, use.rotor) == (candidate.effect.name, candidate.rotor) for use in vehicle.effects)
    limits = {p.name: {p.lower, p.upper} - ({p.neutral} if own else set()) for p in candidate.effect.parameters}
    at = (name for (key, name), e in trial.estimates.items() if key == candidate.key and e.value in limits[name])
    return next(at, None)
