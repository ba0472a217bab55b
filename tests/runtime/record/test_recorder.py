"""The recorder preserves its records through kill -9, incomplete files and full disks, and never blocks the tick."""

from __future__ import annotations

import errno
import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from dynamics.errors import DataError, RequestError
from runtime.record import records
from runtime.record.recorder import Recorder
from runtime.record.recording import read_recording
from runtime.record.records import EstimateRecord, EventRecord, HorizonRecord, SetpointRecord, StateRecord
from tests.support.deadline import wait_until

pytestmark = pytest.mark.realtime

SIGNATURE = 8  # bytes that end an MCAP file; its last record, the footer, lies before them


def estimate(time_s: float, x: float) -> EstimateRecord:
    return EstimateRecord(
        time=time_s,
        arrival=time_s,
        position_world=np.array([x, 0.1, np.pi]),
        velocity_world=np.zeros(3),
        attitude=np.array([1.0, 0.0, 0.0, 0.0]),
        rate_body=np.zeros(3),
        reset_counter=3,
    )


def test_what_was_put_is_read_back_bit_for_bit(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, "flight", metadata={"seed": "7"}, attachments={"vehicle.toml": 'name = "x"'})
    values = np.random.default_rng(1).normal(size=50)
    for index, value in enumerate(values):
        recorder.put(estimate(index * 0.01, value), time.monotonic())
    recorder.put(StateRecord(1.0, "STANDBY", "STREAMING", "engagement requested"), time.monotonic())
    recorder.close()
    recording = read_recording(recorder.path)
    assert recording.complete
    assert recording.metadata["seed"] == "7"
    assert recording.attachments["vehicle.toml"] == 'name = "x"'
    np.testing.assert_array_equal(recording.table("/estimate")["position_world"][:, 0], values)
    assert recording.table("/state")["reason"][0] == "engagement requested"
    assert recording.records(EstimateRecord)[7].position_world[2] == np.pi


def test_not_a_number_survives_as_not_a_number(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, "flight", metadata={"seed": "7"})
    recorder.put(SetpointRecord(0.0, np.array([np.nan, 0.0, 1.0]), np.nan, 0.5, 1.0), time.monotonic())
    recorder.close()
    table = read_recording(recorder.path).table("/setpoint")
    assert np.isnan(table["rate_body"][0, 0])
    assert np.isnan(table["collective_thrust"][0])


def test_the_library_s_own_reader_lists_every_topic_with_a_schema_foxglove_can_follow(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, "flight", metadata={"seed": "7"})
    recorder.put(estimate(0.0, 1.0), time.monotonic())
    recorder.put(HorizonRecord(0.0, np.zeros(3), np.zeros(3), np.ones(3), np.ones(2)), time.monotonic())
    recorder.put(EventRecord(0.0, "estimate_stale", True, 4, "80 ms old"), time.monotonic())
    recorder.close()
    with recorder.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    assert topics == {"/estimate", "/pose", "/horizon", "/horizon_poses", "/event", "/log"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"jsonschema"}
    assert not any(b"$ref" in schema.data for schema in summary.schemas.values())


def test_every_record_has_a_topic_and_a_flat_schema() -> None:
    for kind in records.TOPICS:
        schema = records.schema_of(kind)
        assert schema["type"] == "object"
        assert set(schema["properties"]) == set(kind.__struct_fields__)


def test_frames_of_the_link_become_a_tlog(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, "flight", metadata={"seed": "7"})
    before = time.time()
    recorder.put_frame(b"\xfd\x00frame", time.monotonic())
    recorder.close()
    content = recorder.path.with_suffix(".tlog").read_bytes()
    assert content[8:] == b"\xfd\x00frame"
    assert abs(struct.unpack(">Q", content[:8])[0] / 1e6 - before) < 5.0


WRITER = """
import sys, time
from pathlib import Path
import numpy as np
from runtime.record.recorder import Recorder
from runtime.record.records import SetpointRecord
recorder = Recorder(Path(sys.argv[1]), "flight", metadata={"seed": "7"})
while True:
    now = time.monotonic()
    recorder.put(SetpointRecord(now, np.zeros(3), 1.0, 0.5, 1.0), now)
    recorder.put_frame(b"frame", now)
    print(repr(now), flush=True)
    time.sleep(0.01)
"""


