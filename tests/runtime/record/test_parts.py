"""A recording of bounded size stays within it, is whole in every part, and reads as one flight."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pytest

from dynamics.errors import DataError
from runtime.record.files import open_unbuffered
from runtime.record.parts import MAX_PARTS, parts_of
from runtime.record.recorder import Recorder
from runtime.record.recording import FlightRecording, read_recording
from runtime.record.records import TOPICS, EstimateRecord, ParameterRecord, PhaseRecord, StateRecord
from tests.support.deadline import wait_until

LIMIT = 200_000  # bytes
PERIOD = 0.01  # s


def total(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())


def estimate(now: float, rng: np.random.Generator) -> EstimateRecord:
    return EstimateRecord(now, now, rng.normal(size=3), rng.normal(size=3), rng.normal(size=4), rng.normal(size=3), 0)


def record(folder: Path, seconds: float, *, max_bytes: int | None = LIMIT) -> tuple[FlightRecording, int]:
    """A recording in simulated time, and the greatest number of bytes that its files have taken."""
    rng, frame, taken = np.random.default_rng(3), bytes(60), 0
    recorder = Recorder(folder, "flight", metadata={"seed": "7"}, simulated_epoch=0.0, max_bytes=max_bytes)
    recorder.put(ParameterRecord(0.0, "THR_MDL_FAC", 0.3), 0.0)
    recorder.put(StateRecord(0.0, "STANDBY", "STREAMING", "requested"), 0.0)
    for tick in range(round(seconds / PERIOD)):
        now = tick * PERIOD
        recorder.put(estimate(now, rng), now)
        recorder.put_frame(frame, now)
        if tick in (100, 150):
            recorder.put(PhaseRecord(now, f"phase {tick}", ""), now)
        if tick % 20 == 0:
            taken = max(taken, total(folder))
    recorder.close()
    return read_recording(recorder.path), max(taken, total(folder))


def test_a_long_flight_stays_within_its_limit_and_keeps_its_end(tmp_path: Path) -> None:
    recording, taken = record(tmp_path, 60.0)
    assert taken <= LIMIT
    assert taken > LIMIT / 2
    parts = parts_of(recording.path)
    assert len(parts) == MAX_PARTS
    assert recording.first_part == min(parts) > 2
    assert all(path.with_suffix(".tlog").is_file() for path in parts.values())
    times = recording.table("/estimate")["time"]
    np.testing.assert_allclose(np.diff(times), PERIOD)
    assert times[-1] == pytest.approx(60.0 - PERIOD)


def test_every_part_is_a_whole_recording_and_says_what_still_holds(tmp_path: Path) -> None:
    recording, _ = record(tmp_path, 60.0)
    assert recording.complete
    assert [row["value"] for row in recording.messages["/parameter"]] == [0.3]
    assert [row["phase"] for row in recording.messages["/phase"]] == ["phase 150"]
    assert [row["after"] for row in recording.messages["/state"]] == ["STREAMING"]
    for number, path in parts_of(recording.path).items():
        alone = tmp_path / f"alone{number}"
        alone.mkdir()
        path.rename(alone / path.name)
        part = read_recording(alone / path.name)
        assert part.complete
        assert part.metadata == {"seed": "7", "part": str(number)}
        assert len(part.messages["/parameter"]) == len(part.messages["/phase"]) == 1


def test_with_room_for_all_of_it_a_flight_in_parts_reads_as_one_file_does(tmp_path: Path) -> None:
    in_parts, _ = record(tmp_path / "parts", 12.0, max_bytes=6 * LIMIT)
    in_one, _ = record(tmp_path / "one", 12.0, max_bytes=None)
    assert len(parts_of(in_parts.path)) > 1
    assert in_parts.first_part == in_one.first_part == 1
    assert parts_of(in_one.path) == {}
    for topic in TOPICS.values():  # views for Foxglove are thinned anew in each part
        assert in_parts.messages.get(topic) == in_one.messages.get(topic)


def test_a_part_that_was_just_begun_when_the_process_died_is_left_out(tmp_path: Path) -> None:
    recording, _ = record(tmp_path, 12.0, max_bytes=6 * LIMIT)
    newest = max(parts_of(recording.path))
    (tmp_path / f"flight.part{newest + 1:04}.mcap").write_bytes(b"\x89MCAP0\r\n")
    again = read_recording(recording.path)
    assert not again.complete
    assert again.messages == recording.messages
    recording.path.with_name("flight.part0001.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(DataError, match=r"part0001\.mcap is no recording"):
        read_recording(recording.path)


def test_a_part_that_cannot_be_opened_ends_the_recording_not_the_flight(tmp_path: Path) -> None:
    def open_once(path: Path) -> BinaryIO:
        if "part0002" in path.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return open_unbuffered(path)

    recorder = Recorder(tmp_path, "flight", metadata={"seed": "7"}, opener=open_once, max_bytes=50_000)
    rng = np.random.default_rng(3)

    def recorded_until_trouble() -> str:
        for _ in range(20):
            recorder.put(estimate(0.0, rng), 0.0)
        return recorder.trouble

    wait_until(recorded_until_trouble)
    assert "part0002" in recorder.trouble
    assert "No space left" in recorder.trouble
    recorder.put(estimate(0.0, rng), 0.0)
    recorder.close()
    assert read_recording(recorder.path).complete
