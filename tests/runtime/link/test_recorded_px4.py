"""A recorded link to real PX4 goes through the link's own code and gives what PX4 logged of the same flight."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from dynamics import quaternion
from dynamics.arrays import Floats
from runtime.link.dialect import mavlink
from runtime.link.estimate import StateEstimate
from runtime.link.framing import Frame
from runtime.link.odometry import read_odometry
from runtime.link.peer import Peer
from runtime.link.telemetry import ImuSample, LinkEvent, MotorOutputs
from runtime.record.tlog import read_tlog

FOLDER = Path(__file__).parents[2] / "data" / "px4_sih_offboard"
NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_TO_FLU = np.diag([1.0, -1.0, -1.0])
NAV_STATES = {4: "HOLD", 14: "OFFBOARD", 5: "RTL", 18: "LAND"}


class Replay(NamedTuple):
    frames: list[tuple[float, Frame]]
    peer: Peer
    estimates: list[tuple[float, StateEstimate]]  # with the vehicle's own time of the state
    events: list[LinkEvent]
    telemetry: Counter[type]


@pytest.fixture(scope="module")
def replay() -> Replay:
    peer, estimates, events, telemetry = Peer(), [], [], Counter[type]()
    recorded = list(read_tlog(FOLDER / "offboard_hover.tlog.gz"))
    start = recorded[0][0]
    frames = [(time - start, frame) for time, frame in recorded]
    for received, frame in frames:
        reaction = peer.handle(frame, received)
        events += reaction.events
        if reaction.telemetry is not None:
            telemetry[type(reaction.telemetry)] += 1
        if frame.message_id == mavlink.MAVLINK_MSG_ID_ODOMETRY:
            boot = read_odometry(frame.payload).time
            if reaction.estimate is not None:
                estimates.append((boot, reaction.estimate))
    return Replay(frames, peer, estimates, events, telemetry)


@pytest.fixture(scope="module")
def log() -> dict[str, Floats]:
    with np.load(FOLDER / "offboard_hover.npz") as data:
        return {name: data[name].astype(float) for name in data.files}


def _at(log: dict[str, Floats], topic: str, times: Floats) -> Floats:
    logged_times = log[f"{topic}_time_usec"] * 1e-6
    return np.stack([np.interp(times, logged_times, column) for column in log[topic].T], axis=-1)


@pytest.fixture(scope="module")
def logged_flight(replay: Replay, log: dict[str, Floats]) -> list[tuple[float, StateEstimate]]:
    """The estimates within the log, which ends with the disarming."""
    end = log["vehicle_attitude_time_usec"][-1] * 1e-6
    flight = [(boot, estimate) for boot, estimate in replay.estimates if boot <= end]
    assert len(flight) > 6300
    return flight


def test_every_message_is_understood(replay: Replay) -> None:
    assert len(replay.frames) == 50402
    assert all(frame.is_known for _, frame in replay.frames)
    names = Counter(frame.message.get_type() for _, frame in replay.frames)
    assert not any(name.startswith(("UNKNOWN", "BAD_DATA")) for name in names)
    assert names["ODOMETRY"] == 6624
    assert names["LINK_NODE_STATUS"] == 66
    assert names["CURRENT_MODE"] == 33


def test_every_estimate_of_the_flight_is_accepted(replay: Replay) -> None:
    heard = next(received for received, frame in replay.frames if frame.message_id == 0 and frame.component == 1)
    odometry = [time for time, frame in replay.frames if frame.message_id == 331 and time > heard]
    assert len(replay.estimates) == len(odometry)
    assert not [event for event in replay.events if event.name.startswith("estimat")]


def test_positions_and_velocities_are_those_of_the_log_in_our_frames(
    logged_flight: list[tuple[float, StateEstimate]], log: dict[str, Floats]
) -> None:
    logged = _at(log, "vehicle_local_position", np.array([boot for boot, _ in logged_flight]))
    position = np.array([estimate.position_world for _, estimate in logged_flight])
    velocity = np.array([estimate.velocity_world for _, estimate in logged_flight])
    # the log has 125 of 250 samples a second: half of the comparisons interpolate over 8 ms
    assert np.abs(position - logged[:, 0:3] @ NED_TO_ENU.T).max() < 0.02
    assert np.abs(velocity - logged[:, 3:6] @ NED_TO_ENU.T).max() < 0.08
    assert np.ptp(position[:, 2]) > 4.0


def test_attitudes_are_those_of_the_log_and_continuous(
    logged_flight: list[tuple[float, StateEstimate]], log: dict[str, Floats]
) -> None:
    times = np.array([boot for boot, _ in logged_flight])
    logged_times = log["vehicle_attitude_time_usec"] * 1e-6
    nearest = np.searchsorted(logged_times, times - 1e-4)
    exact = np.abs(logged_times[nearest] - times) < 1e-4
    assert exact.sum() > 3000
    attitude = np.array([estimate.attitude for _, estimate in logged_flight])
    logged = quaternion.rotation_matrix(log["vehicle_attitude"][nearest[exact]])
    ours = quaternion.rotation_matrix(attitude[exact])
    assert np.abs(ours - NED_TO_ENU @ logged @ FRD_TO_FLU).max() < 1e-5
    assert (np.sum(attitude[1:] * attitude[:-1], axis=1) > 0.99).all()


def test_body_rates_are_those_of_the_log(
    logged_flight: list[tuple[float, StateEstimate]], log: dict[str, Floats]
) -> None:
    times = np.array([boot for boot, _ in logged_flight])
    logged_times = log["vehicle_angular_velocity_time_usec"] * 1e-6
    nearest = np.searchsorted(logged_times, times - 1e-4)
    exact = np.abs(logged_times[nearest] - times) < 1e-4
    assert exact.sum() > 1000
    logged = log["vehicle_angular_velocity"][nearest[exact]] @ FRD_TO_FLU.T
    rates = np.array([estimate.rate_body for _, estimate in logged_flight])[exact]
    # the log's rates are low-pass filtered and the link's are not, so that the gyro's noise stands between them
    assert np.percentile(np.abs(rates - logged), 99) < 0.1
    correlation = [np.corrcoef(rates[:, axis], logged[:, axis])[0, 1] for axis in range(3)]
    assert min(correlation) > 0.9, correlation


def test_states_are_dated_by_the_vehicle_s_clock(replay: Replay) -> None:
    dated = [(boot, estimate) for boot, estimate in replay.estimates if estimate.is_synchronised]
    assert len(dated) > 6500
    age = np.array([estimate.received - estimate.time for _, estimate in dated])
    assert age.min() >= 0.0
    assert np.percentile(age, 99.5) < 0.015
    assert age.max() > 0.1  # the recording's two stalls come out as old states, not as new ones
    # successive states are as far apart as on the vehicle's clock, whose drift is under 1 per cent
    spacing = np.diff([estimate.time for _, estimate in dated])
    boot_spacing = np.diff([boot for boot, _ in dated])
    assert np.percentile(np.abs(spacing - boot_spacing), 99) < 2e-3


def test_mode_changes_and_the_failsafe_are_observed_when_they_happened(replay: Replay, log: dict[str, Floats]) -> None:
    times = log["vehicle_status_time_usec"] * 1e-6
    states = [NAV_STATES[int(state)] for state in log["vehicle_status"][:, 0]]
    mode_changes = [(states[i], times[i]) for i in range(1, len(states)) if states[i] != states[i - 1]]
    observed = [
        (event.text.split()[-1].rstrip("."), event.time) for event in replay.events if event.name == "mode_changed"
    ]
    assert [mode for mode, _ in observed] == [mode for mode, _ in mode_changes]
    boots, arrivals = zip(*((boot, estimate.received) for boot, estimate in replay.estimates), strict=True)
    happened = np.interp([time for _, time in mode_changes], boots, arrivals)
    delays = np.array([time for _, time in observed]) - happened
    assert delays.min() > -0.02
    assert delays.max() < 1.1  # a heartbeat a second

    failsafe = np.interp(times[np.flatnonzero(log["vehicle_status"][:, 2])[0]], boots, arrivals)
    critical = next(event for event in replay.events if event.name == "vehicle_critical")
    assert "RTL" in critical.text
    assert 0.0 < critical.time - failsafe < 1.1


def test_arming_and_landing_are_observed(replay: Replay) -> None:
    names = [event.name for event in replay.events if event.name in ("armed", "disarmed")]
    assert names == ["armed", "disarmed"]
    landed = [event.text.split()[-1].rstrip(".") for event in replay.events if event.name == "landed_state"]
    assert landed[0] == "on_ground"
    assert "in_air" in landed
    assert landed[-1] == "on_ground"


def test_sensors_and_outputs_are_read(replay: Replay) -> None:
    assert replay.telemetry[ImuSample] > 3000
    assert replay.telemetry[MotorOutputs] > 3000
    imu = replay.peer.latest[ImuSample]
    assert isinstance(imu, ImuSample)
    assert imu.specific_force_body[2] == pytest.approx(9.8, abs=0.5)
    assert replay.peer.status.battery_voltage == pytest.approx(16.2)
