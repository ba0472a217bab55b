"""Thresholds of the regression that makes residuals and their noise."""

from __future__ import annotations

from diagnosis.thresholds.group import Positive, ThresholdGroup


class RegressionThresholds(ThresholdGroup, frozen=True):
    """Normal equations of all candidates.

    ridge: on all columns at once, over the number of rows. [margins: neither]
    slow_ridge: the same of slow motion. [decisions: noise of torques]
    max_bias: of a sensor in standard deviations of its specification; beyond it is a fault. [convention: 99 %]
    """

    ridge: Positive = 1e-6
    slow_ridge: Positive = 1e-4
    max_bias: Positive = 2.5
