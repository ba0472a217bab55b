"""The daemon on a real link to the mock: it flies, and what goes wrong ends in a safe state with a clear message."""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.errors import VehicleError
from dynamics.signing_key import SigningKey
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime import daemon as daemon_module
from runtime import supervisor as supervisor_module
from runtime.daemon import Daemon
from runtime.flight.decision import FlyerSettings
from runtime.flight.engagement import EngagementSettings
from runtime.flight.failsafe import FallbackBounds
from runtime.flight.health import HealthLimits
from runtime.flight.mission import Plan
from runtime.flight.motion import Transfer
from runtime.flight.phases import PHASES, Handler, Phase
from runtime.flight_request import FlightReport, FlightRequest
from runtime.link.connection import parse_endpoint
from runtime.link.link import Link
from runtime.record.recorder import Recorder
from runtime.record.recording import FlightRecording, read_recording
from runtime.record.records import ObservationRecord, TickRecord
from runtime.replay import replay
from runtime.setpoint_stream import SetpointStream
from simulation.mock_process import free_port, mock_process
from tests.support.serial_cable import SerialCable
from vehicles import FOLDER

pytestmark = pytest.mark.realtime

VEHICLE_FILE = FOLDER / "px4_sih.toml"
# a test machine that is busy starves the mock, which is not what is tested here
PATIENT = FlyerSettings(
    health=HealthLimits(stale=0.15, oldest=0.5),
    bounds=FallbackBounds(shifted_ticks=30, level_hold=3.0),
    engagement=EngagementSettings(patience=20.0),
)
PLAN = Plan(height=1.0, settle=0.3, speed=2.0, acceleration=3.0)
NORTH = np.pi / 2  # as the mock stands: turning to another heading would take 4 s before the reference, and 4 s after


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return read_vehicle(VEHICLE_FILE)


def reference_of(vehicle: Vehicle) -> Transfer:
    return Transfer(vehicle, np.array([0.5, 0.0, 1.0, NORTH]), np.array([-0.5, 0.3, 1.0, NORTH + 0.3]), 2.0)


