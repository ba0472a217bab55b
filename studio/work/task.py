"""Requests to a worker, and its answers."""

from __future__ import annotations

from pathlib import Path

import msgspec

from dynamics.decoding import decode_json

REFUSED = "refused.json"


class Task(msgspec.Struct, frozen=True):
    """One step of a case. Everything that it needs is in here or in files; its result is a folder.

    step: name of the step.
    result: folder that appears when the step is done.
    flights: folder of the logs' tables, which the check writes first.
    logs: files.
    vehicle: file of the version that is worked on, empty before one is chosen.
    first_vehicle: file of the version that it goes back to.
    effect_files: with effects of the user's own.
    mapping, pose, hold_out: as the options of `alula diagnose`, empty for none.
    data_key: of the logs and how they are read; vehicle_key: of these and the vehicle, for what is held in memory.
    effect: key of one effect, such as "weak_rotor[2]", where the step is about one.
    reference: name of the manoeuvre that is flown on the mock.
    numbers: of the step, by name.
    name: of the vehicle that is made.
    frame: of it, empty where the logs state the layout.
    command: the command line that does the same.
    """

    step: str
    result: str
    flights: str
    logs: tuple[str, ...]
    vehicle: str
    first_vehicle: str
    effect_files: tuple[str, ...]
    mapping: str
    pose: str
    hold_out: str
    data_key: str
    vehicle_key: str
    effect: str = ""
    reference: str = ""
    numbers: dict[str, float] = {}
    command: str = ""
    name: str = ""
    frame: str = ""


class Refusal(msgspec.Struct, frozen=True):
    """Why a step has no result: the message of an error that a user can cause."""

    message: str
    exit_code: int


def refusal_of(folder: Path) -> Refusal | None:
    """The refusal that a result's folder holds, None where the step was done."""
    path = folder / REFUSED
    return decode_json(path.read_bytes(), Refusal) if path.is_file() else None
