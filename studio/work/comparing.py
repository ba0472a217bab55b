"""Step "compare": the present model against the flights."""

from __future__ import annotations

from pathlib import Path

from diagnosis.comparison import compare_dataset
from dynamics.files import write_json
from dynamics.progress import Progress
from studio.pages import diagnosed as pictures
from studio.pages import regions
from studio.pages.evidence import agreement
from studio.work.memory import CaseMemory
from studio.work.results import FILES, Compared
from studio.work.rows import picture_info, write_rows
from studio.work.task import Task


def compare(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Write the comparison, its rows and its pictures."""
    dataset = memory.dataset(task, lambda share, stage: progress(0.3 * share, stage))
    vehicle = memory.vehicle(task)
    progress(0.3, "predictions of the model")
    details = compare_dataset(dataset, vehicle, memory.catalogue(task))
    progress(0.9, "pictures")
    floor = details.noise.floor
    rows = write_rows(folder, task, dataset, vehicle, floor, details.maps, {"residual": details.residuals})
    both = agreement(details.residuals)
    shown = {
        "bars": pictures.axis_bars(details.comparison.axes),
        "regimes": regions.regime_map(details.maps),
        "spectrum": pictures.spectrum_lines(details.spectrum, None),
        **{f"plane_{number}": regions.plane_map(plane) for number, plane in enumerate(details.planes)},
        **({} if both is None else {"agreement": pictures.agreement_points(both)}),
    }
    named = {name: picture_info(picture) for name, picture in shown.items()}
    write_json(Compared(details.comparison, rows, named), folder / FILES[Compared])
