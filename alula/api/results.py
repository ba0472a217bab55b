"""What the functions of `alula.api` return: each holds the report that the command of its name writes as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from dynamics.files import write_json

if TYPE_CHECKING:
    from diagnosis.addition import Addition
    from diagnosis.addition_report import AdditionReport
    from diagnosis.comparison import Comparison, ComparisonDetails
    from diagnosis.data.dataset import Dataset
    from diagnosis.diagnose import DiagnosisDetails
    from diagnosis.report import Diagnosis
    from dynamics.effect import Effect
    from dynamics.vehicle import Vehicle
    from export.parity import Parity
    from runtime.control.bundle import Manifest
    from simulation.flight_check import FlightCheck
    from studies.evaluation.run import EvaluationAnswer, Results
    from studies.tables import Table
    from training.card import Card
    from training.checkpoint import TrainedModel


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
        write_json(self.report, Path(path))

    def write_html(self, path: str | Path) -> None:
        """Write a page with all pictures, one file. Raises RequestError when it cannot be written."""
        from studio.page import write_page
        from studio.provenance import dataset_origin
        from studio.report import comparison_page

        page = comparison_page(self.details, self.dataset, self.vehicle, origin=dataset_origin(self.dataset))
        write_page(page, Path(path))


@dataclass(frozen=True, eq=False)
class DiagnosisResult:
    """Which physical effect a model lacks.

    report: the verdict, the effects with their values, errors before and after, what to fly next.
    vehicle: whose model was diagnosed, without the effects.
    dataset: the segments of flight, fitted and held out.
    details: the regression and the residuals behind the report, and the vehicle with the effects.
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
        write_json(self.report, Path(path))

    def write_html(self, path: str | Path, *, add_command: str = "") -> None:
        """Write a page with all pictures, one file. Raises RequestError when it cannot be written.

        add_command: what the page recommends to run next.
        """
        from studio.page import write_page
        from studio.provenance import dataset_origin
        from studio.report import diagnosis_page

        source = dataset_origin(self.dataset, add_command)
        write_page(diagnosis_page(self.details, self.dataset, self.vehicle, origin=source), Path(path))


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
        from diagnosis.addition import text_after
        from dynamics.vehicle_file import write_vehicle_text

        text = text_after(self.vehicle, self.source, Path(path).parent, catalogue=self.catalogue)
        write_vehicle_text(text, Path(path))
        return Path(path)

    def write_next_version(self, vehicle: str | Path) -> Path:
        """Write the vehicle beside an older file: after v.toml come v.v2.toml and v.v3.toml.

        vehicle: the older file, or the name of a bundled one. Raises RequestError when it cannot be written.
        """
        from diagnosis.addition import write_next_version
        from dynamics.vehicle_file import find_vehicle

        path = find_vehicle(vehicle)
        return write_next_version(self.vehicle, path, catalogue=self.catalogue, source=self.source or path)


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

    def write_json(self, path: str | Path) -> None:
        """Write every figure as JSON; "-" is standard output. Raises RequestError when it cannot be written."""
        write_json(self.report, Path(path))

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
    """

    folder: Path
    manifest: Manifest
    parity: Parity
    flight_check: FlightCheck | None

    @property
    def report(self) -> dict[str, Any]:
        """Comparisons and flight check, as `alula export --json` prints them."""
        return {**msgspec.to_builtins(self.parity), "flight_check": self.flight_check and self.flight_check.as_json}

    @property
    def summary(self) -> Sequence[str]:
        """Lines for a terminal: what was compared and how well it agrees."""
        from export.bundle import Exported, summary

        return summary(Exported(self.folder, self.manifest, self.parity))
