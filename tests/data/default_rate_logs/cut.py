"""Writes the small copies in this folder: the topics that the health of a flight is read from, the fast ones thinned.

Needs pyulog and the full logs, which are too large to be kept here:
    PYTHONPATH=. python tests/data/default_rate_logs/cut.py FOLDER_OF_FULL_LOGS
"""

from __future__ import annotations

import gzip
import io
import sys
from pathlib import Path

import numpy as np
from pyulog import ULog

from fixtures.ulog_file import Topic, ulog_file

LOGS = {
    "battery_brownout": "disconnected_battery",
    "gps_interference": "no_satellites",
    "motor_failure": "uavcan",
}  # the authors' names, which are not what the logs hold, and ours
THINNED = {"sensor_combined": 6, "vehicle_angular_velocity": 2, "vehicle_rates_setpoint": 2, "estimator_status": 2}
FAST = 45.0  # Hz, below which a topic stays whole; estimator_status is large
TOPICS = (
    "actuator_armed", "actuator_motors", "actuator_outputs", "actuator_controls_0", "battery_status", "esc_status",
    "estimator_selector_status", "estimator_status", "failsafe_flags", "failure_detector_status", "sensor_combined",
    "vehicle_attitude", "vehicle_attitude_setpoint", "vehicle_gps_position", "vehicle_imu_status",
    "vehicle_land_detected", "vehicle_local_position", "vehicle_rates_setpoint", "vehicle_status",
)  # fmt: skip
PARAMETERS = ("MAV_TYPE", "SYS_", "CA_", "THR_MDL_FAC", "MPC_THR_HOVER", "MC_", "PWM_", "UAVCAN_", "BAT", "COM_")
OF_FIRST = ("estimator_status",)  # topics of whose instances the first is enough
LEFT_OUT = (
    "covariances[",
    "states[",
    "delta_q",
    "evv",
    "evh",
    "quaternion",
    "average_",
    "voltage_cell",
    "ocv",
    "volt_based",
    "internal_r",
    "timestamp_sample",
    "roll_body",
    "pitch_body",
    "yaw_",
    "ref_",
    "dist_",
    "heading",
    "output_tracking",
    "pos_horiz_acc",
    "pos_vert_acc",
    "mag_str",
    "mag_incl",
    "reset_count",
)


def main() -> None:
    """Writes the copies beside this file."""
    for name, ours in LOGS.items():
        full = gzip.decompress((Path(sys.argv[1]) / f"{name}.ulg.gz").read_bytes())
        Path(__file__).with_name(f"{ours}.ulg.gz").write_bytes(gzip.compress(cut(full), 9, mtime=0))


def cut(full: bytes) -> bytes:
    """The log with some of its topics and parameters."""
    log = ULog(io.BytesIO(full), list(TOPICS))
    topics = []
    for topic in sorted(log.data_list, key=lambda topic: (topic.name, topic.multi_id)):
        if topic.name in OF_FIRST and topic.multi_id:
            continue
        names = [n for n in topic.data if n != "timestamp" and not n.startswith(LEFT_OUT) and "_padding" not in n]
        seconds = (int(topic.data["timestamp"][-1]) - int(topic.data["timestamp"][0])) * 1e-6
        is_fast = len(topic.data["timestamp"]) > FAST * seconds or topic.name == "estimator_status"
        rows = slice(None, None, THINNED.get(topic.name, 1) if is_fast else 1)
        columns = {"timestamp": topic.data["timestamp"][rows].astype("<u8")}
        columns |= {n: _plain(topic.data[n][rows]) for n in names}
        topics.append(Topic(topic.name, columns, topic.multi_id))
    kept = {name: value for name, value in log.initial_parameters.items() if name.startswith(PARAMETERS)}
    return ulog_file(topics, kept)


def _plain(values: np.ndarray) -> np.ndarray:
    """Numbers of a type that the format has."""
    return values.astype("u1") if values.dtype == bool else values


if __name__ == "__main__":
    main()
