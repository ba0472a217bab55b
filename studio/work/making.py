"""Step "make": a vehicle file from the autopilot's parameters in the logs, or a frame, and from the flights."""

from __future__ import annotations

from pathlib import Path

from diagnosis.vehicle_from_logs import vehicle_from_logs
from dynamics.progress import Progress
from studio.work.memory import CaseMemory
from studio.work.results import VEHICLE
from studio.work.task import Task


def make(_: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Write the vehicle file. Raises RequestError and DataError where the logs and the numbers given make none."""
    made = vehicle_from_logs(
        task.logs,
        name=task.name,
        mass=task.numbers.get("mass"),
        arm=task.numbers.get("arm"),
        speed_max=task.numbers.get("speed_max"),
        frame=task.frame or None,
        mapping=task.mapping or None,
        command=task.command,
        progress=progress,
    )
    text = made.draft.toml if made.draft.vehicle else ""  # which raises where it is none
    (folder / VEHICLE).write_text(text, encoding="utf-8")
