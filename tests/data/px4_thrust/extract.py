"""Cut the flights of this folder out of recordings of `alula fly` and PX4's logs of the same flights.

    python -m tests.data.px4_thrust.extract FOLDER

FOLDER holds false_held_drop and thrust_halved_motors_cut_at_1.9m, each with its recording and flight.ulg.gz.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from runtime.record.recording import read_recording
from runtime.record.records import EstimateRecord, ObservationRecord, SetpointRecord
from tests.data.px4_contacts.extract import THRUST_MAX, true_height

CUTS = {
    "false_lift_off": ("false_held_drop", 2.668, 3.475),
    "thrust_halved": ("thrust_halved_motors_cut_at_1.9m", 10.0, 14.34),
}  # folder, s since the first tick


def cut(folder: Path, begin: float, end: float) -> dict[str, np.ndarray]:
    """Columns of one flight between two times, a row a tick; thrust at effectiveness 1, N."""
    recording = read_recording(next(folder.glob("*.mcap")))
    observations, estimates = recording.records(ObservationRecord), recording.records(EstimateRecord)
    start = observations[0].time
    arrived = {row.arrival: np.hstack([row.position_world, row.velocity_world, row.attitude]) for row in estimates}
    thrust = {row.time: row.thrust * THRUST_MAX for row in recording.records(SetpointRecord)}
    ticks = [row for row in observations if begin < row.time - start < end]
    time = np.array([row.time - start for row in ticks])
    stamps, states = np.array([row.time for row in estimates]) - start, np.array(list(arrived.values()))
    return {
        "time": time,
        "state": np.array([arrived[row.estimate_arrival] for row in ticks]),
        "specific_force": np.array([np.append(row.specific_force_xy, row.specific_force_z) for row in ticks]),
        "thrust": np.array([thrust[row.time] for row in ticks]),
        "height": true_height(folder / "flight.ulg.gz", stamps, states, time),
    }


def main() -> None:
    """Write one file for each flight."""
    for name, (folder, begin, end) in CUTS.items():
        columns = cut(Path(sys.argv[1]) / folder, begin, end)
        narrow = {key: values if key == "time" else values.astype(np.float32) for key, values in columns.items()}
        np.savez_compressed(Path(__file__).parent / f"{name}.npz", **narrow)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
