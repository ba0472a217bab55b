"""Every threshold of diagnosis: unit, meaning, default, and where the default comes from.

A field's line ends with its origin in brackets: "planted truth" (`results/diagnosis_planted_truth.md`, whose even
seeds are for calibration), another measurement (`python -m benchmarks` lists them), "decisions"
(`docs/lab/diagnosis.md`), a definition, or "margins" (`benchmarks thresholds margins`): its half and its double were
tried on flights with a known answer, and what follows says with which of both an answer changes, or that no case reads
it. Functions take a `Thresholds` as an argument; `diagnosis.thresholds_file` reads one from TOML, for a fleet that
needs others.
"""

from __future__ import annotations

from diagnosis.thresholds.estimation import (
    AcceptanceThresholds,
    RelevanceThresholds,
)
from diagnosis.thresholds.group import ThresholdGroup
from diagnosis.thresholds.judgement import (
    CompletionThresholds,
    HoverTrimThresholds,
    InFlightThresholds,
    RegimeThresholds,
    VehicleThresholds,
    VerdictThresholds,
)
from diagnosis.thresholds.likelihood import LikelihoodThresholds
from diagnosis.thresholds.readings import (
    CommandCurveThresholds,
    DataChecks,
    DatasetThresholds,
    FilterThresholds,
    PoseThresholds,
    PredictionThresholds,
    RotorHoldThresholds,
    RotorMomentChecks,
    SegmentThresholds,
)


class Thresholds(ThresholdGroup, frozen=True):
    """All thresholds of diagnosis, by subject."""

    filters: FilterThresholds = FilterThresholds()
    segment: SegmentThresholds = SegmentThresholds()
    dataset: DatasetThresholds = DatasetThresholds()
    command_curve: CommandCurveThresholds = CommandCurveThresholds()
    data_checks: DataChecks = DataChecks()
    rotor_moments: RotorMomentChecks = RotorMomentChecks()
    rotor_hold: RotorHoldThresholds = RotorHoldThresholds()
    prediction: PredictionThresholds = PredictionThresholds()
    pose: PoseThresholds = PoseThresholds()
    acceptance: AcceptanceThresholds = AcceptanceThresholds()
    relevance: RelevanceThresholds = RelevanceThresholds()
    likelihood: LikelihoodThresholds = LikelihoodThresholds()
    verdict: VerdictThresholds = VerdictThresholds()
    completion: CompletionThresholds = CompletionThresholds()
    regimes: RegimeThresholds = RegimeThresholds()
    in_flight: InFlightThresholds = InFlightThresholds()
    hover_trim: HoverTrimThresholds = HoverTrimThresholds()
    vehicle: VehicleThresholds = VehicleThresholds()


DEFAULT = Thresholds()

__all__ = [
    "DEFAULT",
    "AcceptanceThresholds",
    "CommandCurveThresholds",
    "CompletionThresholds",
    "DataChecks",
    "DatasetThresholds",
    "FilterThresholds",
    "HoverTrimThresholds",
    "InFlightThresholds",
    "LikelihoodThresholds",
    "PoseThresholds",
    "PredictionThresholds",
    "RegimeThresholds",
    "RelevanceThresholds",
    "RotorHoldThresholds",
    "RotorMomentChecks",
    "SegmentThresholds",
    "ThresholdGroup",
    "Thresholds",
    "VehicleThresholds",
    "VerdictThresholds",
]
