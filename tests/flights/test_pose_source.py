"""A flight says whether its pose is motion capture's or an estimator's, where the log or the user tells."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from dynamics.errors import RequestError
from flights import Flight, Stream, read_log
from flights.log import LogContent
from flights.pose_source import AIDING, KEY, known_source

DATA = Path(__file__).parent.parent / "data"


def content(**sources):
    time = np.arange(3.0)
    return LogContent(tuple(Stream(name, time, np.zeros((3, 3)), source) for name, source in sources.items()))


def test_an_autopilots_log_holds_its_estimators_pose():
    log = read_log(next((DATA / "px4_sih_offboard").glob("*.ulg.gz")))
    assert log.metadata[KEY] == "estimator"
    assert AIDING not in log.metadata
    assert Flight.from_log(log).pose_source == "estimator"


@pytest.mark.parametrize(
    ("name", "sources", "expected"),
    [
        ("ulog", {"position": "vehicle_local_position", "attitude": "vehicle_attitude"}, "estimator"),
        ("ulog", {"position": "vehicle_mocap_odometry", "attitude": "vehicle_mocap_odometry"}, "motion_capture"),
        ("ulog", {"position": "vehicle_visual_odometry"}, "unknown"),
        ("tlog", {"velocity": "LOCAL_POSITION_NED", "attitude": "ATTITUDE"}, "estimator"),
        ("mcap", {"velocity": "/estimate", "attitude": "/estimate"}, "estimator"),
        ("rosbag", {"position": "/vrpn_client_node/drone/pose", "attitude": "/vrpn_client_node/drone/pose"},
         "motion_capture"),
        ("rosbag", {"velocity": "/mavros/local_position/odom", "position": "/vicon/drone"}, "estimator"),
        ("rosbag", {"velocity": "/odometry"}, "unknown"),
        ("crazyflie", {"velocity": "stateEstimate.vx/vy/vz"}, "estimator"),
        ("csv", {"velocity": "velocity_x, ..., velocity_z"}, "unknown"),
        ("csv", {"rate": "rate_x, ..., rate_z"}, "unknown"),
    ],
)  # fmt: skip
def test_format_and_topics_tell_where_the_pose_comes_from(name, sources, expected):
    assert known_source(name, content(**sources)) == expected


def test_a_csv_does_not_tell_and_its_user_does(tmp_path):
    time = np.arange(50) / 50
    table = np.column_stack([time, np.zeros((50, 3)), np.ones(50), np.zeros((50, 6))])
    names = "t,velocity_x,velocity_y,velocity_z,attitude_w,attitude_x,attitude_y,attitude_z,rate_x,rate_y,rate_z"
    path = tmp_path / "flight.csv.gz"
    path.write_bytes(gzip.compress("\n".join([names, *(",".join(map(str, row)) for row in table)]).encode()))
    assert Flight.from_log(read_log(path)).pose_source == "unknown"
    flight = Flight.from_log(read_log(path, pose="mocap"))
    assert flight.pose_source == "motion_capture"
    restored = Flight.read(flight.to_parquet(tmp_path / "flight.parquet"))
    assert restored.pose_source == "motion_capture"
    with pytest.raises(RequestError, match="mocap"):
        read_log(path, pose="gps")
