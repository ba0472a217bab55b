"""Cut the flights of this folder out of recordings of `alula fly` and PX4's logs of the same flights.

    python tests/data/px4_contacts/extract.py FOLDER

FOLDER holds NAME.mcap and NAME.ulg.gz. PX4's clock is matched to the recording's by the estimated height and climb.
"""

from __future__ import annotations

import gzip
import io
import sys
from pathlib import Path

import numpy as np
from pyulog import ULog

from runtime.record.recording import read_recording
from runtime.record.records import EstimateRecord, ImuRecord, ObservationRecord, PhaseRecord, SetpointRecord

CUTS = {"tipped_44deg": (30.0, 39.0), "crash_circle": (12.0, 26.0), "drag2_4_lemniscate": (2.9, 52.0)}  # s
THRUST_MAX = 20.0  # N, of vehicles/px4_sih.toml, whose thrust is linear in the setpoint


def cut(folder: Path, name: str) -> dict[str, np.ndarray]:
    """Columns of one flight between two times since its first tick."""
    recording = read_recording(folder / f"{name}.mcap")
    start = recording.records(ObservationRecord)[0].time
    estimates, inertial = recording.records(EstimateRecord), recording.records(ImuRecord)
    setpoints, phases = recording.records(SetpointRecord), recording.records(PhaseRecord)
    time = np.array([row.time for row in inertial])
    keep = (time - start > CUTS[name][0]) & (time - start < CUTS[name][1])
    time = time[keep]
    states = np.array([np.hstack([row.position_world, row.velocity_world, row.attitude]) for row in estimates])
    stamps = np.array([row.time for row in estimates])
    state = np.array([np.interp(time, stamps, column) for column in states.T]).T
    thrust = np.array([row.thrust * THRUST_MAX * row.effectiveness for row in setpoints])
    sent = np.array([row.time for row in setpoints])
    index = np.searchsorted([row.time for row in phases], time) - 1
    return {
        "time": time - start,
        "specific_force": np.array([row.specific_force_body for row in inertial])[keep],
        "state": state,
        "thrust": thrust[np.clip(np.searchsorted(sent, time) - 1, 0, None)],
        "phase": np.array([phases[max(place, 0)].phase for place in index]),
        "height": true_height(folder / f"{name}.ulg.gz", stamps - start, states, time - start),
    }


def true_height(path: Path, stamps: np.ndarray, states: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The true height, m, at times of the recording, s."""
    topics = {topic.name: topic.data for topic in ULog(io.BytesIO(gzip.decompress(path.read_bytes()))).data_list}
    local, truth = topics["vehicle_local_position"], topics["vehicle_local_position_groundtruth"]
    clock = local["timestamp"][::5] * 1e-6

    def mismatch(offset: float) -> float:
        height, climb = (np.interp(clock + offset, stamps, states[:, column]) for column in (2, 5))
        return float(np.mean((height + local["z"][::5]) ** 2 + (climb + local["vz"][::5]) ** 2))

    offset = min(np.arange(stamps[0] - clock[0] - 5.0, stamps[-1] - clock[-1] + 5.0, 0.02), key=mismatch)
    return np.interp(time, truth["timestamp"] * 1e-6 + offset, -truth["z"])


def main() -> None:
    """Write one file for each flight."""
    for name in CUTS:
        columns = {key: values.astype(np.float32) if key not in ("time", "phase") else values
                   for key, values in cut(Path(sys.argv[1]), name).items()}  # fmt: skip
        np.savez_compressed(Path(__file__).parent / f"{name}.npz", **columns)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
