"""Writes offboard_hover.npz, the columns of PX4's own log that the tests compare the recorded link with.

Needs pyulog and the full log, which is too large to be kept here:
    python tests/data/px4_sih_offboard/extract.py offboard_hover.ulg.gz
"""

from __future__ import annotations

import gzip
import io
import sys
from pathlib import Path

import numpy as np
from pyulog import ULog

COLUMNS = {  # topic -> columns, and how many rows to step over
    "vehicle_local_position": (["timestamp_sample", "x", "y", "z", "vx", "vy", "vz"], 1),
    "vehicle_attitude": (["timestamp_sample", "q[0]", "q[1]", "q[2]", "q[3]"], 2),
    "vehicle_angular_velocity": (["timestamp_sample", "xyz[0]", "xyz[1]", "xyz[2]"], 1),
    "vehicle_status": (["timestamp", "nav_state", "arming_state", "failsafe"], 1),
    "vehicle_land_detected": (["timestamp", "landed"], 1),
}


def main() -> None:
    """Extracts the columns beside this file."""
    log = ULog(io.BytesIO(gzip.decompress(Path(sys.argv[1]).read_bytes())), list(COLUMNS))
    arrays = {}
    for topic, (columns, step) in COLUMNS.items():
        data = log.get_dataset(topic).data
        time = data[columns[0]][::step].astype(np.int64)
        arrays[f"{topic}_time_usec"] = time
        arrays[topic] = np.stack([data[column][::step].astype(np.float32) for column in columns[1:]], axis=1)
    np.savez_compressed(Path(__file__).with_name("offboard_hover.npz"), **arrays)


if __name__ == "__main__":
    main()
