"""Whatever clients do, the mock goes on at its full rates, and its use of the processor stays sane."""

from __future__ import annotations

import os
import random
import socket
import struct
import time
import tty
from collections.abc import Callable

import psutil
import pytest

from simulation.mock_process import MockProcess, free_port, mock_process
from tests.conformance.raw_link import RawLink, attitude_target, mavlink

pytestmark = pytest.mark.realtime

GET_INTERVAL, ODOMETRY = 510, 331
Junk = Callable[[random.Random], bytes]


def frame(source: random.Random) -> bytes:
    """A valid setpoint of another system."""
    packer = mavlink.MAVLink(None, srcSystem=9, srcComponent=9)
    packer.seq = source.randrange(256)
    return bytes(attitude_target(0.5, target=(7, 7)).pack(packer))


def truncated(source: random.Random) -> bytes:
    complete = frame(source)
    return complete[: source.randrange(1, len(complete))]


def bad_crc(source: random.Random) -> bytes:
    complete = bytearray(frame(source))
    complete[-1] ^= 0xFF
    return bytes(complete)


def unknown_id(source: random.Random) -> bytes:
    length = source.randrange(256)
    header = bytes([0xFD, length, 0, 0, 1, 255, 190]) + struct.pack("<I", source.randrange(20_000, 1 << 24))[:3]
    return header + source.randbytes(length + 2)


def mavlink_1(source: random.Random) -> bytes:
    packer = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    return bytes(mavlink.MAVLink_ping_message(0, source.randrange(99), 1, 1).pack(packer, force_mavlink1=True))


def signed(source: random.Random) -> bytes:
    packer = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    packer.signing.secret_key, packer.signing.sign_outgoing = bytes(32), True
    packer.signing.timestamp = source.randrange(1 << 40)
    return bytes(mavlink.MAVLink_ping_message(0, 0, 1, 1).pack(packer))


def odd_numbers(source: random.Random) -> bytes:
    numbers = [source.choice((float("nan"), float("inf"), -1e38, 1e38, 0.0)) for _ in range(7)]
    packer = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    message = mavlink.MAVLink_command_long_message(1, 1, source.choice((176, 511, 512, 192, 22)), 0, *numbers)
    return bytes(message.pack(packer))


@pytest.fixture(scope="module", autouse=True)
def _odometry_at_100_hz(link: RawLink) -> None:
    link.set_rate(ODOMETRY, 100.0)


def test_ten_thousand_frames_a_second_do_not_slow_the_streams(mock: MockProcess, link: RawLink) -> None:
    source = random.Random(1)
    datagram = b"".join(frame(source) for _ in range(25))
    usage = psutil.Process(mock.process.pid)
    start, before = time.monotonic(), usage.cpu_times()
    sent = 0
    while time.monotonic() - start < 2.0:
        link.send_bytes(datagram)
        sent += 25
        time.sleep(max(0.0, start + sent / 10_000 - time.monotonic()))
    assert sent > 10_000
    after = usage.cpu_times()
    share = (after.user + after.system - before.user - before.system) / (time.monotonic() - start)
    assert share < 1.0
    assert_full_rates(link)


@pytest.mark.slow
@pytest.mark.parametrize("junk", [truncated, bad_crc, unknown_id, mavlink_1, signed, odd_numbers])
def test_bad_frames_do_no_harm(mock: MockProcess, link: RawLink, junk: Junk) -> None:
    source = random.Random(2)
    for _ in range(300):
        link.send_bytes(junk(source))
    assert mock.process.poll() is None
    assert_full_rates(link)


def test_random_bytes_and_oversize_datagrams_do_no_harm(link: RawLink) -> None:
    source = random.Random(3)
    for size in (0, 1, 7, 280, 1500, 9000, 65_507) * 10:
        link.send_bytes(source.randbytes(size))
    assert_full_rates(link)


def is_answered(link: RawLink) -> bool:
    try:
        return link.command(GET_INTERVAL, ODOMETRY, within=0.5)[1].result == 0
    except AssertionError:
        return False


def assert_full_rates(link: RawLink) -> None:
    """The streams run at their rates and commands are answered, if not the first: half a frame claims up to 280 bytes.

    That is six commands; the seventh completes it, and what it claimed is read anew.
    """
    assert any(is_answered(link) for _ in range(8))
    start = time.monotonic()
    time.sleep(0.6)
    stamps = [message.time_usec for _, message in link.since(start, "ODOMETRY")]
    assert len(stamps) > 20
    assert (stamps[-1] - stamps[0]) / (len(stamps) - 1) == pytest.approx(10_000, rel=0.08)


def test_many_clients_are_served_and_may_vanish(mock: MockProcess, link: RawLink) -> None:
    vehicle = link.vehicle
    clients = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(6)]
    packer = mavlink.MAVLink(None, srcSystem=2, srcComponent=191)
    for client in clients:
        client.settimeout(5.0)
        client.sendto(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(packer), vehicle)
    assert all(client.recv(4096)[0] == 0xFD for client in clients)
    for client in clients:
        client.close()
    assert_full_rates(link)


@pytest.mark.slow
def test_an_idle_mock_uses_less_than_a_processor(mock: MockProcess, link: RawLink) -> None:
    assert psutil.Process(mock.process.pid).cpu_percent(1.0) < 60.0


def heard_on(read: Callable[[], bytes], seconds: float) -> dict[str, int]:
    """Messages of each kind within some seconds."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    kinds: dict[str, int] = {}
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        for message in parser.parse_buffer(read()) or []:
            kinds[message.get_type()] = kinds.get(message.get_type(), 0) + 1
    return kinds


@pytest.mark.slow
def test_tcp_clients_come_and_go() -> None:
    port = free_port()
    with mock_process("--link", f"tcpin:127.0.0.1:{port}"):
        for _ in range(3):
            with socket.create_connection(("127.0.0.1", port), timeout=5.0) as client:
                client.sendall(b"\xfd\xff" + bytes(10))
                kinds = heard_on(lambda client=client: client.recv(4096), 0.5)
            assert kinds["ATTITUDE"] > 25


@pytest.mark.slow
def test_a_serial_line_carries_the_streams_and_survives_a_reader_that_sleeps() -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    with mock_process("--link", f"serial:{os.ttyname(theirs)}:921600"):
        time.sleep(0.5)
        kinds = heard_on(lambda: os.read(ours, 4096), 1.0)
        assert kinds["ATTITUDE"] > 50
    os.close(ours)
    os.close(theirs)
