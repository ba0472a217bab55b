"""References: smooth motions from hover to hover for a vehicle to track."""

from dynamics.references.catalogue import MANOEUVRES, Shape, is_identification, make_reference, named_reference
from dynamics.references.feasibility import Feasibility, check_feasibility
from dynamics.references.manoeuvres import PAPER, PLAIN
from dynamics.references.reference import Reference

__all__ = [
    "MANOEUVRES",
    "PAPER",
    "PLAIN",
    "Feasibility",
    "Reference",
    "Shape",
    "check_feasibility",
    "is_identification",
    "make_reference",
    "named_reference",
]
