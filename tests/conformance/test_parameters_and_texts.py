"""PX4's parameter protocol and its texts, observed from outside."""

from __future__ import annotations

import statistics
import struct
import time
from typing import Any

import pytest

from simulation.mock_process import MockProcess
from tests.conformance.raw_link import RawLink, mavlink

pytestmark = pytest.mark.realtime

INT32, REAL32 = 6, 9


def as_wire(value: int) -> float:
    """An integer byte-wise in a float."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def as_integer(wire: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", wire))[0])


def write(link: RawLink, name: str, wire: float, kind: int) -> float:
    """Send PARAM_SET; returns when."""
    return link.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), wire, kind))


def about(name: str) -> Any:
    return lambda value: value.param_id == name


def write_float(link: RawLink, name: str, value: float) -> None:
    sent = write(link, name, value, REAL32)
    assert link.wait_for("PARAM_VALUE", about(name), since=sent)[1].param_value == pytest.approx(value)


def write_integer(link: RawLink, name: str, value: int) -> None:
    sent = write(link, name, as_wire(value), INT32)
    assert as_integer(link.wait_for("PARAM_VALUE", about(name), since=sent)[1].param_value) == value


def read(link: RawLink, name: str, index: int = -1) -> Any:
    sent = link.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), index))
    accept = about(name) if index < 0 else lambda value: value.param_index == index
    return link.wait_for("PARAM_VALUE", accept, since=sent)[1]


def test_defaults_are_px4s(link: RawLink, is_sih: bool) -> None:
    action, timeout = read(link, "COM_OBL_RC_ACT"), read(link, "COM_OF_LOSS_T")
    assert (action.param_type, as_integer(action.param_value)) == (INT32, 0)
    assert (timeout.param_type, timeout.param_value) == (REAL32, 1.0)
    gains = {"MC_YAW_P": 2.8, "MC_ROLLRATE_MAX": 220.0, "MC_YAWRATE_MAX": 200.0}
    gains |= {"MC_ROLL_P": 4.0, "MC_PITCH_P": 4.0} if is_sih else {}
    assert {name: read(link, name).param_value for name in gains} == pytest.approx(gains)
    assert read(link, "MPC_THR_HOVER").param_value == pytest.approx(0.5)


def test_a_changed_value_is_announced_twice_an_unchanged_one_once(link: RawLink) -> None:
    gaps = []
    for action in (4, 5, 1, 2, 0):
        sent = write(link, "COM_OBL_RC_ACT", as_wire(action), INT32)
        time.sleep(0.15)
        (first, value), (second, _) = link.since(sent, "PARAM_VALUE")
        assert as_integer(value.param_value) == action
        gaps.append(second - first)
    assert 0.012 < statistics.median(gaps) < 0.035  # 14 to 23 ms and a busy machine
    sent = write(link, "COM_OBL_RC_ACT", as_wire(0), INT32)
    time.sleep(0.2)
    assert len(link.since(sent, "PARAM_VALUE")) == 1


def test_an_unknown_name_is_answered_by_param_error_alone(link: RawLink) -> None:
    for sent in (
        write(link, "NO_SUCH_NAME", 1.0, REAL32),
        link.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH_NAME", -1)),
    ):
        _, error = link.wait_for("PARAM_ERROR", since=sent)
        assert (error.param_id, error.error) == ("NO_SUCH_NAME", 1)
    time.sleep(0.1)
    assert not [value for _, value in link.since(sent, "PARAM_VALUE") if value.param_id == "NO_SUCH_NAME"]


def test_the_list_is_complete_and_consistent(link: RawLink) -> None:
    sent = link.send(mavlink.MAVLink_param_request_list_message(1, 1))
    _, one = link.wait_for("PARAM_VALUE", since=sent)
    deadline = time.monotonic() + 5.0
    listed: dict[int, Any] = {}
    while len(listed) < one.param_count and time.monotonic() < deadline:
        time.sleep(0.05)
        listed = {value.param_index: value for _, value in link.since(sent, "PARAM_VALUE")}
    assert sorted(listed) == list(range(one.param_count))
    assert len({value.param_id for value in listed.values()}) == one.param_count
    middle = listed[one.param_count // 2]
    assert read(link, "", middle.param_index).param_id == middle.param_id


def test_texts_need_a_ground_stations_heartbeat_on_that_link(mock: MockProcess, link: RawLink) -> None:
    with RawLink(mock.gcs_port, component=190, kind=6) as station:
        time.sleep(0.2)
        start = time.monotonic()
        assert station.arm() == 0
        assert station.disarm() == 0
        assert "Armed" in station.wait_for("STATUSTEXT", since=start)[1].text
        time.sleep(0.2)
    assert link.since(0.0, "STATUSTEXT") == []


def test_long_texts_come_in_chunks_of_50(mock: MockProcess) -> None:
    with RawLink(mock.gcs_port, component=190, kind=6) as station:
        time.sleep(0.2)
        assert station.set_mode(4 << 16 | 6 << 24) == 0
        start = time.monotonic()
        assert station.arm() == 1
        time.sleep(0.4)
        texts = [text for _, text in station.since(start, "STATUSTEXT")]
        assert station.set_mode(4 << 16 | 3 << 24) == 0
    first, second = texts[:2]
    assert len(first.text) == 50
    assert first.id == second.id != 0
    assert (first.chunk_seq, second.chunk_seq) == (0, 1)
