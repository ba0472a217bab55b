"""Frames are frames whatever surrounds them, and decode as pymavlink packed them."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.link import framing
from runtime.link.dialect import MESSAGE_IDS, mavlink
from runtime.link.framing import FrameParser
from tests.support.fake_vehicle import odometry


def pack(message: Any, sequence: int = 0, version: int = 2) -> bytes:
    packer = mavlink.MAVLink(None, 1, 1)
    packer.seq = sequence
    return bytes(message.pack(packer, force_mavlink1=version == 1))


def heartbeat(number: int) -> Any:
    return mavlink.MAVLink_heartbeat_message(2, 12, 0, number, 3, 3)


FRAMES = [pack(heartbeat(0x10000 + n), n) for n in range(5)]


def modes(parser: FrameParser, data: bytes) -> list[int]:
    return [frame.message.custom_mode for frame in parser.feed(data) if frame.message_id == 0]


@given(st.integers(1, 30))
def test_frames_cut_anywhere_are_put_together(size: int) -> None:
    parser, stream, numbers = FrameParser(), b"".join(FRAMES), []
    for at in range(0, len(stream), size):
        numbers += modes(parser, stream[at : at + size])
    assert numbers == [0x10000 + n for n in range(5)]
    assert parser.skipped_bytes == 0


@given(st.lists(st.binary(max_size=40), min_size=6, max_size=6))
def test_garbage_between_frames_hides_none_of_a_datagram_each(garbage: list[bytes]) -> None:
    parser, numbers = FrameParser(), []
    for noise, frame in zip(garbage, FRAMES, strict=False):
        parser.feed(noise)
        numbers += modes(parser, frame)
    assert [mode for mode in numbers if mode >> 16 == 1] == [0x10000 + n for n in range(5)]


@given(st.binary(max_size=2000))
def test_no_bytes_break_the_parser(data: bytes) -> None:
    parser = FrameParser()
    for frame in parser.feed(data):
        assert len(frame.data) >= 8
    assert modes(parser, FRAMES[0]) == [0x10000]


@given(st.integers(0, len(FRAMES[0]) - 1), st.integers(1, 255))
def test_a_damaged_frame_is_rejected(at: int, change: int) -> None:
    damaged = bytearray(FRAMES[0])
    damaged[at] ^= change
    parser = FrameParser()
    frames = parser.feed(bytes(damaged) + FRAMES[1]) + parser.feed(FRAMES[2])
    # a changed id may be one without a definition, whose checksum nobody can verify
    assert [frame.message.custom_mode for frame in frames if frame.is_known] == [0x10001, 0x10002]


def test_version_1_and_signed_frames_are_read() -> None:
    signing = mavlink.MAVLink(None, 1, 1)
    signing.signing.secret_key, signing.signing.sign_outgoing = bytes(32), True
    signed = bytes(heartbeat(7).pack(signing))
    assert modes(FrameParser(), pack(heartbeat(6), version=1) + signed + pack(heartbeat(8))) == [6, 7, 8]


def test_an_unknown_message_is_passed_over() -> None:
    unknown = bytearray(FRAMES[0])
    unknown[7:10] = (60000).to_bytes(3, "little")
    parser = FrameParser()
    assert modes(parser, bytes(unknown) + FRAMES[1]) == [0x10001]
    assert (parser.frames, parser.unknown, parser.skipped_bytes) == (2, 1, 0)


@pytest.mark.parametrize(
    ("name", "checksum"),
    [
        ("LINK_NODE_STATUS", 117),
        ("ESC_INFO", 251),
        ("ESC_STATUS", 10),
        ("TIME_ESTIMATE_TO_TARGET", 232),
        ("EVENT", 160),
        ("CURRENT_EVENT_SEQUENCE", 106),
        ("CURRENT_MODE", 193),
    ],
)
def test_messages_added_to_pymavlink_have_the_checksum_of_common_xml(name: str, checksum: int) -> None:
    assert mavlink.mavlink_map[MESSAGE_IDS[name]].crc_extra == checksum


def test_an_added_message_survives_packing_and_reading() -> None:
    kind = mavlink.mavlink_map[MESSAGE_IDS["ESC_STATUS"]]
    sent = kind(4, 123456789, [1000, -2000, 3000, 0], [16.5, 16.0, 15.5, 0.0], [1.0, 2.0, 3.0, 4.0])
    (frame,) = FrameParser().feed(pack(sent))
    message = frame.message
    assert (message.index, message.time_usec, message.rpm) == (4, 123456789, [1000, -2000, 3000, 0])
    assert (message.voltage, message.current) == ([16.5, 16.0, 15.5, 0.0], [1.0, 2.0, 3.0, 4.0])


def test_messages_stay_whole_when_read_one_byte_at_a_time() -> None:
    parser, data = FrameParser(), pack(odometry(time_usec=5, x=1.5, reset_counter=3))
    frames = [frame for byte in data for frame in parser.feed(bytes([byte]))]
    assert [frame.message.x for frame in frames] == [1.5]


@pytest.mark.parametrize("pattern", [b"\xfe", b"\xfd", b"\xfe\x05", b"\xfe\xff\x21", b"\xfd\xff\x00\x00\x00\x00\x00"])
def test_a_byte_costs_no_more_behind_many_false_markers_than_behind_few(
    pattern: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked: list[int] = []
    checksum = framing.mcrf4xx
    monkeypatch.setattr(framing, "mcrf4xx", lambda data: checked.append(len(data)) or checksum(data))
    searched = FrameParser()
    costs = []
    for size in (2_000, 20_000):
        checked.clear()
        searched.feed((pattern * size)[:size])
        assert len(checked) <= size  # no place is checked twice
        costs.append(len(checked) / size)
    assert costs[1] <= 1.2 * costs[0] + 0.01
    assert modes(searched, FRAMES[0]) == [0x10000]
