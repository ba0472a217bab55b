"""The mock as a process: ports, several clients, TCP, serial, floods, clean ends, lockstep."""

from __future__ import annotations

import os
import pty
import signal
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from alula.cli.app import main
from simulation.mock_process import MockProcess, free_port, mock_process
from sitl_mock.wire.dialect import mavlink
from sitl_mock.wire.link_spec import default_links, parse_link
from tests.support.deadline import Deadline
from vehicles import FOLDER

pytestmark = pytest.mark.realtime(repeats_only=True)

VEHICLE = str(FOLDER / "px4_sih.toml")


class Client:
    """A MAVLink client on anything that reads and writes bytes without blocking."""

    def __init__(self, read: Callable[[], bytes], write: Callable[[bytes], object]):
        self._read, self._write = read, write
        self._packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True

    def send(self, message: Any) -> None:
        self._write(message.pack(self._packer))

    def messages(self, seconds: float) -> Iterator[Any]:
        """Everything that arrives within some seconds."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            try:
                data = self._read()
            except (BlockingIOError, TimeoutError):
                continue
            yield from self._parser.parse_buffer(data) or []

    def wait_for(self, kind: str, seconds: float = 10.0) -> Any:
        """The next message of a kind."""
        deadline = Deadline(seconds)
        while not deadline.passed:
            for message in self.messages(0.2):
                if message.get_type() == kind:
                    return message
        raise AssertionError(f"no {kind} within {seconds} s")


def udp_client(local: int = 0, remote: int | None = None) -> tuple[Client, socket.socket]:
    handle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    handle.bind(("127.0.0.1", local))
    handle.settimeout(0.05)
    peer: list[Any] = [("127.0.0.1", remote)] if remote else []

    def read() -> bytes:
        data, address = handle.recvfrom(4096)
        peer[:] = [address]
        return data

    return Client(read, lambda frame: handle.sendto(frame, peer[0])), handle


def interval(identifier: int, microseconds: float, *, system: int = 1) -> Any:
    return mavlink.MAVLink_command_long_message(system, 1, 511, 0, identifier, microseconds, 0, 0, 0, 0, 0)


@pytest.fixture(scope="module")
def mock() -> Iterator[MockProcess]:
    with mock_process() as process:
        yield process


def test_the_mock_streams_before_anyone_spoke_and_answers(mock: MockProcess) -> None:
    client, handle = udp_client(mock.port)
    with handle:
        assert client.wait_for("ODOMETRY").frame_id == 1
        client.send(interval(331, 10_000))
        ack = client.wait_for("COMMAND_ACK")
        assert (ack.command, ack.result, ack.target_component) == (511, 0, 191)


def test_the_ground_station_has_a_link_of_its_own(mock: MockProcess) -> None:
    client, handle = udp_client(mock.gcs_port)
    with handle:
        kinds = {message.get_type() for message in client.messages(1.2)}
    assert "HEARTBEAT" in kinds
    assert "ODOMETRY" not in kinds


@pytest.mark.realtime
def test_rates_hold_in_real_time(mock: MockProcess) -> None:
    client, handle = udp_client(mock.port)
    with handle:
        client.wait_for("HEARTBEAT")
        client.send(interval(331, 10_000))
        client.wait_for("COMMAND_ACK")
        stamps = [message.time_usec for message in client.messages(2.0) if message.get_type() == "ODOMETRY"]
    assert len(stamps) > 50  # a machine that is busy elsewhere may lose some
    assert (stamps[-1] - stamps[0]) / (len(stamps) - 1) == pytest.approx(10_000, rel=0.05)


@pytest.mark.realtime
def test_a_flood_does_not_stop_the_streams(mock: MockProcess) -> None:
    client, handle = udp_client(mock.port)
    with handle:
        heartbeat = client.wait_for("HEARTBEAT")
        assert heartbeat.system_status == 3
        noise, sender = os.urandom(200), mavlink.MAVLink(None, srcSystem=9, srcComponent=9)
        frame = mavlink.MAVLink_debug_message(0, 0, 0.0).pack(sender)
        for _ in range(2000):
            for junk in (frame, noise, frame[:7], bytes([0xFD]) + noise, frame * 50):
                client._write(junk)
        for _ in range(3):
            client.wait_for("HEARTBEAT")
        assert mock.process.poll() is None
        assert len([m for m in client.messages(1.0) if m.get_type() == "ATTITUDE"]) > 30


def test_a_port_in_use_is_named_with_what_to_do() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("0.0.0.0", 0))
        port = taken.getsockname()[1]
        command = [
            sys.executable,
            "-m",
            "alula.cli.app",
            "mock",
            "--vehicle",
            VEHICLE,
            "--link",
            f"udpin:0.0.0.0:{port}",
        ]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=250, check=False)
    assert ended.returncode == 2
    assert f"port {port} is in use" in ended.stderr
    assert "--instance" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--link", "carrier-pigeon:1"], "udpout"),
        (["--link", "udpout:127.0.0.1:99999"], "99999"),
        (["--link", "serial:/dev/does_not_exist:57600"], "/dev/does_not_exist"),
        (["--link", "udpout:no.such.host.invalid:15000"], "no.such.host.invalid"),
        (["--param", "COM_OF_LOS_T=1"], "COM_OF_LOSS_T"),
        (["--effect", "rotor_darg"], "rotor_drag"),
        (["--offboard-rule", "none"], "'measured'"),
        (["--speed", "0"], "speed"),
        (["--scenario", "/does/not/exist.toml"], "scenario"),
    ],
)
def test_a_wrong_request_ends_with_2_and_no_traceback(
    arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    usual = ["--link", f"udpout:127.0.0.1:{free_port()}"] if "--link" not in arguments else []
    monkeypatch.setattr(sys, "argv", ["alula", "mock", "--vehicle", VEHICLE, *usual, *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_cleanly(number: signal.Signals) -> None:
    with mock_process() as process:
        assert process.stop(number) == 0
        assert "Traceback" not in process.output()


@dataclass
class Everywhere:
    """A mock on a listening and a calling TCP link, a serial line and a listening UDP port, as instance 3."""

    tcp_port: int
    udp_port: int
    server: socket.socket
    line: int


@pytest.fixture(scope="module")
def everywhere() -> Iterator[Everywhere]:
    master, slave = pty.openpty()
    tty.setraw(master)
    os.set_blocking(master, False)
    tcp_port, udp_port = free_port(), free_port()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(10)
        links = [
            f"tcpin:127.0.0.1:{tcp_port}",
            f"tcp:127.0.0.1:{server.getsockname()[1]}",
            f"serial:{os.ttyname(slave)}:921600",
            f"udpin:127.0.0.1:{udp_port}",
        ]
        with mock_process("--instance", "3", *(part for link in links for part in ("--link", link))):
            yield Everywhere(tcp_port, udp_port, server, master)
    os.close(master)
    os.close(slave)


def test_tcp_clients_come_and_go(everywhere: Everywhere) -> None:
    for _ in range(2):
        handles = [socket.create_connection(("127.0.0.1", everywhere.tcp_port), timeout=5) for _ in range(2)]
        for handle in handles:
            handle.settimeout(0.05)
            client = Client(lambda handle=handle: handle.recv(4096), handle.sendall)
            assert client.wait_for("ODOMETRY").frame_id == 1
        for handle in handles:
            handle.close()


def test_the_mock_connects_to_a_listening_tcp_client_and_again(everywhere: Everywhere) -> None:
    for _ in range(2):
        handle, _ = everywhere.server.accept()
        with handle:
            handle.settimeout(0.05)
            assert Client(lambda handle=handle: handle.recv(4096), handle.sendall).wait_for("ATTITUDE")


def test_a_serial_line_carries_the_link(everywhere: Everywhere) -> None:
    client = Client(lambda: os.read(everywhere.line, 4096), lambda frame: os.write(everywhere.line, frame))
    assert client.wait_for("ODOMETRY").frame_id == 1
    client.send(interval(331, 10_000, system=4))
    assert client.wait_for("COMMAND_ACK").result == 0


def test_several_clients_share_a_udp_link(everywhere: Everywhere) -> None:
    clients = [udp_client(remote=everywhere.udp_port) for _ in range(2)]
    for client, _ in clients:
        client.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    for client, handle in clients:
        with handle:
            assert client.wait_for("HEARTBEAT").get_srcSystem() == 4  # the instance's own system id


@pytest.mark.realtime
def test_lockstep_runs_as_fast_as_the_setpoints_come() -> None:
    with mock_process("--lockstep") as process:
        client, handle = udp_client(process.port)
        with handle:
            client.wait_for("HEARTBEAT")
            client.send(interval(331, 10_000))
            client.wait_for("COMMAND_ACK")
            begun, first = time.monotonic(), client.wait_for("ODOMETRY").time_usec
            last = first
            for _ in range(200):
                client.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1, 0, 0, 0], 0, 0, 0, 0.0))
                last = client.wait_for("ODOMETRY").time_usec
        simulated, elapsed = (last - first) * 1e-6, time.monotonic() - begun
    assert simulated == pytest.approx(2.0, abs=0.5)
    assert elapsed < 10 * simulated  # far less on an idle machine; benchmarks simulator load measures it


def test_the_default_links_are_px4s() -> None:
    onboard, gcs = default_links(2)
    assert (onboard.local_port, onboard.number, onboard.role) == (14582, 14542, "onboard")
    assert (gcs.local_port, gcs.number, gcs.role) == (18572, 14552, "gcs")
    assert parse_link("udpout:127.0.0.1:14540").local_port == 14580
    assert parse_link("udp://127.0.0.1:15000").local_port == 0
    assert parse_link("udpout:127.0.0.1:15000:15001").local_port == 15001
    assert parse_link("serial:/dev/ttyACM0:57600").number == 57600
