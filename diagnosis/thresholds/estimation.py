"""Thresholds of estimation: fits of the full model, and which of their effects count."""

from __future__ import annotations

from diagnosis.thresholds.group import Count, Positive, Score, Share, ThresholdGroup


class AcceptanceThresholds(ThresholdGroup, frozen=True):
    """Held-out flights judge, once, the set of effects that was selected on the others.

    max_ratio: of the held-out reduced chi-square with an effect over that without it. [margins: neither]
    """

    max_ratio: Share = 0.999


class RelevanceThresholds(ThresholdGroup, frozen=True):
    """Smallest change that matters, and chance.

    max_bias: of a sensor in standard deviations of its specification; beyond it is a fault. [convention: 99 %]
    max_rise: of an error over its floor, were all else at the floor, that is no loss. [definition]
    max_open_loop_rise: of an error of the open loop over the motion that it predicts, that is no loss. [definition:
        5 mm of a metre]
    min_axis_floor: of an axis over that of its kind; no axis is without noise. [definition]
    deviations: of an estimate from its neutral value, or of a change from none, that is not chance. [convention: 95 %]
    block: over which errors may be correlated, s. [decisions: intervals come from blocks]
    min_blocks: into which errors are divided where there are fewer of that length. [margins: neither]
    """

    max_bias: Positive = 2.5
    max_rise: Score = 0.02
    max_open_loop_rise: Score = 0.005
    min_axis_floor: Share = 1e-3
    deviations: Positive = 2.0
    block: Positive = 2.0
    min_blocks: Count = 8
