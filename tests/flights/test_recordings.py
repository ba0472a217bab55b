"""Recordings of `alula fly` read as flights, whole or torn off."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from numpy.testing import assert_allclose, assert_array_equal

from dynamics.errors import DataError
from flights import read_chunks, read_log
from runtime.record.recorder import Recorder
from runtime.record.records import BatteryRecord, EstimateRecord, ImuRecord, MotorRecord, RotorRecord, SetpointRecord
from tests.support.flight_files import Truth, manoeuvre


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre()


@pytest.fixture(scope="module")
def recording(truth: Truth, tmp_path_factory: pytest.TempPathFactory) -> Path:
    recorder = Recorder(tmp_path_factory.mktemp("recording"), "flight", metadata={"vehicle": "arpl_250g"})
    now = time.monotonic()
    for i, t in enumerate(truth.time.tolist()):
        at, state = 100.0 + t, (truth.position[i], truth.velocity[i], truth.attitude[i], truth.rate[i])
        recorder.put(EstimateRecord(at, at + 0.003, *state, reset_counter=9), now + t)
        recorder.put(ImuRecord(at + 1e-3, truth.specific_force[i], truth.rate[i]), now + t)
        recorder.put(RotorRecord(at, 0, truth.rotor_speed[i, [3, 1, 0, 2]]), now + t)
        signal = truth.rotor_speed[i, [3, 1, 0, 2]] / 2000.0
        recorder.put(MotorRecord(at, np.array([*(1000 + 1000 * signal), *[900.0] * 4])), now + t)
        recorder.put(SetpointRecord(at, truth.rate[i], 2.5, float("nan"), 1.0), now + t)
        if i % 100 == 0:
            recorder.put(BatteryRecord(at, 7.4, 3.0, 0.9), now + t)
    recorder.close()
    assert not recorder.trouble
    return recorder.path


def test_a_recording_is_a_flight(recording: Path, truth: Truth) -> None:
    log = read_log(recording)
    assert log.provenance.format == "Alula's recording (MCAP)"
    assert not log.provenance.repairs
    assert log.metadata["vehicle"] == "arpl_250g"
    assert log.start == pytest.approx(100.0)
    for name in ("position", "velocity", "attitude", "rate", "specific_force", "rotor_speed"):
        stream = log.stream(name)
        assert stream is not None, name
        assert_allclose(stream.values, getattr(truth, name), atol=1e-12, err_msg=name)
        assert_allclose(stream.time, truth.time + (1e-3 if name in ("rate", "specific_force") else 0.0), atol=1e-9)
    assert [stream.source for stream in log.alternatives("rate")] == ["/imu", "/estimate"]
    command = log.stream("rotor_command")
    assert command is not None
    assert_allclose(2000.0 * command.values, truth.rotor_speed, atol=1e-9)
    voltage = log.stream("battery_voltage")
    assert voltage is not None
    assert len(voltage.time) == 7
    assert log.stream("thrust_setpoint") is None  # null throughout
    assert log.stream("collective_thrust_command") is not None


def test_a_recording_cut_off_in_flight_is_read_up_to_there(recording: Path, tmp_path: Path) -> None:
    data = recording.read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(data[:-200])  # within the index at the end
    log = read_log(torn)
    assert {repair.name for repair in log.provenance.repairs} == {"torn_end"}
    position = log.stream("position")
    assert position is not None
    assert len(position.time) == 601
    torn.write_bytes(data[:3000])  # within the first chunk, which was never whole
    with pytest.raises(DataError, match="without flight data"):
        read_log(torn)


def test_a_recording_in_chunks_is_the_recording(recording: Path) -> None:
    complete, chunks = read_log(recording), list(read_chunks(recording, 1.5))
    assert len(chunks) == 5
    assert all(chunk.metadata["vehicle"] == "arpl_250g" and not chunk.provenance.repairs for chunk in chunks)
    for name in ("position", "rotor_speed", "specific_force"):
        parts = [stream.values for chunk in chunks if (stream := chunk.stream(name)) is not None]
        assert_array_equal(np.concatenate(parts), complete.stream(name).values, name)  # type: ignore[union-attr]


def test_an_mcap_file_of_others_is_refused_by_its_topics(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        channel = writer.register_channel("/camera", "json", schema)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    with pytest.raises(DataError, match="/camera"):
        read_log(path)
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(3))
    with pytest.raises(DataError, match=r"\(none\)"):
        read_log(path)
