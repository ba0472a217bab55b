"""The control thread's latency under a flood: from the arrival of an estimate to the departure of its setpoint.

A vehicle of a few lines, a process of its own, sends ODOMETRY at 100 Hz over UDP; another process floods the link's
port with datagrams that hold false markers, random bytes, or true frames of another system. The flood comes from an
address of its own, which the kernel keeps away from the connected socket once the vehicle is known, or from the
vehicle's own address, as behind a router that forwards everything. The control thread waits for each estimate and sends
a setpoint at once, without a solver: what is measured is what the link adds. With --signed all true frames are signed.

    python -m benchmarks link flood [--seconds N] [--rates 0 5000 50000] [--signed]
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.measurement import Page, options_of
from dynamics.signing_key import SigningKey, signing_ticks
from runtime.link.connection import Endpoint
from runtime.link.dialect import Message, mavlink
from runtime.link.framing import FrameParser
from runtime.link.link import CANDIDATES_TIME, Link, LinkSettings
from runtime.link.transport import UdpTransport

LOCAL = "127.0.0.1"
RATE = 100.0  # Hz of ODOMETRY
DATAGRAM = 1400  # bytes
SECRET = bytes(range(1, 33))
SOURCES = {"a stranger's address": False, "the vehicle's own address": True}


@dataclass(frozen=True)
class Flood:
    """A flood of datagrams.

    kind: what they hold. rate: a second. from_vehicle: whether they come from the vehicle's address.
    """

    kind: str
    rate: int
    from_vehicle: bool


def odometry(number: int) -> Message:
    unknown = [0.0] * 21
    attitude, still = [1.0, 0.0, 0.0, 0.0], (0.0, 0.0, 0.0)
    return mavlink.MAVLink_odometry_message(number, 1, 1, *still, attitude, *still, *still, unknown, unknown, 0)


def datagrams() -> dict[str, bytes]:
    """Datagrams by what they hold."""
    other = mavlink.MAVLink(None, 9, 1)
    frame = bytes(odometry(0).pack(other))
    return {
        "FE 05: false markers": b"\xfe\x05" * (DATAGRAM // 2),
        "random bytes": np.random.default_rng(0).bytes(DATAGRAM),
        "true frames of another system": frame * (DATAGRAM // len(frame)),
    }


def fly_vehicle(target: tuple[str, int], own: socket.socket, signed: bool) -> None:
    """Heartbeats, ODOMETRY and answers to TIMESYNC, until this process is ended."""
    mav = mavlink.MAVLink(None, 1, 1)
    if signed:
        mav.signing.secret_key, mav.signing.sign_outgoing = SECRET, True
        mav.signing.timestamp = signing_ticks(time.time())
    threading.Thread(target=answer, args=(target, own, mav), daemon=True).start()
    due, number = time.monotonic(), 0
    while True:
        if number % 50 == 0:
            own.sendto(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(mav), target)
        own.sendto(odometry(time.monotonic_ns() // 1000).pack(mav), target)
        number += 1
        due += 1.0 / RATE
        time.sleep(max(0.0, due - time.monotonic()))


def answer(target: tuple[str, int], own: socket.socket, mav: Message) -> None:
    """Answers to TIMESYNC, from a second link id, so that two threads keep their timestamps in order."""
    second = mavlink.MAVLink(None, 1, 1)
    second.signing.secret_key, second.signing.sign_outgoing = mav.signing.secret_key, mav.signing.sign_outgoing
    second.signing.timestamp, second.signing.link_id = mav.signing.timestamp, 1
    parser = FrameParser()
    while True:
        for frame in parser.feed(own.recv(2048)):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_TIMESYNC and frame.message.tc1 == 0:
                own.sendto(
                    mavlink.MAVLink_timesync_message(time.monotonic_ns(), frame.message.ts1).pack(second), target
                )


def send_flood(target: tuple[str, int], own: socket.socket, flood: Flood, sent: Any) -> None:
    """Datagrams at a rate, or as many as this process manages. sent: counts them."""
    data, start, count = datagrams()[flood.kind], time.monotonic(), 0
    while True:
        for _ in range(int((time.monotonic() - start) * flood.rate) - count):
            with suppress(OSError):
                own.sendto(data, target)
            count += 1
            if time.monotonic() - start > 1.0:  # what it could not keep up with is not sent later
                start, count = time.monotonic(), 0
                break
            sent.value += 1
        time.sleep(0.0005)


@contextmanager
def running(function: Callable[..., None], *arguments: object) -> Iterator[None]:
    """A process beside the measurement; killed at its end."""
    process = multiprocessing.get_context("fork").Process(target=function, args=arguments, daemon=True)
    process.start()
    try:
        yield
    finally:
        os.kill(process.pid or 0, signal.SIGKILL)
        process.join()


def latencies(flood: Flood | None, seconds: float, *, signed: bool) -> tuple[list[float], float]:
    """Latency of each tick, s, and the datagrams a second that were sent."""
    settings = LinkSettings(signing_key=SigningKey(SECRET) if signed else None)
    own, stranger = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for each in (own, stranger):
        each.bind((LOCAL, 0))
    sent = multiprocessing.get_context("fork").Value("q", 0, lock=False)
    with Link(Endpoint("udpin", LOCAL, 0), settings) as link:
        assert isinstance(link.transport, UdpTransport)
        target = (LOCAL, link.transport.port)
        with running(fly_vehicle, target, own, signed):
            link.wait_for_vehicle()
            time.sleep(CANDIDATES_TIME + 0.5)  # then the kernel keeps strangers away
            if flood is None:
                return control(link, seconds), 0.0
            with running(send_flood, target, own if flood.from_vehicle else stranger, flood, sent):
                time.sleep(0.5)
                before, start = sent.value, time.monotonic()
                return control(link, seconds), (sent.value - before) / (time.monotonic() - start)


def control(link: Link, seconds: float) -> list[float]:
    """A setpoint for each estimate; how long each took."""
    taken, estimate, end = [], link.estimate, time.monotonic() + seconds
    while time.monotonic() < end:
        newest = link.wait_for_estimate(estimate, time.monotonic() + 0.1)
        if newest is None:
            continue
        link.send_rate_setpoint((0.0, 0.0, 0.0), 0.5)
        taken.append(time.monotonic() - newest.received)
        estimate = newest
    return taken


def row(name: str, taken: list[float], sent: float, seconds: float) -> str:
    if not taken:
        return f"| {name} | {sent:.0f} | 0 | no estimate arrived | | |"
    median, p99, maximum = np.percentile(np.array(taken) * 1e3, [50, 99, 100])
    return f"| {name} | {sent:.0f} | {len(taken) / seconds:.0f} | {median:.2f} | {p99:.2f} | {maximum:.2f} |"


def flood(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rates", type=int, nargs="+", default=[5_000, 50_000], help="Datagrams a second.")
    parser.add_argument("--signed", action="store_true")
    arguments = parser.parse_args(words)
    os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="alula-flood-")
    rows = [
        "| flood | datagrams a second | setpoints a second | median, ms | p99, ms | maximum, ms |",
        "| --- | --- | --- | --- | --- | --- |",
        row("none", *latencies(None, arguments.seconds, signed=arguments.signed), arguments.seconds),
    ]
    for source, from_vehicle in SOURCES.items():
        for kind in datagrams():
            for rate in arguments.rates:
                flood = Flood(kind, rate, from_vehicle)
                taken, sent = latencies(flood, arguments.seconds, signed=arguments.signed)
                rows.append(row(f"{kind}, from {source}", taken, sent, arguments.seconds))
    signing = "All true frames of the vehicle and the link are signed and verified. " if arguments.signed else ""
    text = (
        f"From an estimate's arrival at the socket to its setpoint's departure, {arguments.seconds:g} s a row, "
        f"ODOMETRY at {RATE:g} Hz, datagrams of up to {DATAGRAM} bytes, vehicle and flood in processes of their own "
        f"on the same processors. {signing}\n\n" + "\n".join(rows)
    )
    return Page("flood_signed" if arguments.signed else "flood", "The control thread's latency under a flood", text)
