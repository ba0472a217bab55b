"""Results of the functions of `alula.api`: each holds the report that the command of its name writes as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from dynamics.files import write_answer

if TYPE_CHECKING:
    from diagnosis.addition import Addition
    from diagnosis.addition_report import AdditionReport
    from diagnosis.comparison import Comparison, ComparisonDetails
    from diagnosis.data.dataset import Dataset
    from diagnosis.diagnose import DiagnosisDetails
    from diagnosis.experiment import ExpectedInterval, PlannedFlight
    from diagnosis.flight_addition import FlightAddition, FlightAdditionReport
    from diagnosis.proof import Proof
    from diagnosis.report import Diagnosis
    from dynamics.effect import Effect
    from dynamics.vehicle import Vehicle
    from export.parity import Parity
    from flights.followed import FollowedFlight
    from runtime.control.bundle import Manifest
    from simulation.flight_check import FlightCheck
    from simulation.trial_flight import TrialFlight
    from simulation.versions_in_flight import VersionsInFlight
    from studies.evaluation.run import EvaluationAnswer, Results
    from studies.fleet.summary import FleetReport
    from studies.tables import Table
    from training.card import Card
    from training.checkpoint import TrainedModel

SHOWN_PARAMETERS = 5  # of a planned flight, in a terminal


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """A model beside the flights that it should explain.

    report: errors of each channel over its noise floor, where they are largest, open-loop errors.
    vehicle: whose model it is.
    dataset: the segments of flight that were compared.
    details: residuals, maps and spectra behind the report.
    """

    report: Comparison
    vehicle: Vehicle
    dataset: Dataset
    details: ComparisonDetails

    def write_json(self, path: str | Path) -> None:
        """Write the report as JSON; "-" is standard output. Raises RequestError when it cannot be written."""
        write_answer(self.report, Path(path))

    def write_html(self, path: str | Path) -> None:
        """Write a page with all pictures, one file. Raises RequestError when it cannot be written."""
        from studio.pages.page import write_page
        from studio.pages.provenance import dataset_origin
        from studio.pages.report import comparison_page

        page = comparison_page(self.details, self.dataset, self.vehicle, origin=dataset_origin(self.dataset))
        write_page(page, Path(path))

    def write_pictures(self, folder: str | Path) -> list[Path]:
        """Draw every picture of the page as PDF, SVG and PNG. Returns the files.

        Raises RequestError when they cannot be written, and without Chromium or Chrome.
        """
        from studio.pages.picture_files import write_pictures
        from studio.pages.report import comparison_pictures

        return write_pictures(comparison_pictures(self.details, self.dataset), Path(folder))


@dataclass(frozen=True, eq=False)
class DiagnosisResult:
    """Which physical effect a model lacks.

    report: the verdict, the effects with their values, errors before and after, what to fly next.
    vehicle: whose model was diagnosed, without the effects.
    dataset: the segments of flight, fitted and held out.
    details: the noise and the residuals behind the report, and the vehicle with the effects.
    """

    report: Diagnosis
    vehicle: Vehicle
    dataset: Dataset
    details: DiagnosisDetails

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        from diagnosis.report import sentence

        return sentence(self.report)

    def write_json(self, path: str | Path) -> None:
        """Write the report as JSON; "-" is standard output. Raises RequestError when it cannot be written."""
        write_answer(self.report, Path(path))

    def write_html(self, path: str | Path, *, add_command: str = "") -> None:
        """Write a page with all pictures, one file. Raises RequestError when it cannot be written.

        add_command: what the page recommends to run next.
        """
        from studio.pages.page import write_page
        from studio.pages.provenance import dataset_origin
        from studio.pages.report import diagnosis_page

        source = dataset_origin(self.dataset, add_command)
        write_page(diagnosis_page(self.details, self.dataset, self.vehicle, origin=source), Path(path))

    def write_pictures(self, folder: str | Path) -> list[Path]:
        """Draw every picture of the page as PDF, SVG and PNG. Returns the files.

        Raises RequestError when they cannot be written, and without Chromium or Chrome.
        """
        from studio.pages.picture_files import write_pictures
        from studio.pages.report import diagnosis_pictures

        return write_pictures(diagnosis_pictures(self.details, self.dataset, self.vehicle), Path(folder))


@dataclass(frozen=True, eq=False)
class FleetResult:
    """The flights of a fleet, each diagnosed by itself.

    report: every flight's line, verdicts by vehicle, drifts over the dates, outliers.
    folder: of the results.
    """

    report: FleetReport
    folder: Path

    @property
    def sentences(self) -> Sequence[str]:
        """Findings about the fleet, a sentence a line."""
        from studies.fleet.words import sentences

        return sentences(self.report)

    @property
    def files(self) -> Sequence[Path]:
        """The lines and the table."""
        from studies.fleet.files import LINES, TABLE

        return (self.folder / LINES, self.folder / TABLE)

    def write_json(self, path: str | Path) -> None:
        """Write the report as JSON; "-" is standard output. Raises RequestError when it cannot be written."""
        write_answer(self.report, Path(path))

    def write_html(self, path: str | Path) -> None:
        """Write a page with tables and pictures, one file. Raises RequestError when it cannot be written."""
        from studies.fleet.page import fleet_page
        from studio.pages.page import write_page

        write_page(fleet_page(self.report), Path(path))


@dataclass(frozen=True, eq=False)
class IdentificationFlight:
    """A manoeuvre that shows much of the effects' parameters, as the mock of the vehicle can fly it.

    plan: the reference, and the intervals that it lets expect.
    pace: factor on the speed that was planned first.
    trial: the flight on the mock; None where it was not flown there.
    """

    plan: PlannedFlight
    pace: float
    trial: TrialFlight | None

    @property
    def text(self) -> str:
        """Planned flight, three lines for a terminal."""
        import numpy as np

        from dynamics.state import POSITION, VELOCITY

        motion = self.plan.reference.states(np.arange(0.0, self.plan.reference.duration, 0.05))
        sides = " x ".join(f"{side:.1f}" for side in np.ptp(motion[:, POSITION], axis=0))
        fastest = np.linalg.norm(motion[:, VELOCITY], axis=1).max()
        paced = "" if self.pace == 1.0 else f" ({self.pace:g} of what was planned first)"
        lines = [f"planned: {self.plan.reference.duration:g} s in {sides} m, up to {fastest:.1f} m/s{paced}"]
        shown = sorted(self.plan.expected, key=lambda one: one.std / one.prior)[:SHOWN_PARAMETERS]
        listed = ", ".join(f"{one.name} {one.prior:.2g} to {one.std:.2g}{_unit(one)}" for one in shown)
        lines.append(f"standard deviations before and after: {listed}")
        return "\n".join(lines if self.trial is None else [*lines, f"on the mock: {self.trial.text}"])

    def write_csv(self, path: str | Path) -> Path:
        """Write the reference as a file that `fly` takes. Raises RequestError when it cannot be written."""
        return self.plan.write_csv(path)


def _unit(interval: ExpectedInterval) -> str:
    return "" if interval.unit == "1" else f" {interval.unit}"


@dataclass(frozen=True, eq=False)
class ProofResult:
    """Two versions of a vehicle on flights that nothing was fitted to.

    report: errors of both, one step and in open loop.
    flown: the reference that was flown in simulation with either version in the controller; None without one.
    """

    report: Proof
    flown: VersionsInFlight | None

    def write_json(self, path: str | Path) -> None:
        """Write both as JSON; "-" is standard output. Raises RequestError when it cannot be written."""
        flown = None if self.flown is None else msgspec.to_builtins(self.flown)
        write_answer({**msgspec.to_builtins(self.report), "flown": flown}, Path(path))


@dataclass(frozen=True, eq=False)
class AdditionResult:
    """A vehicle with more effects, which held-out flights bear out.

    vehicle: with the effects and one more line of history.
    report: the fitted values, errors before and after.
    details: the fit behind the report.
    source: the vehicle's file; what is written keeps its comments and layout. None for a vehicle without one.
    catalogue: the effects that its file may name.
    """

    vehicle: Vehicle
    report: AdditionReport
    details: Addition
    source: Path | None
    catalogue: Mapping[str, Effect]

    def write(self, path: str | Path) -> Path:
        """Write the vehicle to a new file. Raises RequestError when there is one already or it cannot be written."""
        return _write_vehicle(self, path)

    def write_next_version(self, vehicle: str | Path) -> Path:
        """Write the vehicle beside an older file: after v.toml come v.v2.toml and v.v3.toml.

        vehicle: the older file, or the name of a bundled one. Raises RequestError when it cannot be written.
        """
        return _write_next_version(self, vehicle)


@dataclass(frozen=True, eq=False)
class FlightAdditionResult:
    """A vehicle with what its model followed in a recorded flight.

    vehicle: with the values at the end of tracking and one more line of history.
    report: the values, what was left out and why, errors of the flight before and after.
    details: the addition behind the report.
    followed: the parameters over the flight.
    source: the vehicle's file; what is written keeps its comments and layout. None for a vehicle without one.
    catalogue: the effects that its file may name.
    """

    vehicle: Vehicle
    report: FlightAdditionReport
    details: FlightAddition
    followed: FollowedFlight
    source: Path | None
    catalogue: Mapping[str, Effect]

    def write(self, path: str | Path) -> Path:
        """Write the vehicle to a new file. Raises RequestError when there is one already or it cannot be written."""
        return _write_vehicle(self, path)

    def write_next_version(self, vehicle: str | Path) -> Path:
        """Write the vehicle beside an older file, as `AdditionResult.write_next_version` does."""
        return _write_next_version(self, vehicle)


def _write_vehicle(result: AdditionResult | FlightAdditionResult, path: str | Path) -> Path:
    from diagnosis.addition import text_after
    from dynamics.vehicle_file import write_vehicle_text

    text = text_after(result.vehicle, result.source, Path(path).parent, catalogue=result.catalogue)
    write_vehicle_text(text, Path(path))
    return Path(path)


def _write_next_version(result: AdditionResult | FlightAdditionResult, vehicle: str | Path) -> Path:
    from diagnosis.addition import write_next_version
    from dynamics.vehicle_file import find_vehicle

    path = find_vehicle(vehicle)
    return write_next_version(result.vehicle, path, catalogue=result.catalogue, source=result.source or path)


@dataclass(frozen=True, eq=False)
class TrainingResult:
    """A trained model, written as a checkpoint with its card.

    report: the card: flights, recipe, errors on validation flights, ranges of the inputs.
    model: the networks, ready to predict.
    path: the checkpoint.
    """

    report: Card
    model: TrainedModel
    path: Path


@dataclass(frozen=True, eq=False)
class EvaluationResult:
    """Models on flights that they were not trained on.

    report: every figure.
    tables: the same as tables.
    details: predictions and labels behind the figures.
    """

    report: EvaluationAnswer
    tables: tuple[Table, ...]
    details: Results

    @property
    def summary(self) -> Sequence[str]:
        """Lines for a terminal: the ratios of errors, and notes."""
        from studies.evaluation.tables import summary_lines

        return summary_lines(self.report.evaluated)

    @property
    def of_nominal(self) -> Sequence[float]:
        """RMSE of each trained model over that of the nominal model, in the order in which they were given."""
        from studies.evaluation.tables import ratios_to_nominal

        return ratios_to_nominal(self.report.evaluated)

    def write_json(self, path: str | Path) -> None:
        """Write every figure as JSON; "-" is standard output. Raises RequestError when it cannot be written."""
        write_answer(self.report, Path(path))

    def write_csv(self, folder: str | Path) -> list[Path]:
        """Write each table as a CSV file. Raises RequestError when one cannot be written. Returns the files."""
        from studies.tables import write_csv

        return write_csv(self.tables, Path(folder))

    def write_pictures(self, folder: str | Path) -> list[Path]:
        """Draw errors and predictions as PNG and PDF. Raises RequestError as `write_csv`. Returns the files."""
        from studies.evaluation.run import draw

        return draw(self.details, Path(folder))

    def write_html(self, path: str | Path) -> None:
        """Write tables and pictures as one page. Raises RequestError when it cannot be written."""
        from studies.evaluation.run import write_html

        write_html(self.details, Path(path))


@dataclass(frozen=True)
class ExportResult:
    """A bundle that can fly.

    folder: where it lies.
    manifest: what it is made of and how it was made.
    parity: how closely PyTorch, ONNX, CasADi, C and the kernel agree.
    flight_check: a few simulated seconds with it; None for physics, or where it was not requested.
    of_nominal: RMSE of a learned model on its validation flights over that of the nominal model; None for physics.
    """

    folder: Path
    manifest: Manifest
    parity: Parity
    flight_check: FlightCheck | None
    of_nominal: float | None = None

    @property
    def report(self) -> dict[str, Any]:
        """Comparisons and flight check, as `alula export --json` prints them."""
        return {
            **msgspec.to_builtins(self.parity),
            "flight_check": self.flight_check and self.flight_check.as_json,
            "of_nominal": self.of_nominal,
        }

    @property
    def summary(self) -> Sequence[str]:
        """Lines for a terminal: what was compared and how well it agrees."""
        from export.bundle import Exported, summary

        return summary(Exported(self.folder, self.manifest, self.parity))
