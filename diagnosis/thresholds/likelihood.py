"""Decisions of the likelihood: rows, how the noise is fitted, and when a search ends."""

from __future__ import annotations

from diagnosis.thresholds.group import Count, Positive, Range, Share, ThresholdGroup


class LikelihoodThresholds(ThresholdGroup, frozen=True):
    """The filter of flights and the search on its innovations.

    row_rate: Hz, about which rows are means of the log's. [cost: in proportion to it]
    burn_in: s of a segment in which the filter settles. [convention: ten times the turbulence's time constant and more]
    block: s of flight whose sum is one draw of the score's scatter. [definition: longer than innovations correlate]
    first_seconds: of flight on which noise is fitted from afar. [cost]
    seconds: of flight on which it is fitted, and of a piece of one at most. [cost: memory in proportion to a piece]
    first_steps: of scoring on the first. [decisions: structures are then thousands apart, or alike]
    steps: the same on the second. [cost]
    converged: gain of the log-likelihood by a step that ends them. [formula: far below one]
    ridge: prior of all candidates while noise is fitted, of their own information. [formula: rounding]
    rounds: of search, each linear about the last one's answer. [cost]
    settled_rounds: after which, or where nothing moves, the noise is fitted again beside the set, and its values are
        among the nuisances. [definition: near the optimum]
    near: largest step of a value in the round before, in its deviations, with which they are. [definition: what a
        model that is farther off leaves is taken for noise, and the slopes in the noise for slopes of the model]
    settled_step: of a value in its deviations, at which rounds end. [definition: well below its deviation]
    trusted: s of flight whose evidence counts, however long the flights are: no model is right to more than its share
        of each second. [decisions: calibrated on other seeds than the page's, and on its recordings]
    named: log of the odds of the best set against that without an effect, from which on it is named; within it
        others are as likely in its place. [convention: 20 to 1]
    linear: of what an effect gains, by which one that looks like it may fit worse and be as likely: its column is
        linear about its neutral value. [formula: the square of a size of a tenth]
    form: of what effects make, over which what is left of a function of the state refutes their form. [decisions:
        right forms leave 0.00 to 0.14, a form in place of another from 0.3]
    max_left: discrepancies that are sought beside each other. [cost]
    line_turns: of a line in the longest flight, below which it is a change with time. [definition]
    line_highest: frequency of a line over the rows' rate. [definition: below half]
    line_surroundings: frequencies that a flight tells apart, over whose median power a line is. [convention]
    amplitude: range of the size of a lag whose shape is fixed, over that at which it was tried. [definition: near 1]
    max_effects: in one set. [convention]
    bound_slack: of a value of the file's own effects, in its stated deviations, by which noise may carry it over a
        bound, where it then stays. [convention: 95 %]
    min_improvement: of the log-evidence, below which no step is taken. [formula: rounding ends no search]
    """

    row_rate: Positive = 100.0
    burn_in: Positive = 1.0
    block: Positive = 2.0
    first_seconds: Positive = 15.0
    seconds: Positive = 45.0
    first_steps: Count = 6
    steps: Count = 6
    converged: Positive = 0.05
    ridge: Positive = 1e-4
    rounds: Count = 6
    settled_rounds: Count = 2
    near: Positive = 3.0
    settled_step: Positive = 0.3
    trusted: Positive = 2.0
    named: Positive = 3.0
    linear: Share = 0.01
    form: Share = 0.2
    max_left: Count = 6
    line_turns: Positive = 3.0
    line_highest: Share = 0.4
    line_surroundings: Count = 30
    amplitude: Range = (0.4, 1.9)
    max_effects: Count = 10
    bound_slack: Positive = 2.0
    min_improvement: Positive = 0.5
