"""Hypotheses about what a log's columns are, scored by how well physics closes: units, order, axes, clocks."""

from flights.hypotheses.engine import explain
from flights.hypotheses.hypothesis import Hypothesis

__all__ = ["Hypothesis", "explain"]
