"""Random air motion with a gust's spectrum: the strength at which the residuals are most likely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import GustProfile, Regression
from diagnosis.thresholds import DEFAULT, GustThresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect


@dataclass(frozen=True)
class Gust:
    """A gust as far as flights show it.

    gain: twice the log-likelihood gained.
    score: the gain less its penalty.
    intensity: m/s, through the drag of the model, or a usual rotor drag where it has none, of the likeliest spectrum
        where it is measured.
    std: of the intensity, m/s, from the likelihood's profile.
    share: of flight resamples in which a gust is more likely than none.
    corner: of its likeliest spectrum, Hz.
    effect: the catalogue's stochastic effect; None where it holds none, or no wind to regress.
    """

    gain: float = 0.0
    score: float = -np.inf
    intensity: float = 0.0
    std: float = 0.0
    share: float = 0.0
    corner: float = DEFAULT.gust.corners[0]
    effect: Effect | None = None

    @property
    def variance(self) -> float:
        """Of the air's velocity along each horizontal axis, (m/s)^2."""
        return self.intensity**2


@dataclass(frozen=True, eq=False)
class AirMotion:
    """Random air motion before and beside the effects. detected: whether a gust is among what is missing."""

    before: Gust
    gust: Gust
    detected: bool


def air_beside(regression: Regression, before: Gust, candidates: Sequence[Candidate]) -> AirMotion:
    """The air that a regression shows beside certain effects. before: them."""
    columns = [i for c in candidates for i in c.columns]
    gust = gust_beside(regression, columns)
    required = regression.thresholds.search.min_gust_share * regression.gain(columns)
    return AirMotion(before, gust, _is_gust(gust, regression, required))


def gust_variance(regression: Regression, chosen: Sequence[Candidate]) -> float:
    """Variance of the gust beside a set, (m/s)^2; 0 where it does not gain enough, or is the strongest that is tried,
    or no denser than an estimator's error, which the noise has already.

    The strongest stands in for a force that is none of the air: it leaves the forces nothing of slow motion, beside
    which a drag that is there has impossible values.
    """
    gust = gust_beside(regression, [i for c in chosen for i in c.columns], measured=False)
    none = gust.score < regression.thresholds.search.min_gain or _is_strongest(gust, regression)
    none |= gust.intensity <= _error_as_gust(gust, regression)
    return 0.0 if none else gust.variance


def gust_beside(regression: Regression, chosen: Sequence[int], *, measured: bool = True) -> Gust:
    """The gust of greatest likelihood beside the chosen columns.

    measured: whether its interval and its share of resamples are computed, too.
    """
    effect = next((e for e in regression.catalogue.values() if e.stochastic and e.wind is not None), None)
    if effect is None or not regression.feels_air:
        return Gust()
    thresholds = regression.thresholds.gust
    strengths = np.geomspace(*thresholds.intensity, thresholds.strengths)
    variances = [0.0, *(strengths**2).tolist()]
    profile = regression.gust_profile(chosen, variances)
    gains = _over_still_air(profile)
    gain, intensity, std = _peak(strengths, gains)
    penalty = _penalty(regression, thresholds)
    if not measured or not intensity:
        return Gust(gain, gain - penalty, intensity, std, effect=effect)
    others = [regression.gust_profile(chosen, variances, corner) for corner in range(1, len(thresholds.corners))]
    of_corners = np.array([gains, *map(_over_still_air, others)])
    _, intensity, std = _peak(strengths, of_corners.max(axis=0))
    share = _share(profile, penalty, regression.thresholds.verdict.resamples)
    corner = thresholds.corners[int(np.argmax(of_corners.max(axis=1)))]
    return Gust(gain, gain - penalty, intensity, std, share, corner, effect)


def signal_of(gust: Gust, regression: Regression) -> Floats | None:
    """(12,) RMS of what air of its intensity makes in the rows of each channel; None where no wind is regressed."""
    wind = next((c.columns for c in regression.candidates if c.effect.wind is not None), None)
    if wind is None:
        return None
    slopes = np.concatenate([x[:, :, list(wind)[:2]] for x in regression.columns])  # by world x and y, 1/s
    return np.asarray(gust.intensity * np.sqrt(np.mean(np.sum(slopes**2, axis=2), axis=0)))


def _over_still_air(profile: GustProfile) -> Floats:
    """(v,) twice the log-likelihood that the gusts of a profile gain over its first variance, still air."""
    total = profile.total()
    return np.asarray(total[1:] - total[0])


def _penalty(regression: Regression, thresholds: GustThresholds) -> float:
    """The criterion's penalty of one more parameter that was sought among several values."""
    return float(np.log(regression.independent) + 2 * np.log(thresholds.strengths))


def _peak(strengths: Floats, gains: Floats) -> tuple[float, float, float]:
    """Greatest gain over still air, strength there and its standard deviation; zeros where still air is likelier.

    The deviation is half the range in which the gain, twice a log-likelihood, is within 1 of its greatest value.
    """
    best = int(np.argmax(gains))
    if gains[best] <= 0:
        return 0.0, 0.0, 0.0
    fine = np.geomspace(strengths[0], strengths[-1], 100 * len(strengths))
    curve = np.interp(np.log(fine), np.log(strengths), gains)
    if 0 < best < len(strengths) - 1:  # the parabola through the greatest value and its neighbours
        around = slice(best - 1, best + 2)
        near = (fine > strengths[best - 1]) & (fine < strengths[best + 1])
        parabola = np.polyfit(np.log(strengths[around] / strengths[best]), gains[around], 2)
        curve[near] = np.polyval(parabola, np.log(fine[near] / strengths[best]))
    top = int(np.argmax(curve))
    inside = fine[curve > curve[top] - 1]
    low = 0.0 if curve[top] < 1 else float(inside[0])
    return float(curve[top]), float(fine[top]), max((float(inside[-1]) - low) / 2, 0.0)


def _share(profile: GustProfile, penalty: float, resamples: int) -> float:
    """Share of flight resamples in which some gust gains more than its penalty."""
    random, count = np.random.default_rng(0), profile.gains.shape[1]
    drawn = [random.choice(count, count) for _ in range(resamples)]
    total = profile.total(np.array([np.bincount(flights, minlength=count) for flights in drawn], dtype=float))
    return float(np.mean(total.max(axis=1) - total[:, 0] > penalty))


def _is_gust(gust: Gust, regression: Regression, min_score: float) -> bool:
    """Whether random air motion is a gust: clear in most resamples, and surely denser than an estimator's error.

    One as strong as the strongest that was tried stands in for a force that is none of the air.
    """
    limits, relevant = regression.thresholds.relevance, regression.thresholds.search
    surely = gust.intensity - limits.deviations * gust.std
    clear = surely > 0.0 and gust.share >= limits.min_agreement
    air = _error_as_gust(gust, regression) < surely and not _is_strongest(gust, regression)
    required = max(relevant.min_gain, relevant.relevant * regression.total, min_score)
    return clear and air and gust.score >= required


def _error_as_gust(gust: Gust, regression: Regression) -> float:
    """Intensity, m/s, of a gust with the same corner that an estimator's error of velocity may be."""
    return regression.thresholds.gust.over_error * regression.pose.as_gust(gust.corner)


def _is_strongest(gust: Gust, regression: Regression) -> bool:
    return gust.intensity >= (1 - 1e-6) * regression.thresholds.gust.intensity[1]
