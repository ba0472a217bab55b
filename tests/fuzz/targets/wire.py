"""Bytes from a link: framing, and the messages that it decodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from runtime.link.dialect import mavlink
from runtime.link.framing import FrameParser
from tests.fuzz.mutation import Parts
from tests.fuzz.target import Target
from tests.support.fake_vehicle import odometry

CHUNKS = (1, 7, 64, 1400)  # bytes of a datagram


def _stream(_: Path) -> list[Parts]:
    unsigned, signed = mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None, 1, 1)
    signed.signing.secret_key, signed.signing.sign_outgoing, signed.signing.timestamp = b"k" * 32, True, 1
    messages: list[Any] = [
        mavlink.MAVLink_heartbeat_message(2, 12, 129, 0x40000, 4, 3), odometry(), odometry(),
        mavlink.MAVLink_statustext_message(6, b"a text of the autopilot"),
        mavlink.MAVLink_param_value_message(b"MPC_THR_HOVER", 0.5, 9, 1, 0),
        mavlink.MAVLink_command_ack_message(400, 0),
    ]  # fmt: skip
    streams = [b"".join(bytes(message.pack(link)) for message in messages) for link in (unsigned, signed)]
    streams.append(b"".join(bytes(message.pack(unsigned, force_mavlink1=True)) for message in messages[:1]) * 5)
    return [{"stream": stream} for stream in (*streams, b"".join(streams))]


def _frames(path: Path) -> None:
    """In datagrams of every size all bytes are accounted for, and every frame decodes."""
    data = path.read_bytes()
    for size in CHUNKS if len(data) < 20_000 else CHUNKS[1:]:
        parser, taken = FrameParser(), 0
        for start in range(0, len(data), size):
            for frame in parser.feed(data[start : start + size]):
                taken += len(frame.data)
                if frame.is_known:
                    frame.message.to_dict()
                assert frame.payload is not None
        pending = len(data) - taken - parser.skipped_bytes
        assert 0 <= pending <= 300, f"{pending} bytes wait in datagrams of {size}"


TARGETS = (Target("framing", _stream, _frames, executions=400),)
