"""The demo's second half, on the workbench: diagnose the first flights and write the next vehicle file."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from diagnosis.addition import write_next_version
from diagnosis.completion import Completion, complete
from diagnosis.data.dataset import Dataset, read_dataset
from diagnosis.report import sentence
from dynamics.decoding import decode_json
from dynamics.own_effects import catalogue_of
from dynamics.vehicle_file import find_vehicle, read_vehicle
from studies.demo.flights import DemoOptions
from studies.demo.result import Learned, PredictionError


@dataclass(frozen=True, eq=False)
class Learning:
    """The second half before its flights.

    learned: for the report, without flights yet.
    dataset: what it was learned from.
    completion: the diagnoses and the vehicle with what was added.
    """

    learned: Learned
    dataset: Dataset
    completion: Completion


def learn(options: DemoOptions, recordings: Sequence[str], *, command: str = "") -> Learning:
    """Diagnose recordings and write the next version of the vehicle file into the demo's folder.

    Raises DataError when the recordings cannot answer, RequestError when the file cannot be written.
    """
    file = find_vehicle(options.vehicle)
    vehicle = read_vehicle(file)
    dataset = read_dataset(recordings, vehicle)
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    completion = complete(dataset, vehicle, catalogue_of(vehicle), date=today, command=command)
    diagnosis, after = completion.first.diagnosis, completion.last.diagnosis.channels
    written = (
        write_next_version(completion.vehicle, options.folder / file.name, source=file) if completion.added else ""
    )
    learned = Learned(
        verdict=diagnosis.verdict,
        sentence=sentence(diagnosis),
        added=tuple(effect.name for effect in completion.added),
        channels={k: PredictionError(e.before, after[k].after, e.floor, e.unit) for k, e in diagnosis.channels.items()},
        vehicle_file=str(written),
        flown=(),
        diagnosis=decode_json(msgspec.json.encode(diagnosis)),
    )
    return Learning(learned, dataset, completion)
