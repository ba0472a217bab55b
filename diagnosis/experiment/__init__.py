"""Experiment design: which manoeuvre shows the most of the effects' parameters, for a vehicle in a volume."""

from diagnosis.experiment.expectation import ExpectedInterval
from diagnosis.experiment.planning import PlannedFlight, plan_flight
from diagnosis.experiment.request import ExperimentRequest, parse_request

__all__ = [
    "ExpectedInterval",
    "ExperimentRequest",
    "PlannedFlight",
    "parse_request",
    "plan_flight",
]
