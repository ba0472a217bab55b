"""Sockets and serial lines: a refusal names a remedy, a loss is reported, and nothing blocks a sender."""

from __future__ import annotations

import contextlib
import os
import socket
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from dynamics.errors import RequestError, VehicleError
from runtime.link.connection import Endpoint
from runtime.link.transport import (
    Received,
    SerialTransport,
    TcpTransport,
    Transport,
    TransportLostError,
    UdpTransport,
    open_transport,
)
from tests.support.deadline import Deadline

pytestmark = pytest.mark.realtime

LOCAL = "127.0.0.1"


def receive(transport: Transport, timeout: float = 5.0) -> Received:
    deadline = Deadline(timeout)
    while not deadline.passed:
        if (received := transport.receive()) is not None:
            return received
    raise AssertionError("nothing came")


@pytest.fixture
def listener() -> Iterator[UdpTransport]:
    transport = UdpTransport(Endpoint("udpin", LOCAL, 0))
    yield transport
    transport.close()


@pytest.fixture
def sender() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as open_socket:
        open_socket.bind((LOCAL, 0))
        open_socket.settimeout(5.0)
        yield open_socket


@pytest.fixture
def line() -> Iterator[tuple[int, SerialTransport]]:
    master, slave = os.openpty()
    tty.setraw(master)
    transport = SerialTransport(Endpoint("serial", device=os.ttyname(slave), baud=57600))
    os.close(slave)
    yield master, transport
    transport.close()


def test_a_port_that_is_taken_is_named_with_its_usual_holders(listener: UdpTransport) -> None:
    with pytest.raises(VehicleError, match=f"port {listener.port} is taken.*mavsdk_server") as refusal:
        open_transport(Endpoint("udpin", LOCAL, listener.port))
    assert refusal.value.exit_code == 4


def test_a_missing_device_is_named_with_those_present() -> None:
    with pytest.raises(VehicleError, match="no such device"):
        open_transport(Endpoint("serial", device="/dev/ttyNOTHING0"))


def test_a_file_that_is_no_device_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("")
    with pytest.raises(VehicleError, match="Cannot open the link"):
        open_transport(Endpoint("serial", device=str(path)))


def test_a_missing_listener_is_reported(sender: socket.socket) -> None:
    with socket.create_server((LOCAL, 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(VehicleError, match="nobody listens there"):
        open_transport(Endpoint("tcpout", LOCAL, port))


def test_an_address_that_is_not_ours_cannot_be_listened_on() -> None:
    with pytest.raises(VehicleError, match="no address of this machine"):
        open_transport(Endpoint("udpin", "192.0.2.1", 0))


def test_an_unknown_host_is_refused() -> None:
    with pytest.raises(RequestError, match="cannot be resolved"):
        open_transport(Endpoint("udpout", "no-such-host.invalid", 14580))


def test_datagrams_carry_the_kernel_s_time_of_arrival(listener: UdpTransport, sender: socket.socket) -> None:
    time.sleep(0.1)  # the kernel begins to stamp a moment after the first socket of the machine has asked for it
    before = time.monotonic()
    sender.sendto(b"first", (LOCAL, listener.port))
    after = time.monotonic()
    while time.monotonic() < after + 0.05:  # the datagram waits in the kernel meanwhile
        pass
    received = receive(listener)
    assert received.data == b"first"
    assert received.source == sender.getsockname()
    assert before - 1e-3 <= received.time <= after + 1e-2


def test_udpin_stays_silent_until_it_has_a_peer(listener: UdpTransport, sender: socket.socket) -> None:
    assert not listener.send(b"nobody")
    sender.sendto(b"hello", (LOCAL, listener.port))
    listener.set_peer(receive(listener).source)
    assert listener.send(b"answer")
    assert sender.recv(100) == b"answer"


def test_a_vanished_udp_peer_is_survived(sender: socket.socket) -> None:
    transport = UdpTransport(Endpoint("udpout", LOCAL, sender.getsockname()[1]))
    sender.close()
    for _ in range(3):
        transport.send(b"anyone there?")
        assert transport.receive() is None
    transport.close()


def test_a_closed_tcp_connection_is_lost() -> None:
    with socket.create_server((LOCAL, 0)) as server:
        transport = TcpTransport(Endpoint("tcpout", LOCAL, server.getsockname()[1]))
        peer, _ = server.accept()
        peer.sendall(b"bytes")
        assert receive(transport).data == b"bytes"
        assert transport.send(b"more")
        assert peer.recv(10) == b"more"
        peer.close()
        with pytest.raises(TransportLostError, match="closed the TCP connection"):
            receive(transport)
        transport.close()


def test_tcpin_takes_the_next_client_after_one_left() -> None:
    transport = TcpTransport(Endpoint("tcpin", LOCAL, 0))
    assert not transport.send(b"nobody")
    for text in (b"one", b"two"):
        with socket.create_connection((LOCAL, transport.port)) as client:
            client.sendall(text)
            assert receive(transport).data == text
            assert transport.send(text)
            assert client.recv(10) == text
        deadline = Deadline(5.0)
        while transport.send(b"gone?") and not deadline.passed:
            transport.receive()
    transport.close()


def test_bytes_pass_a_serial_line_both_ways(line: tuple[int, SerialTransport]) -> None:
    master, transport = line
    os.write(master, b"from the vehicle")
    assert receive(transport).data == b"from the vehicle"
    assert transport.send(b"to the vehicle")
    assert os.read(master, 100) == b"to the vehicle"
    assert transport.receive() is None


def test_an_unplugged_serial_device_is_lost(line: tuple[int, SerialTransport]) -> None:
    master, transport = line
    os.close(master)
    with pytest.raises(TransportLostError, match="unplugged"):
        receive(transport)
    assert not transport.send(b"into the void")


def test_nothing_is_written_into_another_file_after_a_serial_device_was_closed(
    line: tuple[int, SerialTransport], tmp_path: Path
) -> None:
    _, transport = line
    transport.close()
    with contextlib.ExitStack() as stack:  # one of them gets the number that the device had
        files = [stack.enter_context((tmp_path / str(n)).open("wb")) for n in range(8)]
        assert not transport.send(b"a setpoint")
    assert files
    assert all(not (tmp_path / str(n)).read_bytes() for n in range(8))


def test_a_full_serial_line_never_blocks_the_sender(line: tuple[int, SerialTransport]) -> None:
    _, transport = line
    start = time.monotonic()
    taken = [transport.send(b"x" * 280) for _ in range(1000)]
    assert not taken[-1]
    assert time.monotonic() - start < 5.0
