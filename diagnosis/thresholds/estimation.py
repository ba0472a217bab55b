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

    min_rise: of an error over its floor, were all else at the floor, when an effect is left out. [definition]
    max_rise: of the same that is no loss, when an effect is put in. [definition: that of `min_rise`]
    max_open_loop_rise: of an error of the open loop over the motion that it predicts, that is no loss. [definition:
        5 mm of a metre]
    min_axis_floor: of an axis over that of its kind; no axis is without noise. [definition]
    deviations: of an estimate from its neutral value, or of a change from none, that is not chance. [convention: 95 %]
    block: over which errors may be correlated, s. [decisions: intervals come from blocks]
    min_blocks: into which errors are divided where there are fewer of that length. [margins: neither]
    min_agreement: share of flight resamples that name an effect. [definition: the majority]
    """

    min_rise: Score = 0.02
    max_rise: Score = 0.02
    max_open_loop_rise: Score = 0.005
    min_axis_floor: Share = 1e-3
    deviations: Positive = 2.0
    block: Positive = 2.0
    min_blocks: Count = 8
    min_agreement: Share = 0.5
