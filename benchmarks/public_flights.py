"""A reader of public flights whose files no column mapping can describe."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dynamics.arrays import Floats
from dynamics.errors import DataError
from flights import Flight
from flights.log import Log, Provenance, Stream

QUAD_X = (2, 1, 3, 0)  # PX4's motors at our rotors
NEURAL_FLY_COLUMNS = ("t", "p", "v", "R", "w", "pwm")


def neural_fly_flight(path: Path) -> Flight:
    """A flight of Neural-Fly: cells hold lists, positions may be north-east-down.

    Raises DataError for a file without its columns.
    """
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    missing = [name for name in NEURAL_FLY_COLUMNS if not rows or name not in rows[0]]
    if missing:
        raise DataError(f"{path.name} lacks the columns {', '.join(missing)} of Neural-Fly's experiments.")
    table = {name: np.array([_cell(row[name]) for row in rows], dtype=float) for name in NEURAL_FLY_COLUMNS}
    time = table["t"].ravel() - table["t"].ravel()[0]
    turn = Rotation.from_matrix(table["R"].reshape(-1, 3, 3))
    position, velocity, rate = table["p"], table["v"], table["w"]
    if np.mean(position[:, 2]) < 0:  # down is positive: north-east-down and forward-right-down
        swap = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
        position, velocity = swap.apply(position), swap.apply(velocity)
        turn = swap * turn * Rotation.from_euler("x", np.pi)
        rate = rate * [1.0, -1.0, -1.0]
    command = np.clip((table["pwm"][:, list(QUAD_X)] - 1000.0) / 1000.0, 0.0, 1.0)
    quantities: dict[str, Floats] = {
        "position": position, "velocity": velocity, "rate": rate, "rotor_command": command,
        "attitude": np.roll(turn.as_quat(canonical=True), 1, axis=1),
    }  # fmt: skip
    rising = np.concatenate([[True], np.diff(time) > 0])
    streams = [Stream(name, time[rising], values[rising], "neural_fly") for name, values in quantities.items()]
    return Flight.from_log(Log(tuple(streams), Provenance(path.name, "", "Neural-Fly experiment", "neural_fly")))


def _cell(text: str) -> list[float]:
    """A number, or a list of them, nested or not."""
    return np.asarray(json.loads(text), dtype=float).ravel().tolist()
