"""Thresholds of the regression by which residuals are tested: its equations, a gust, and what residuals still hold."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from diagnosis.thresholds.group import Count, Factor, Positive, Range, Score, Share, ThresholdGroup


class RegressionThresholds(ThresholdGroup, frozen=True):
    """Normal equations of all candidates.

    ridge: on all columns at once, over the number of rows. [margins: neither]
    slow_ridge: the same of slow motion. [decisions: noise of torques]
    max_bias: of a sensor in standard deviations of its specification; beyond it is a fault. [convention: 99 %]
    independent_share: of the whitened residuals, in the criterion's penalty. [margins: neither]
    """

    ridge: Positive = 1e-6
    slow_ridge: Positive = 1e-4
    max_bias: Positive = 2.5
    independent_share: Annotated[float, Meta(gt=0, le=1)] = 0.25


class SearchThresholds(ThresholdGroup, frozen=True):
    """When a gust is claimed. A score is twice the log-likelihood gained, less the criterion's penalty.

    min_gain: score below which none is. [planted truth: feedback makes inertia reach 29 where nothing is hidden]
    relevant: gain over the number of whitened residuals below which it does not matter: a tenth of
    2 % of the floor of one kind of four. [margins: neither]
    amplitude: range of a fixed-shape regressor's coefficient. [definition: near 1]
    min_gust_share: of the effects' gain that a gust beside them must add. [margins: neither]
    """

    min_gain: Score = 40.0
    relevant: Share = 0.001
    amplitude: Range = (0.4, 1.9)
    min_gust_share: Share = 0.03


class GustThresholds(ThresholdGroup, frozen=True):
    """Random air motion.

    max_frequency: of the cosines that make it up, Hz. [formula: 86 % of the variance of a gust of 1 s lies below]
    corners: of its spectrum, the one that is marginalised first; its strength is that of the likeliest, Hz.
    [definition: correlation times of 1, 2 and 0.5 s]
    intensity: range of its strength that is tried, m/s. [definition: from nothing to a storm]
    strengths: that are tried in it. [formula: neighbours differ by a third]
    part: of a segment whose air is independent of that of the others, s. [formula: many correlation times]
    over_error: by which it must exceed an estimator's error of velocity, which is in several channels at once.
    [results/verdicts.md: that error looks like gusts of 0.5 to 1.7 times its size]
    """

    max_frequency: Positive = 0.7
    corners: tuple[Positive, ...] = (0.15, 0.08, 0.3)
    intensity: tuple[Positive, Positive] = (0.01, 15.0)
    strengths: Annotated[int, Meta(ge=3)] = 26
    part: Positive = 30.0
    over_error: Factor = 2.0


class ResidualTestThresholds(ThresholdGroup, frozen=True):
    """Tests of what an identified model leaves; `VerdictThresholds` holds their limits.

    features: random Fourier features of state or position. [margins: neither]
    chances: surrogate (time-shifted) residuals, of which the most predictable shows what chance predicts.
        [formula: one in nine exceeds all of eight]
    state_fineness: of a feature of the state, over the standard deviation of the state. [margins: neither]
    velocity_fineness: the same of the body's velocity alone, on which forces of the air depend. [margins: neither]
    position_fineness: the same of position alone, where a field of air repeats. [margins: neither]
    ridges: that are tried. [margins: neither]
    low_band: in which accelerometer and pose must not agree, Hz. [margins: neither]
    reference_band: against which that is compared, Hz. [margins: double]
    line_band: in which a spectral line is sought, Hz. [margins: neither]
    line_rows: of a periodogram. [margins: neither]
    line_refinement: frequencies within a bin of which a line's own is the best. [definition]
    line_surroundings: bins over which a line's surroundings are the median. [margins: neither]
    agreement_powers: independent ones in the low band with which `max_agreement` holds; with fewer a torque's slow part
    exceeds it by chance. [`results/short_logs.md`, seeds from
    930,000: torques are 2.75 times as strong there]
    window_width: noise bandwidth of a window of Hann, bins. [formula]
    chance: probability with which noise alone exceeds what counts as a line or as slow. [definition]
    line_draws: of residuals with random signs, to whose strongest lines a distribution is given. [formula: the
    deviation of 100 values holds to 7 %]
    state_shift: by which the state is taken later, and earlier, where it predicts, s. [results/counts.md,
    seeds 24000 on: where nothing was hidden it predicts 6 to 27 times as much later as earlier, of forms outside the
    catalogue 0.9 to 1.2 times]
    """

    chances: Count = 8
    features: Count = 120
    state_fineness: Positive = 0.35
    velocity_fineness: Positive = 1.5
    position_fineness: Positive = 1.5
    ridges: tuple[Positive, ...] = (1e2, 1e3, 1e4, 1e5)
    low_band: Range = (0.05, 1.5)
    reference_band: Range = (2.5, 6.5)
    line_band: Range = (0.6, 7.0)
    line_rows: Annotated[int, Meta(ge=64)] = 512
    line_refinement: Count = 9
    line_surroundings: Count = 61
    agreement_powers: Count = 25
    window_width: Factor = 1.5
    chance: Share = 1e-3
    line_draws: Annotated[int, Meta(ge=10)] = 100
    state_shift: Positive = 0.16
