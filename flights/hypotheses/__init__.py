"""Hypotheses about what a log's columns are, scored by how well physics closes: units, order, axes, clocks."""

from flights.hypotheses.engine import explain
from flights.hypotheses.hypothesis import Hypothesis, in_words

__all__ = ["Hypothesis", "explain", "in_words"]