class Announcements(list[str]):
    """What a daemon announced; calls what waits for a word of it."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: dict[str, Callable[[], None]] = {}

    def __call__(self, text: str) -> None:
        self.append(text)
        for word in [word for word in self.waiting if word in text]:
            self.waiting.pop(word)()

    def contain(self, word: str) -> bool:
        return any(word in text for text in self)


def request_for(url: str, **options: object) -> FlightRequest:
    defaults = {"plan": PLAN, "settings": PATIENT}
    return FlightRequest(endpoint=parse_endpoint(url), **{**defaults, **options})  # type: ignore[arg-type]


def fly(vehicle: Vehicle, announcements: Announcements, request: FlightRequest) -> FlightReport:
    return Daemon(request, vehicle, reference_of(vehicle), announcements).fly()


def scenario(folder: Path, *faults: str) -> list[str]:
    path = folder / "scenario.toml"
    path.write_text("\n".join(f"[[faults]]\n{fault}" for fault in faults))
    return ["--scenario", str(path)]


@pytest.fixture
def service_manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """What a service manager heard, complete once the flight is over."""
    messages: list[str] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        listening = threading.Thread(target=lambda: [*iter(lambda: hear(listener, messages), "")])
        listening.start()
        yield messages
        listener.shutdown(socket.SHUT_RDWR)
        listening.join()


def hear(listener: socket.socket, messages: list[str]) -> str:
    message = listener.recv(4096).decode()
    messages.append(message)
    return message


@pytest.mark.long("a flight against the clock")
def test_it_flies_and_its_recording_replays_bit_for_bit(
    vehicle: Vehicle, tmp_path: Path, service_manager: list[str]
) -> None:
    announcements = Announcements()
    with mock_process(vehicle=VEHICLE_FILE) as mock:
        report = fly(vehicle, announcements, request_for(mock.url, record=tmp_path, name="flight"))
    assert report.landed, announcements
    assert report.tracking.position_rmse < 0.2
    assert report.timing.ticks > 500
    assert 0 < report.start_up < 20
    assert not {"clock_uncertain", "rates_low"} & set(report.events), announcements
    recording = read_recording(tmp_path / "flight.mcap")
    assert recording.complete
    assert in_flight(recording) > 0.7
    assert {"/imu", "/battery", "/rotors", "/horizon", "/phase", "/parameter", "/pose"} <= set(recording.messages)
    assert replay(recording, vehicle, reference_of(vehicle)).exact
    tlog = (tmp_path / "flight.tlog").read_bytes()
    sent = len(recording.messages["/setpoint"])
    assert tlog.count(b"\xfd") > sent
    others = [message for message in service_manager if message != "WATCHDOG=1"]
    assert others[0] == "READY=1"
    assert any("ENGAGED" in message for message in others)
    assert others.count("STOPPING=1") == 1
    assert len(service_manager) - len(others) > report.timing.ticks / 20


def in_flight(recording: FlightRecording) -> float:
    """Share of the ticks by an estimate, in phases that the controller flies, whose setpoint left by the tick in C."""
    answered = {observation.tick: observation.answered for observation in recording.records(ObservationRecord)}
    flown = [
        answered[tick.tick]
        for tick in recording.records(TickRecord)
        if tick.trigger == "estimate" and PHASES[Phase(tick.phase)].handler is Handler.FLY
    ]
    return sum(flown) / len(flown)


@pytest.mark.long("a flight against the clock")
def test_a_signed_flight_is_answered_in_c_as_well(
    vehicle: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    key, announcements = SigningKey(bytes(range(1, 33))), Announcements()
    with mock_process(vehicle=VEHICLE_FILE) as mock:
        with Link(parse_endpoint(mock.url)) as link:
            link.wait_for_vehicle()
            link.send_signing_setup(key)
            time.sleep(0.5)
        request = request_for(mock.url, record=tmp_path, name="flight", signing_key=key)
        report = fly(vehicle, announcements, request)
    assert report.landed, announcements
    recording = read_recording(tmp_path / "flight.mcap")
    assert in_flight(recording) > 0.7
    assert replay(recording, vehicle, reference_of(vehicle)).exact


class SmallDisk:
    """A raw file on a disk with room for 300 kB."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._room = 300_000

    def write(self, data: bytes) -> int:
        if len(data) > self._room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._room -= len(data)
        return self._file.write(data)

    def truncate(self, size: int) -> None:
        self._file.truncate(size)

    def close(self) -> None:
        self._file.close()


