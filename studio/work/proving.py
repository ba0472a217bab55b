"""Steps "prove" and "fly": the present version against the first one, on held-out flights and on the mock."""

from __future__ import annotations

from pathlib import Path

from diagnosis.proof import Proof, prove_versions
from dynamics.files import write_json
from dynamics.progress import Progress
from simulation.versions_in_flight import SECONDS, VersionsInFlight, fly_versions
from studio.work.memory import CaseMemory
from studio.work.results import FILES
from studio.work.task import Task


def prove(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Errors of both versions on flights that nothing was fitted to, one step and in open loop."""
    dataset = memory.dataset(task, lambda share, stage: progress(0.2 * share, stage))
    proof = prove_versions(
        dataset,
        memory.first_vehicle(task),
        memory.vehicle(task),
        memory.catalogue(task),
        lambda share, stage: progress(0.2 + 0.8 * share, stage),
    )
    write_json(proof, folder / FILES[Proof])


def fly(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Fly a manoeuvre on a vehicle with the present version's effects, with both models in the controller."""
    flown = fly_versions(
        memory.first_vehicle(task),
        memory.vehicle(task),
        task.reference,
        memory.catalogue(task),
        duration=task.numbers.get("duration", SECONDS),
        progress=progress,
    )
    write_json(flown, folder / FILES[VersionsInFlight])
