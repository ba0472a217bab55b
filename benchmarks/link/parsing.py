"""Cost of one message between the socket and the state estimate: our framing, pymavlink's parser, mavutil.

The recorded link to real PX4 (tests/data/px4_sih_offboard) is fed frame by frame, as datagrams arrive: every message,
and ODOMETRY alone, which is what a setpoint waits for. Then datagrams of 1,400 bytes that hold no frame, random bytes
and false markers in patterns that each claim another frame: megabytes a second that framing reads.

    python -m benchmarks link parsing [--repeats N]
"""

from __future__ import annotations

import os
import secrets
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.measurement import ROOT, Page, options_of
from dynamics.signing_key import SigningKey, signing_ticks
from runtime.link.dialect import mavlink
from runtime.link.framing import Frame, FrameParser
from runtime.link.peer import Peer
from runtime.link.signing import Signing
from runtime.record.tlog import read_tlog

RECORDING = ROOT / "tests" / "data" / "px4_sih_offboard" / "offboard_hover.tlog.gz"
DATAGRAM = 1400  # bytes
Feeder = Callable[[list[Frame]], None]


def frames_only(frames: list[Frame]) -> None:
    parser = FrameParser()
    for frame in frames:
        parser.feed(frame.data)


def frames_decoded(frames: list[Frame]) -> None:
    parser = FrameParser()
    for frame in frames:
        for each in parser.feed(frame.data):
            _ = each.message


def frames_handled(frames: list[Frame]) -> None:
    """All that the link's thread does, up to the judged estimate."""
    parser, peer, now = FrameParser(), Peer(), 0.0
    heartbeat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(mavlink.MAVLink(None, 1, 1))
    for data in (bytes(heartbeat), *(frame.data for frame in frames)):
        now += 0.01
        for each in parser.feed(data):
            peer.handle(each, now)


def pymavlink_parser(frames: list[Frame]) -> None:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    for frame in frames:
        parser.parse_buffer(frame.data)


def mavutil(frames: list[Frame]) -> None:
    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavutil as module  # only this row pays for it

    class Fed(module.mavfile):  # type: ignore[misc, name-defined]
        waiting = b""

        def recv(self, n: int | None = None) -> bytes:
            data, self.waiting = self.waiting, b""
            return data

    connection = Fed(None, "memory", input=False)
    for frame in frames:
        connection.waiting = frame.data
        connection.recv_msg()


def microseconds(feed: Feeder, frames: list[Frame], repeats: int) -> float:
    """Median over the repeats of the processor time for one message."""
    taken = []
    for _ in range(repeats):
        start = time.process_time()
        feed(frames)
        taken.append((time.process_time() - start) / len(frames))
    return float(np.median(taken)) * 1e6


def microseconds_verified(frames: list[Frame], repeats: int, folder: Path) -> float:
    """As `microseconds`, of the messages with a signature that is verified. folder: for the state of signing."""
    packer = mavlink.MAVLink(None)
    packer.signing.secret_key, packer.signing.sign_outgoing = secrets.token_bytes(32), True
    packer.signing.timestamp = signing_ticks(time.time())
    signed = []
    for frame in frames:
        packer.srcSystem, packer.srcComponent = frame.system, frame.component
        signed.append(bytes(frame.message.pack(packer)))
    taken = []
    for number in range(repeats):
        os.environ["XDG_STATE_HOME"] = str(folder / str(number))  # nothing was heard before
        parser, signing = FrameParser(), Signing(SigningKey(packer.signing.secret_key))
        start = time.process_time()
        for data in signed:
            for each in parser.feed(data):
                signing.judge(each, None)
        taken.append((time.process_time() - start) / len(signed))
        assert signing.counts == {"signed": len(signed)}
        signing.close()
    return float(np.median(taken)) * 1e6


def no_frames() -> dict[str, bytes]:
    """Datagrams by what they hold, none of it a frame."""
    return {
        "random bytes": np.random.default_rng(0).bytes(DATAGRAM),
        "FE at every byte": b"\xfe" * DATAGRAM,
        "FD at every byte": b"\xfd" * DATAGRAM,
        "FE 05: a short frame at every other byte": b"\xfe\x05" * (DATAGRAM // 2),
        "FE FF 21: the longest frame at every third byte": b"\xfe\xff\x21" * (DATAGRAM // 3),
        "FD FF 00 ..: version 2 at every seventh byte": b"\xfd\xff\x00\x00\x00\x00\x00" * (DATAGRAM // 7),
    }


def megabytes_per_second(datagram: bytes, repeats: int) -> float:
    """Median over the repeats of how fast one datagram, sent again and again, is read by framing."""
    speeds = []
    for _ in range(repeats):
        parser, start = FrameParser(), time.process_time()
        for _ in range(100):
            parser.feed(datagram)
        speeds.append(100 * len(datagram) / (time.process_time() - start))
    return float(np.median(speeds)) * 1e-6


def parsing(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args(words).repeats
    # frames are parsed again for each row, so that no decoded message is reused
    every = [frame for _, frame in read_tlog(RECORDING)]
    odometry = [frame for frame in every if frame.message_id == mavlink.MAVLINK_MSG_ID_ODOMETRY]
    cases: list[tuple[str, Feeder]] = [
        ("our frames, checked, not decoded", frames_only),
        ("our frames, decoded by pymavlink", frames_decoded),
        ("our link, to the judged estimate", frames_handled),
        ("pymavlink's parser", pymavlink_parser),
        ("mavutil", mavutil),
    ]
    rows = ["| way | every message, us | ODOMETRY, us |", "| --- | --- | --- |"]
    for name, feed in cases:
        rows.append(
            f"| {name} | {microseconds(feed, every, repeats):.1f} | {microseconds(feed, odometry, repeats):.1f} |"
        )
    with tempfile.TemporaryDirectory() as folder:
        verified = [
            microseconds_verified(frames, repeats, Path(folder, name))
            for name, frames in (("every", every), ("odometry", odometry))
        ]
    rows.insert(3, f"| our frames, signed, checked and verified | {verified[0]:.1f} | {verified[1]:.1f} |")
    text = f"{len(every)} messages, {len(odometry)} of them ODOMETRY; processor time, median of {repeats} repeats.\n\n"
    rows += ["", "| bytes | read by our framing, MB/s |", "| --- | --- |"]
    frames = b"".join(frame.data for frame in every[:1000])
    for name, datagram in {"frames of the recording": frames, **no_frames()}.items():
        rows.append(f"| {name} | {megabytes_per_second(datagram, repeats):.1f} |")
    return Page("link_parsing", "Cost of reading a message", text + "\n".join(rows))