@pytest.mark.long("a flight against the clock")
def test_a_bad_day_is_flown_through_and_an_interrupt_lands(
    vehicle: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(daemon_module, "Recorder", functools.partial(Recorder, opener=SmallDisk))
    arguments = scenario(
        tmp_path,
        'kind = "estimate_nan"\nat = 2.0\nafter = "takeoff"\nduration = 0.4',
        'kind = "estimator_reset"\nat = 3.0\nafter = "takeoff"\nshift = [1.0, -0.5, 0.2]\nyaw = 0.3',
        'kind = "clock_jump"\nat = 4.5\nafter = "takeoff"\nseconds = -1.0',
    )
    announcements = Announcements()
    with mock_process(*arguments, vehicle=VEHICLE_FILE) as mock:
        request = request_for(mock.url, record=tmp_path, name="flight")
        daemon = Daemon(request, vehicle, reference_of(vehicle), announcements)
        interrupt = threading.Timer(6.0, lambda: daemon.interrupt("SIGINT"))
        announcements.waiting["in_air"] = interrupt.start
        report = daemon.fly()
        interrupt.cancel()
    assert report.landed, announcements
    assert report.landing_reason == "SIGINT"
    assert {"input_not_finite", "estimator_reset", "disk_full"} <= set(report.events)
    assert announcements.contain("ran backwards"), announcements
    assert announcements.contain("No space left"), announcements
    assert len(read_recording(tmp_path / "flight.mcap").messages["/estimate"]) > 100


def test_estimates_that_stop_end_in_silence_and_the_autopilot_s_failsafe(vehicle: Vehicle, tmp_path: Path) -> None:
    arguments = scenario(tmp_path, 'kind = "estimate_stop"\nat = 2.5\nafter = "takeoff"')
    # PX4 says in_air from the first thrust on: 1 s later it still stands
    announcements = Announcements()
    with mock_process(*arguments, vehicle=VEHICLE_FILE) as mock:
        report = fly(vehicle, announcements, request_for(mock.url))
    assert not report.landed
    assert "failsafe" in report.outcome
    assert "armed" in report.outcome
    assert announcements.contain("ENGAGED -> FALLBACK")


def test_a_refused_mode_is_reported_and_nothing_takes_off(vehicle: Vehicle, tmp_path: Path) -> None:
    arguments = scenario(tmp_path, 'kind = "refuse_offboard"\nat = 0.0')
    settings = FlyerSettings(engagement=EngagementSettings(patience=2.0))
    announcements = Announcements()
    with mock_process(*arguments, vehicle=VEHICLE_FILE) as mock:
        report = fly(vehicle, announcements, request_for(mock.url, settings=settings))
    assert not report.landed
    assert "HEARTBEAT did not show OFFBOARD" in report.outcome
    assert "rejected" in report.outcome


def test_a_pilot_who_is_to_arm_is_told_so_and_nothing_moves_before(vehicle: Vehicle) -> None:
    announcements = Announcements()
    settings = msgspec.structs.replace(PATIENT, engagement=EngagementSettings(arm=False, pilot_patience=1.0))
    with mock_process(vehicle=VEHICLE_FILE) as mock:
        report = fly(vehicle, announcements, request_for(mock.url, settings=settings))
    assert "the pilot did not arm within 1 s" in report.outcome
    assert not report.landed
    assert announcements.contain("waiting for the pilot to arm")


def test_slow_streams_are_not_flown_with(vehicle: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "READINESS_PATIENCE", 3.0)
    arguments = scenario(tmp_path, 'kind = "packet_loss"\nat = 0.0\nprobability = 0.4')
    announcements = Announcements()
    with mock_process(*arguments, vehicle=VEHICLE_FILE) as mock:
        report = fly(vehicle, announcements, request_for(mock.url))
    assert not report.landed
    assert "streams are too slow" in report.outcome
    assert report.timing.latency["median"] != report.timing.latency["median"]  # no setpoint ever left


OFF = 5.0  # s that a vehicle is off while it restarts, longer than a link may be silent


@pytest.mark.long("two starts of an autopilot, and a flight")
def test_a_vehicle_restarted_on_the_ground_is_asked_for_its_streams_again(vehicle: Vehicle) -> None:
    announcements = Announcements()
    with contextlib.ExitStack() as stack:
        mock = stack.enter_context(mock_process(vehicle=VEHICLE_FILE))

        def restart() -> None:
            mock.stop(signal.SIGKILL)
            link = ["--link", f"udpout:127.0.0.1:{mock.port}", "--gcs-link", f"udpout:127.0.0.1:{mock.gcs_port}"]
            command = [sys.executable, "-m", "alula", "mock", "--vehicle", str(VEHICLE_FILE), *link]
            late = ["sh", "-c", f'sleep {OFF}; exec "$@"', "sh", *command]
            process = stack.enter_context(subprocess.Popen(late, stderr=subprocess.DEVNULL))
            stack.callback(process.terminate)

        announcements.waiting["DISCONNECTED -> STANDBY"] = restart
        report = fly(vehicle, announcements, request_for(mock.url, timeout=30.0))
    assert report.landed, announcements
    assert announcements.contain("-> DISCONNECTED"), announcements  # from STANDBY, or when already streaming


def test_a_vehicle_that_dies_in_flight_is_in_nobody_s_hands(vehicle: Vehicle) -> None:
    announcements = Announcements()
    with mock_process(vehicle=VEHICLE_FILE) as mock:
        announcements.waiting["in_air"] = lambda: mock.stop(signal.SIGKILL)
        report = fly(vehicle, announcements, request_for(mock.url))
    assert not report.landed
    assert "the vehicle has been silent for" in report.outcome
    assert "the pilot has it" not in report.outcome
    assert all(re.match(r" *\d+\.\d\d s  \S", line) for line in announcements)


SECOND = """
import sys
import numpy as np
from dynamics.vehicle_file import read_vehicle
from runtime.link.connection import parse_endpoint
from runtime.daemon import Daemon
from runtime.flight_request import FlightRequest
from runtime.flight.motion import Transfer
vehicle = read_vehicle(sys.argv[1])
reference = Transfer(vehicle, np.array([0.5, 0.0, 1.0, 0.0]), np.array([-0.5, 0.3, 1.0, 0.3]), 2.0)
request = FlightRequest(endpoint=parse_endpoint(sys.argv[2]))
Daemon(request, vehicle, reference, lambda text: print(text, flush=True)).fly()
"""


def test_killed_in_the_air_and_restarted_it_holds_back(vehicle: Vehicle) -> None:
    with mock_process("--param", "COM_OF_LOSS_T=5", vehicle=VEHICLE_FILE) as mock:
        arguments = [sys.executable, "-c", SECOND, str(VEHICLE_FILE), mock.url]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as first:
            assert first.stdout is not None
            assert any("in_air" in line for line in first.stdout)
            first.send_signal(signal.SIGKILL)
        announcements = Announcements()
        report = fly(vehicle, announcements, request_for(mock.url))
    # OFFBOARD is still on: one setpoint would have been obeyed
    assert "already armed" in report.outcome
    assert "--resume" in report.outcome
    assert report.start_up < 0


def test_a_serial_device_unplugged_in_flight_ends_safely_and_is_named(vehicle: Vehicle, tmp_path: Path) -> None:
    with SerialCable(tmp_path) as cable, mock_process("--link", f"serial:{cable.far}:921600") as mock:
        announcements = Announcements()
        announcements.waiting["in_air"] = cable.unplug
        report = fly(vehicle, announcements, request_for(f"serial:{cable.near}:921600"))
        assert mock.process.poll() is None
    assert not report.landed
    assert announcements.contain(cable.near), announcements
    assert "nothing arrives" in report.outcome or "failsafe" in report.outcome


class Stuck:
    """A control thread that does not end, and has sent nothing."""

    stream = SetpointStream(None, lambda record, time: None)  # type: ignore[arg-type]

    def join(self, timeout: float) -> bool:
        return False


class ClosableLink:
    """A link that knows whether it was closed."""

    closed = False

    def close(self) -> None:
        self.closed = True


def test_a_control_thread_that_does_not_end_loses_its_link(vehicle: Vehicle) -> None:
    announcements, link = Announcements(), ClosableLink()
    daemon = Daemon(request_for("udpin:127.0.0.1:14540"), vehicle, reference_of(vehicle), announcements)
    daemon._stop(link, Stuck(), None)  # type: ignore[arg-type]
    assert link.closed
    assert announcements.contain("did not end within 1 s: its link was closed")


def test_a_silent_link_is_reported_with_what_to_check(vehicle: Vehicle) -> None:
    with pytest.raises(VehicleError, match="No MAVLink arrived"):
        fly(vehicle, Announcements(), request_for(f"udpin:127.0.0.1:{free_port()}", timeout=0.5))


def test_a_wrong_system_id_is_reported_with_the_ones_that_are_there(vehicle: Vehicle) -> None:
    with mock_process(vehicle=VEHICLE_FILE) as mock, pytest.raises(VehicleError, match=r"system id 42.*Heard"):
        fly(vehicle, Announcements(), request_for(mock.url, system=42, timeout=3.0))


def test_a_port_in_use_is_reported(vehicle: Vehicle) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(VehicleError, match=str(port)):
            fly(vehicle, Announcements(), request_for(f"udpin:127.0.0.1:{port}", timeout=0.5))


def test_a_second_interrupt_stops_streaming_at_once(vehicle: Vehicle) -> None:
    announcements = Announcements()
    with mock_process(vehicle=VEHICLE_FILE) as mock:
        daemon = Daemon(request_for(mock.url), vehicle, reference_of(vehicle), announcements)

        def twice() -> None:
            daemon.interrupt("SIGINT")
            daemon.interrupt("SIGINT")

        announcements.waiting["in_air"] = twice
        began = time.monotonic()
        report = daemon.fly()
        assert time.monotonic() - began < 30.0
    assert not report.landed
    assert "at once" in report.outcome
