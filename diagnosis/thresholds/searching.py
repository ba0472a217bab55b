"""Thresholds of the regression by which residuals are tested: its equations, a gust, and what residuals still hold."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from diagnosis.thresholds.group import Factor, Positive, Range, Score, Share, ThresholdGroup


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
