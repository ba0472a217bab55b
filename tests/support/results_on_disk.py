"""Small results as the commands leave them on disk: a fleet, a sweep, a training, an evaluation."""

from __future__ import annotations

from pathlib import Path

import msgspec

from dynamics.files import write_json
from studies.evaluation.run import EvaluationAnswer
from studies.fleet.files import ABOUT as FLEET_ABOUT
from studies.fleet.files import LINES, FleetAbout
from studies.fleet.flight import FleetFlight
from studies.sweep.about import ABOUT, SweepAbout
from studies.sweep.cell import Cell, CellResult, FailedCell
from training.card import FlightError
from training.evaluation import Evaluation, EvaluationReport, Peak
from training.progress_file import append, begin
from training.reports import Report

ERROR = FlightError("line.csv", 100, 0.2, 0.4, 0.3, 0.6)


def fleet_folder(folder: Path) -> Path:
    """Two of eight flights, the first beside the folder, the second refused."""
    flights = [
        FleetFlight("a.csv", "diagnosed", vehicle="quad", verdict="explained", sentence="The model explains it."),
        FleetFlight("b.csv", "refused", error="no rows"),
    ]
    folder.mkdir()
    (folder / LINES).write_bytes(b"".join(msgspec.json.encode(f) + b"\n" for f in flights))
    write_json(FleetAbout(str(folder.parent), 8), folder / FLEET_ABOUT)
    (folder.parent / "a.csv").touch()
    return folder


def sweep_folder(folder: Path) -> Path:
    """Three of four cells, one of them failed."""
    folder.mkdir()
    write_json(SweepAbout("grid", ("history",), 4), folder / ABOUT)
    cells = [Cell(f"h{h}_seed0", {"history": float(h), "seed": 0.0}, "pi_tcn", 0) for h in (4, 20, 30)]
    for cell in cells[:2]:
        write_json(CellResult(cell, "", (ERROR,), (), 0.1, 10, 1.0, 1e-4, "here"), folder / f"{cell.name}.json")
    write_json(FailedCell(cells[2], "no memory", "here"), folder / f"{cells[2].name}.failed")
    (folder / "other.json").write_text("[1, 2]")
    return folder


def training_file(folder: Path) -> Path:
    """Half of the first of two members."""
    path = folder / "m.progress.jsonl"
    begin(path, 2, "alula train", resume=False)
    append(path, Report(0, 100, 200, 0.5, 0.1, 0.4, 0.4, 1e-3))
    return path


def evaluation_file(folder: Path) -> Path:
    """A network and the nominal model on one flight."""
    model = Evaluation("m", "pi_tcn", 20, "logged", False, (ERROR,))
    nominal = Evaluation("NOM", "nominal", 1, "logged", False, (ERROR,))
    report = EvaluationReport((nominal, model), (Peak("line.csv", 3.0, 20.0),), {"line.csv": "0"})
    write_json(EvaluationAnswer(report, ()), folder / "ev.json")
    return folder / "ev.json"
