"""Writes the small copies in this folder: what diagnosis reads, rounded far below the sensors' noise.

Needs pyulog and the full logs, which are too large to be kept here:
    PYTHONPATH=. python tests/data/px4_sih_flights/thin.py FOLDER_OF_FULL_LOGS
"""

from __future__ import annotations

import gzip
import io
import sys
from pathlib import Path

import numpy as np
from pyulog import ULog

from fixtures.ulog_file import Topic, ulog_file

FLIGHTS = (
    "nothing_1_circle", "nothing_2_line", "nothing_3_warped_ellipse_2", "drag2_1_circle", "drag2_4_lemniscate",
    "mass125_1_circle", "mass125_2_line", "lag90_1_circle", "lag90_2_line", "textbook_1_circle",
    "refused_lying_61deg", "tipped_140deg",
)  # fmt: skip
STEPS: dict[str, dict[str, float | None]] = {  # topic -> fields and what they are rounded to, SI; None: as they are
    "actuator_motors": {f"control[{i}]": 2**-12 for i in range(12)},
    "sensor_combined": {
        **{f"gyro_rad[{i}]": 2**-11 for i in range(3)},
        **{f"accelerometer_m_s2[{i}]": 2**-7 for i in range(3)},
    },
    "vehicle_attitude": {**{f"q[{i}]": 2**-15 for i in range(4)}, "quat_reset_counter": None},
    "vehicle_local_position": {
        **dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 2**-11),
        **dict.fromkeys(("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")),
        **dict.fromkeys(("xy_reset_counter", "z_reset_counter", "vxy_reset_counter", "vz_reset_counter")),
    },
    "battery_status": dict.fromkeys(("voltage_v", "current_a", "connected")),
    "vehicle_status": dict.fromkeys(("arming_state", "system_type")),
    "vehicle_land_detected": dict.fromkeys(("landed", "ground_contact", "maybe_landed")),
    "actuator_armed": {"armed": None},
}


def main() -> None:
    """Writes the copies beside this file."""
    for name in FLIGHTS:
        full = gzip.decompress((Path(sys.argv[1]) / f"{name}.ulg.gz").read_bytes())
        file = Path(__file__).with_name(f"{name}.ulg.gz")
        file.write_bytes(gzip.compress(thinned(full), 9, mtime=0))


def thinned(full: bytes) -> bytes:
    """The log with what `STEPS` names and its parameters, each row at the time of its sample."""
    log = ULog(io.BytesIO(full), list(STEPS))
    topics = []
    for topic in log.data_list:
        sampled = topic.data["timestamp_sample" if "timestamp_sample" in topic.data else "timestamp"]
        columns = {"timestamp": sampled.astype(np.uint64)}
        for name, step in STEPS[topic.name].items():
            values = topic.data[name]
            columns[name] = values if step is None else (np.round(values / step) * step).astype(values.dtype)
        topics.append(Topic(topic.name, columns))
    return ulog_file(topics, log.initial_parameters)


if __name__ == "__main__":
    main()
