"""Step "export": the present version as a bundle for `alula fly`."""

from __future__ import annotations

from pathlib import Path

from dynamics.files import write_json
from dynamics.progress import Progress
from dynamics.vehicle_file import vehicle_text
from export.bundle import ExportOptions, export_bundle, summary
from export.trained import read_model
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import named_processor
from studio.work.memory import CaseMemory
from studio.work.results import FILES, Exported
from studio.work.task import Task

WINDOWS = 200  # on which the backends of an export are compared


def export(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Write the present version as a bundle that flies, beside the report."""
    progress(0.1, "compiling the kernel")
    file = folder / "vehicle.toml"
    file.write_text(vehicle_text(task.vehicle, effect_files=task.effect_files), encoding="utf-8")
    model = read_model(file)
    problem = Problem.from_settings(model.vehicle.controller)
    options = ExportOptions(problem, named_processor("native"), (), WINDOWS, 0, True, task.command)
    exported = export_bundle(model, folder / "bundle", options)
    written = str(Path(task.result) / "bundle")
    lines = tuple(line.replace(str(exported.folder), written) for line in summary(exported))
    write_json(Exported(written, lines), folder / FILES[Exported])
