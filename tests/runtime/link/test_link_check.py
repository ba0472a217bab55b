"""The check of a link reports vehicle, rates and problems, without sending a setpoint."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mavlink

from dynamics.errors import RequestError, VehicleError
from runtime.link.connection import Endpoint
from runtime.link.link_check import check_link
from runtime.link.link_report import LinkReport
from simulation.mock_process import free_port
from tests.support.fake_vehicle import FakeVehicle

pytestmark = pytest.mark.realtime

WINDOW = 0.5
PARAMETERS = {
    "MPC_THR_HOVER": 0.5, "THR_MDL_FAC": 0.0, "COM_OF_LOSS_T": 1.0, "COM_DISARM_PRFLT": 10.0, "MC_ROLLRATE_MAX": 220.0,
    "MC_PITCHRATE_MAX": 220.0, "MC_YAWRATE_MAX": 200.0, "MC_ROLL_P": 4.0, "MC_PITCH_P": 4.0, "MC_YAW_P": 2.8,
}  # fmt: skip


class StreamingVehicle(FakeVehicle):
    """A vehicle at rest on the ground that streams its estimate and IMU at fixed rates, whatever is requested."""

    def __init__(self, port: int, rate: float = 100.0, **odometry: Any) -> None:
        super().__init__(("127.0.0.1", port))
        self.parameters = {name: (value, 9) for name, value in PARAMETERS.items()}
        self.parameters["COM_OBL_RC_ACT"] = (0.0, 6)
        self.specific_force = (0.0, 0.0, -9.81)
        self._rate, self._odometry, self._streaming = rate, odometry, threading.Event()
        self._streamer = threading.Thread(target=self._stream, daemon=True)

    def __enter__(self) -> StreamingVehicle:
        super().__enter__()
        self._streamer.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._streaming.set()
        self._streamer.join()
        super().__exit__(*error)

    def _stream(self) -> None:
        due = time.monotonic()
        for n in range(100_000):
            due += 1.0 / self._rate
            if self._streaming.wait(max(0.0, due - time.monotonic())):
                return
            self.send_odometry(**self._odometry)
            self.send(mavlink.MAVLink_highres_imu_message(0, *self.specific_force, *[0.0] * 10, 63))
            cells = [4000, 4000, 4000, 4000] + [65535] * 6
            if n % 20 == 0:
                self.send(mavlink.MAVLink_battery_status_message(0, 1, 1, 0, cells, -1, -1, -1, 80))


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def vehicle(port: int) -> Iterator[StreamingVehicle]:
    with StreamingVehicle(port) as fake:
        yield fake


def check(port: int, rate: float = 100.0, *, request_mode: bool = False) -> LinkReport:
    streams, endpoint = {"ODOMETRY": rate, "HIGHRES_IMU": 50.0}, Endpoint("udpin", "127.0.0.1", port)
    return check_link(endpoint, timeout=5.0, streams=streams, window=WINDOW, request_mode=request_mode)


def problems(report: LinkReport) -> str:
    return " ".join(problem.text for problem in report.problems if problem.severity == "error")


def test_a_good_link_is_ready(port: int, vehicle: StreamingVehicle) -> None:
    report = check(port)
    assert report.is_ready, report.problems
    assert (report.vehicle.system, report.vehicle.autopilot, report.vehicle.mode) == (1, "px4", "HOLD")
    assert report.odometry_frames == ("LOCAL_NED", "LOCAL_NED")
    stream = report.streams[0]
    assert (stream.name, stream.answer) == ("ODOMETRY", "accepted")
    assert stream.after.rate == pytest.approx(100.0, rel=0.2)
    assert report.clock.settled
    assert report.clock.offset == pytest.approx(vehicle.clock_offset, abs=0.05)
    assert report.attitude is not None
    assert report.attitude.specific_force == pytest.approx(9.81, abs=1e-3)
    assert report.attitude.tilt_error_degrees < 0.1
    assert report.parameters["MC_YAW_P"] == pytest.approx(2.8)
    assert report.vehicle.battery_voltage == pytest.approx(16.0)
    assert report.acknowledgements_of_mode == 0


class HastyVehicle(StreamingVehicle):
    """A vehicle whose estimates are stamped ahead of the clock by which it answers TIMESYNC."""

    lead = 3.0

    def send_odometry(self, **overrides: Any) -> None:
        super().send_odometry(time_usec=int((self.clock() + self.lead) * 1e6), **overrides)


@pytest.mark.parametrize("lead", [3.0, 0.5, 1000.0])
def test_estimates_from_the_future_are_refused_with_the_figure(port: int, lead: float) -> None:
    vehicle = HastyVehicle(port)
    vehicle.lead = lead
    with vehicle:
        report = check(port)
    assert not report.is_ready
    figure = re.search(r"ODOMETRY is stamped (\d+\.\d+) s ahead", problems(report))
    assert figure is not None, report.problems
    assert float(figure[1]) == pytest.approx(lead, abs=0.1)


def test_only_message_rates_are_requested_and_the_streams_are_reset_to_their_defaults(
    port: int, vehicle: StreamingVehicle
) -> None:
    check(port)
    assert vehicle.count("SET_ATTITUDE_TARGET") == 0
    commands = [message for message in vehicle.received if message.get_type() == "COMMAND_LONG"]
    assert {message.command for message in commands} == {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL}
    assert vehicle.count("PARAM_SET") == vehicle.count("SET_MODE") == 0
    intervals = [message.param2 for message in commands if message.command == 511 and message.param1 == 331]
    assert intervals == [10000.0, 0.0]
    assert vehicle.custom_mode == 4 << 16 | 3 << 24


def test_a_double_acknowledgement_is_counted(port: int, vehicle: StreamingVehicle) -> None:
    vehicle.acknowledgements[mavlink.MAV_CMD_DO_SET_MODE] = [0, 1]
    assert check(port, request_mode=True).acknowledgements_of_mode == 2


def test_a_slow_estimate_stops_a_flight(port: int) -> None:
    with StreamingVehicle(port, rate=30.0):
        report = check(port)
    assert not report.is_ready
    assert "ODOMETRY comes at" in problems(report)


def test_unknown_axes_stop_a_flight(port: int) -> None:
    with StreamingVehicle(port, frame_id=20, child_frame_id=12):
        report = check(port)
    assert report.odometry_frames == ("LOCAL_FRD", "BODY_FRD")
    assert "frame_id is 20 (LOCAL_FRD)" in problems(report)
    assert "No state estimate arrived" in problems(report)


def test_gravity_reveals_a_wrong_attitude(port: int, vehicle: StreamingVehicle) -> None:
    vehicle.specific_force = (0.0, -9.81, 0.0)
    report = check(port)
    assert report.attitude is not None
    assert report.attitude.tilt_error_degrees == pytest.approx(90.0, abs=0.1)
    assert "off the vertical" in problems(report)


def test_dangerous_parameters_are_warned_of(port: int, vehicle: StreamingVehicle) -> None:
    vehicle.parameters["COM_OF_LOSS_T"] = (30.0, 9)
    del vehicle.parameters["THR_MDL_FAC"]
    report = check(port)
    texts = [problem.text for problem in report.problems]
    assert any("COM_OF_LOSS_T is 30 s" in text for text in texts)
    assert any("Not read from the vehicle: THR_MDL_FAC" in text for text in texts)
    assert report.parameters["THR_MDL_FAC"] == "does_not_exist"
    assert not report.is_ready


def test_a_silent_link_is_refused(port: int) -> None:
    with pytest.raises(VehicleError, match="No MAVLink arrived"):
        check_link(Endpoint("udpin", "127.0.0.1", port), timeout=0.1)


def test_an_unknown_stream_is_refused(port: int, vehicle: StreamingVehicle) -> None:
    with pytest.raises(RequestError, match="ODOMETER"):
        check_link(Endpoint("udpin", "127.0.0.1", port), timeout=5.0, streams={"ODOMETER": 100.0}, window=0.01)


def test_rates_after_the_request_are_not_mixed_with_those_before(port: int) -> None:
    class Obedient(StreamingVehicle):
        def _answer_command(self, message: Any) -> None:
            super()._answer_command(message)
            if (message.command, message.param1) == (511, 331.0):
                self._rate = 100.0

    with Obedient(port, rate=20.0):
        stream = check(port).streams[0]
    assert stream.before == pytest.approx(20.0, rel=0.3)
    assert stream.after.rate == pytest.approx(100.0, rel=0.2)
