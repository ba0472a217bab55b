"""Thresholds of estimation: fits of the full model, and which of their effects count."""

from __future__ import annotations

from diagnosis.thresholds.group import Count, Factor, Positive, Score, Share, ThresholdGroup


class EquationErrorThresholds(ThresholdGroup, frozen=True):
    """Gauss-Newton on accelerations.

    max_steps: of Gauss-Newton. [margins: neither]
    max_cost_growth: factor on the cost beyond which a step is halved. [margins: neither]
    damping: share of each parameter's information that is added first where Gauss-Newton does not go straight.
        [convention: 1e-3 to 1e-2; the steps change it]
    damping_factor: by which that grows after a step that fits worse, and falls after one that fits better.
        [convention: ten]
    max_damped: steps so damped. [decisions: Gauss-Newton goes on from where they lead]
    min_damped_fall: share of the cost by which each of them must improve the fit. [decisions: instruments lead on]
    converged: step over the standard deviation at which it ends. [formula: a bias of as
    much takes 0.005 % off an interval's coverage]
    max_unsettled: the same beyond which a fit that has ended has no interval. [definition: the step leaves it]
    hopeless: reduced chi-square over that of a set that it is compared with, above which a fit whose way was not
        straight is not made again. [decisions: damped steps took the most off a true set that ended at 5.5 times]
    min_progress: share of what is above a cost that must be reached, which a step must take off: with less, none of
        those that are left reaches it. [formula: max_steps of them take 0.57 off]
    max_stalled: consecutive steps below min_progress. [definition: the first may lead over a rise]
    difference_step: of finite differences, relative. [formula: slopes are off by half of it, and no estimate is]
    block: over which residuals may be correlated, s. [decisions: intervals come from blocks]
    prior_blocks: as many as which the noise model counts where blocks vary less. [docs/lab/diagnosis.md, intervals]
    min_excess: reduced chi-square of a channel above which it is weighed by its own residuals, with commands.
    [margins: neither]
    """

    max_steps: Count = 8
    max_cost_growth: Factor = 1.001
    damping: Share = 0.01
    damping_factor: Factor = 10.0
    max_damped: Count = 12
    min_damped_fall: Share = 0.01
    converged: Positive = 0.02
    max_unsettled: Positive = 1.0
    hopeless: Factor = 6.0
    min_progress: Share = 0.1
    max_stalled: Count = 2
    difference_step: Positive = 0.02
    block: Positive = 2.0
    prior_blocks: Positive = 4.0
    min_excess: Factor = 1.2


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
