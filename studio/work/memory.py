"""Memory of a worker from one step of a case to the next: logs, data set, diagnosis; one of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from diagnosis.data.dataset import Dataset, align_logs, make_dataset
from diagnosis.diagnose import DiagnosisDetails, diagnose_dataset
from diagnosis.in_flight import with_in_flight
from dynamics.effect import Effect
from dynamics.errors import AlulaError, RequestError
from dynamics.own_effects import catalogue_of
from dynamics.progress import Progress, no_progress
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from flights import Log, read_log
from studio.work.task import Task

Held = TypeVar("Held")


class CaseMemory:
    """The last case's logs, data set and diagnosis, each under the key of what it was made from."""

    def __init__(self) -> None:
        self._held: dict[str, tuple[str, object]] = {}

    def logs(self, task: Task, progress: Progress = no_progress) -> list[Log | AlulaError]:
        """The case's logs, in place of one that cannot be read the error."""
        return self._made("logs", task.data_key, lambda: _read(task, progress))

    def vehicle(self, task: Task) -> Vehicle:
        """The vehicle that is worked on. Raises RequestError before one is chosen."""
        if not task.vehicle:
            raise RequestError("no vehicle is chosen. Choose a bundled one, upload a file, or make one from the log.")
        return read_vehicle(task.vehicle, effect_files=task.effect_files)

    def first_vehicle(self, task: Task) -> Vehicle:
        """The vehicle that it goes back to."""
        return read_vehicle(task.first_vehicle, effect_files=task.effect_files)

    def catalogue(self, task: Task) -> Mapping[str, Effect]:
        """The effects that compete: the catalogue's and the user's own."""
        return catalogue_of(self.vehicle(task))

    def dataset(self, task: Task, progress: Progress = no_progress) -> Dataset:
        """The data set of the logs that can be read. Raises the first log's error where none can."""
        return self._made("dataset", task.vehicle_key, lambda: self._read_dataset(task, progress))

    def diagnosis(self, task: Task, progress: Progress = no_progress) -> DiagnosisDetails:
        """The diagnosis of the vehicle that is worked on. Raises DataError when the flights cannot answer."""
        return self._made("diagnosis", task.vehicle_key, lambda: self._diagnose(task, progress))

    def _read_dataset(self, task: Task, progress: Progress) -> Dataset:
        items = self.logs(task, progress)
        logs = [item for item in items if isinstance(item, Log)]
        if not logs:
            raise next((item for item in items if isinstance(item, AlulaError)), RequestError("the case has no log."))
        return make_dataset(align_logs(logs), self.vehicle(task), hold_out=task.hold_out or None)

    def _diagnose(self, task: Task, progress: Progress) -> DiagnosisDetails:
        dataset, vehicle, catalogue = self.dataset(task), self.vehicle(task), self.catalogue(task)
        details = diagnose_dataset(dataset, vehicle, catalogue, progress=progress)
        return with_in_flight(details, dataset, catalogue, vehicle)

    def _made(self, name: str, key: str, make: Callable[[], Held]) -> Held:
        held = self._held.get(name)
        if held is None or held[0] != key:
            self._held.pop(name, None)  # before the new one, so that only one is in memory
            held = self._held[name] = (key, make())
        return held[1]  # type: ignore[return-value]


def _read(task: Task, progress: Progress) -> list[Log | AlulaError]:
    logs: list[Log | AlulaError] = []
    for number, path in enumerate(task.logs):
        progress(number / len(task.logs), f"reading {Path(path).name}")
        try:
            logs.append(read_log(path, mapping=task.mapping or None, pose=task.pose or None))
        except AlulaError as error:
            logs.append(error)
    return logs
