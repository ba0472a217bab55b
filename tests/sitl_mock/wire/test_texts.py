"""STATUSTEXT: only to a ground station, in chunks when long."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl_mock.wire.dialect import mavlink
from sitl_mock.wire.statustext import TextWriter
from tests.support.bench import ARM, Bench

GCS, ONBOARD_CONTROLLER = 6, 18


def arm_with_heartbeat(kind: int | None, *, wait: float = 0.1) -> Bench:
    bench = Bench()
    if kind is not None:
        bench.send(mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3))
    bench.run(wait)
    bench.request(ARM, 1)
    return bench


def test_texts_go_to_a_ground_station() -> None:
    assert [text.text for text in arm_with_heartbeat(GCS).of("STATUSTEXT")] == ["Armed by external command"]


@pytest.mark.parametrize("kind", [None, ONBOARD_CONTROLLER])
def test_no_texts_without_a_ground_station_on_the_link(kind: int | None) -> None:
    assert not arm_with_heartbeat(kind).of("STATUSTEXT")


def test_texts_stop_when_the_ground_station_has_gone() -> None:
    assert not arm_with_heartbeat(GCS, wait=3.0).of("STATUSTEXT")


def test_a_ground_station_on_another_link_changes_nothing_here() -> None:
    bench = Bench()
    other = bench.mock.add_link("other", "gcs")
    other.note_heartbeat(bench.time, GCS)
    bench.request(ARM, 1)
    assert not bench.of("STATUSTEXT")
    assert any(frame[7] == 253 for frame in other.take(bench.time))


def test_texts_longer_than_50_characters_are_chunked() -> None:
    text = "0123456789" * 12
    messages = TextWriter().messages(2, text)
    assert [message.chunk_seq for message in messages] == [0, 1, 2]
    assert len({message.id for message in messages}) == 1
    assert messages[0].id != 0


@given(st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=300))
def test_chunks_contain_the_whole_text_and_end(text: str) -> None:
    messages = TextWriter().messages(6, text)
    assert "".join(message.text for message in messages) == text
    if len(messages) > 1:
        assert len(messages[-1].text) < 50
        assert all(len(message.text) == 50 for message in messages[:-1])
