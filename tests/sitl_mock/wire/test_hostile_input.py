"""Malformed, random and excessive input never stops the mock."""

from __future__ import annotations

import math
import struct

from hypothesis import example, given, settings
from hypothesis import strategies as st

from sitl_mock.autopilot.reception import HANDLERS
from sitl_mock.wire.dialect import mavlink
from tests.support.bench import ARM, Bench

PACKER = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
GOOD = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0).pack(PACKER)
GET_INTERVAL = mavlink.MAVLink_command_long_message(1, 1, 510, 0, 331, 0, 0, 0, 0, 0, 0)
CLASSES = {kind.msgname: kind for kind in mavlink.mavlink_map.values()}
HANDLED = [CLASSES[name] for name in sorted(HANDLERS)]


def still_alive(bench: Bench) -> bool:
    """Whether the mock still streams and still understands a command."""
    bench.link.parse("test", b"\0" * 600)  # ends whatever frame the noise may have begun
    before = len(bench.of("ATTITUDE"))
    bench.run(0.1)
    bench.mock.receive(bench.link, "fresh", GOOD)
    return len(bench.of("ATTITUDE")) > before and bench.mock.commander.armed


@settings(max_examples=60)
@given(st.lists(st.binary(max_size=400), max_size=10))
def test_random_bytes_are_survived(chunks: list[bytes]) -> None:
    bench = Bench()
    for chunk in chunks:
        bench.mock.receive(bench.link, "noise", chunk)
    assert still_alive(bench)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.sampled_from([0xFD, 0xFE]), st.binary(max_size=300)), max_size=10))
def test_bytes_that_begin_like_a_frame_are_survived(chunks: list[tuple[int, bytes]]) -> None:
    bench = Bench()
    for magic, rest in chunks:
        bench.mock.receive(bench.link, "noise", bytes([magic]) + rest)
    assert still_alive(bench)


def test_truncated_frames_and_bad_checksums_are_skipped() -> None:
    bench = Bench()
    for length in range(1, len(GOOD)):
        bench.mock.receive(bench.link, length % 3, GOOD[:length])
    for place in range(len(GOOD)):
        broken = bytearray(GOOD)
        broken[place] ^= 0x55
        bench.mock.receive(bench.link, "broken", bytes(broken))
    assert not bench.mock.commander.armed
    assert still_alive(bench)


def test_a_good_frame_after_noise_from_the_same_peer_is_understood() -> None:
    bench = Bench()
    bench.mock.receive(bench.link, "noisy", b"\x00\x13 not mavlink \xff")
    bench.mock.receive(bench.link, "noisy", GOOD)
    assert bench.mock.commander.armed


def test_no_frame_is_lost_behind_the_claim_of_half_a_frame() -> None:
    """510 is 0x01FE, which holds the marker of MAVLink 1: each such command looks like the start of another frame."""
    bench = Bench()
    bench.mock.receive(bench.link, "noisy", bytes([0xFD, 255, 0, 0, 0, 1, 191]))
    for _ in range(10):
        bench.mock.receive(bench.link, "noisy", bytes(GET_INTERVAL.pack(PACKER)))
    bench.run(0.05)
    assert len(bench.of("COMMAND_ACK")) == 10


def test_a_datagram_of_nothing_but_markers_is_survived() -> None:
    bench = Bench()
    bench.mock.receive(bench.link, "noisy", b"\xfd\x00" * 30_000)
    assert still_alive(bench)


def test_mavlink_1_and_signed_frames_are_understood_as_by_px4_without_signing() -> None:
    command = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0)
    bench = Bench()
    bench.mock.receive(bench.link, "old", command.pack(PACKER, force_mavlink1=True))
    assert bench.mock.commander.armed
    signing = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    signing.signing.secret_key = b"x" * 32
    signing.signing.sign_outgoing = True
    bench = Bench()
    bench.mock.receive(bench.link, "signed", command.pack(signing))
    assert bench.mock.commander.armed


def test_unknown_message_ids_are_ignored() -> None:
    bench = Bench()
    for identifier in (3, 500, 12345, 0xFFFFFF):
        frame = struct.pack("<BBBBBBB", 0xFD, 4, 0, 0, 0, 1, 191) + identifier.to_bytes(3, "little") + b"abcd\x00\x00"
        bench.mock.receive(bench.link, "stranger", frame)
    assert still_alive(bench)


def addressed(kind: type, payload: bytes) -> bytes:
    """The payload with its target fields, if it has any, naming the mock."""
    raw = bytearray(payload[: kind.unpacker.size])
    layout = kind.native_format.decode()[1:]
    place = 0
    for field, letter, length in zip(kind.ordered_fieldnames, layout, kind.array_lengths, strict=True):
        if field in ("target_system", "target_component"):
            raw[place] = 1
        place += struct.calcsize(f"<{letter}") * max(length, 1)
    return bytes(raw)


@settings(max_examples=150)
@given(st.sampled_from(HANDLED), st.binary(min_size=260, max_size=260))
def test_any_bytes_in_a_valid_frame_are_survived(kind: type, payload: bytes) -> None:
    bench = Bench()
    for content in (payload[: kind.unpacker.size], addressed(kind, payload)):
        raw = mavlink.MAVLink_message(kind.id, kind.msgname)
        bench.mock.receive(bench.link, "fuzz", bytes(raw._pack(PACKER, kind.crc_extra, content)))
    bench.run(0.04)
    assert len(bench.of("ATTITUDE")) >= 3


@settings(max_examples=100)
@given(
    st.sampled_from([176, 400, 511, 510, 512, 22, 192, 179, 185, 31010, 401]),
    st.lists(st.floats(width=32), min_size=7, max_size=7),
)
def test_any_numbers_in_a_command_are_survived(number: int, parameters: list[float]) -> None:
    bench = Bench()
    bench.command(number, *parameters)
    bench.run(0.05)
    assert len(bench.of("COMMAND_ACK")) == 1


@settings(max_examples=25)
@given(st.integers(0, 255), st.lists(st.floats(width=32), min_size=8, max_size=8))
@example(236, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf, 0.0])
def test_any_numbers_in_a_setpoint_are_survived_in_flight(mask: int, numbers: list[float]) -> None:
    bench = Bench()
    bench.fly(height=0.1)
    bench.setpoint(numbers[0], mask, q=numbers[1:5], rates=tuple(numbers[5:8]))
    bench.run(0.05)
    assert len(bench.of("ATTITUDE")) >= 3


def test_a_flood_of_ten_thousand_frames_is_taken_and_the_queue_stays_bounded() -> None:
    bench = Bench()
    request = mavlink.MAVLink_param_request_list_message(1, 1).pack(PACKER)
    for _ in range(100):
        bench.mock.receive(bench.link, "flood", request * 100)
    assert bench.link.waiting <= 20_000
    assert still_alive(bench)


def test_peers_without_number_are_forgotten() -> None:
    bench = Bench()
    for number in range(1000):
        bench.mock.receive(bench.link, number, GOOD[:5])
    assert still_alive(bench)
