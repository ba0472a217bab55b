"""What one message costs between the socket and the state estimate: our framing, pymavlink's parser, mavutil.

The recorded link to real PX4 (tests/data/px4_sih_offboard) is fed frame by frame, as datagrams arrive: every message,
and ODOMETRY alone, which is what a setpoint waits for.

    python -m benchmarks.link_parsing [--repeats N]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.provenance import write_result
from runtime.link.dialect import mavlink
from runtime.link.framing import Frame, FrameParser
from runtime.link.peer import Peer
from runtime.record.tlog import read_tlog

RECORDING = Path(__file__).parents[1] / "tests" / "data" / "px4_sih_offboard" / "offboard_hover.tlog.gz"
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
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
    text = f"{len(every)} messages, {len(odometry)} of them ODOMETRY; processor time, median of {repeats} repeats.\n\n"
    write_result("link_parsing", "Cost of reading a message", text + "\n".join(rows))


if __name__ == "__main__":
    main()
