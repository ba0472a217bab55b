"""Step "add": effects into the next version of the vehicle file, where held-out flights bear them out."""

from __future__ import annotations

import datetime
from pathlib import Path

from diagnosis.addition import add_effect, text_after
from diagnosis.addition_report import report
from dynamics.files import write_json
from dynamics.progress import Progress
from studio.work.memory import CaseMemory
from studio.work.results import FILES, VEHICLE, Added
from studio.work.task import Task


def add(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Fit the effects that the diagnosis names, or one of them, and write the report and the vehicle file.

    Raises DataError with the numbers where held-out flights do not bear them out.
    """
    dataset = memory.dataset(task, lambda share, stage: progress(0.1 * share, stage))
    vehicle, catalogue = memory.vehicle(task), memory.catalogue(task)
    name, rotor = _identity(task.effect)
    # what the diagnosis left in memory serves the addition of all that it names
    diagnosed = None if name else memory.diagnosis(task, lambda share, stage: progress(0.1 + 0.4 * share, stage))
    addition = add_effect(
        name,
        dataset,
        vehicle,
        catalogue,
        date=datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        command=task.command,
        rotor=rotor,
        diagnosed=diagnosed,
        progress=progress,
    )
    text = text_after(addition.vehicle, Path(task.vehicle), Path(task.vehicle).parent, catalogue=catalogue)
    (folder / VEHICLE).write_text(text, encoding="utf-8")
    write_json(Added(report(addition), addition.vehicle.history[-1].action), folder / FILES[Added])


def _identity(key: str) -> tuple[str | None, int | None]:
    """Name and rotor of an effect from its key, None and None for all that are named."""
    name, _, rest = key.partition("[")
    return name or None, int(rest.rstrip("]")) if rest else None