def test_kill_9_loses_less_than_a_second(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = float(process.stdout.readline())
        last = first
        while last - first < 2.0:
            last = float(process.stdout.readline())
        os.kill(process.pid, signal.SIGKILL)
        last = float(([repr(last), *process.stdout.read().split()])[-1])
    recording = read_recording(tmp_path / "flight.mcap")
    assert not recording.complete
    times = recording.table("/setpoint")["time"]
    assert times[0] == pytest.approx(first, abs=0.5)
    assert last - times[-1] < 1.0
    assert (tmp_path / "flight.tlog").stat().st_size > 50 * len(b"12345678frame")


def test_a_file_torn_at_any_byte_reads_up_to_there(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, "flight", metadata={"seed": "7"})
    for index in range(200):
        recorder.put(estimate(index * 0.01, float(index)), time.monotonic())
    recorder.close()
    content = recorder.path.read_bytes()
    torn = tmp_path / "torn.mcap"
    counts = []
    lengths = [*range(len(content) // 4, len(content) - 100, 97), *range(len(content) - 100, len(content))]
    for length in lengths:
        torn.write_bytes(content[:length])
        try:
            recording = read_recording(torn)
        except DataError:
            continue  # torn before our metadata was complete
        assert recording.complete == (length >= len(content) - SIGNATURE)
        counts.append(len(recording.messages.get("/estimate", [])))
    assert counts == sorted(counts)
    assert counts[-1] == 200


class SmallDisk:
    """A raw file on a disk with room for so many bytes: writes what fits, then raises ENOSPC."""

    room = 6000

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)

    def write(self, data: bytes) -> int:
        if SmallDisk.room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = self._file.write(bytes(data)[: SmallDisk.room])
        SmallDisk.room -= written
        return written

    def truncate(self, size: int) -> None:
        self._file.truncate(size)

    def close(self) -> None:
        self._file.close()


def test_a_full_disk_is_reported_and_what_was_written_stays_readable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SmallDisk, "room", 100_000)
    recorder = Recorder(tmp_path, "flight", metadata={"seed": "7"}, opener=SmallDisk)  # type: ignore[arg-type]
    rng = np.random.default_rng(2)
    deadline = time.monotonic() + 20.0
    while not recorder.trouble:
        assert time.monotonic() < deadline
        for _ in range(20):
            recorder.put(estimate(time.monotonic(), rng.normal()), time.monotonic())
        time.sleep(0.02)
    assert "No space left" in recorder.trouble
    assert "flight.mcap" in recorder.trouble
    recorder.put(estimate(0.0, 0.0), time.monotonic())
    recorder.close()
    recording = read_recording(recorder.path)
    assert len(recording.messages["/estimate"]) >= 20


def test_an_overrun_ring_drops_and_counts_instead_of_blocking(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, "flight", metadata={"seed": "7"}, capacity=100)
    for _ in range(5000):
        recorder.put(estimate(0.0, 0.0), 0.0)
    assert recorder.dropped > 0
    assert "dropped" in recorder.trouble
    recorder.close()
    written = len(read_recording(recorder.path).messages["/estimate"])
    assert written + recorder.dropped == 5000


def test_a_broken_record_ends_the_recording_not_the_flight(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, "flight", metadata={"seed": "7"})
    recorder.put("no record", 0.0)  # type: ignore[arg-type]
    wait_until(lambda: recorder.trouble)
    recorder.put(estimate(0.0, 0.0), 0.0)
    recorder.close()
    assert "recorder stopped" in recorder.trouble


def test_an_existing_recording_is_never_overwritten(tmp_path: Path) -> None:
    Recorder(tmp_path, "flight", metadata={"seed": "7"}).close()
    with pytest.raises(FileExistsError):
        Recorder(tmp_path, "flight", metadata={"seed": "8"})


def test_a_file_that_is_no_recording_is_named(tmp_path: Path) -> None:
    other = tmp_path / "notes.mcap"
    other.write_text("hello")
    with pytest.raises(DataError, match=r"notes\.mcap is no recording"):
        read_recording(other)
    with pytest.raises(RequestError, match="cannot read"):
        read_recording(tmp_path / "absent.mcap")
