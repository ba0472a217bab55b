"""A tlog of several vehicles: one is read, chosen by the rule of the link, and it is said which."""

from __future__ import annotations

import inspect
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import development as mavlink

import alula
from dynamics.errors import RequestError
from dynamics.recorded_vehicle import choose_system, chosen_system
from flights import read_log
from flights.parallel import parallel_map
from studio.app.opened import OpenCase
from studio.case.case import Case
from studio.case.commands import command, script
from studio.case.state import Options
from studio.work.results import Checked
from tests.support.command_line import Run, command_line
from tests.support.flight_files import manoeuvre, tlog
from tests.support.worker_here import WorkerHere

CHOOSING = (
    "read_flight", "read_flights", "inspect", "compare", "compare_hover", "diagnose", "add_effect", "prove", "train",
    "evaluate", "vehicle_from_logs", "check_vehicle",
)  # fmt: skip
STAMP = struct.Struct(">Q")
HEIGHTS = {1: 0.0, 2: 50.0}  # m, of the two vehicles


@pytest.fixture(autouse=True)
def nothing_chosen() -> Iterator[None]:
    choose_system(None)
    yield
    choose_system(None)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tlog of system 1, of system 2 that flies 50 m higher, and of setpoints of one companion to each."""
    truth = manoeuvre(duration=3.0)
    frames: list[tuple[int, bytes]] = []
    for system, height in HEIGHTS.items():
        packer = mavlink.MAVLink(None, system, 1)
        for stamp, message in _messages(tlog(truth)):
            if message.get_type() == "ODOMETRY":
                message.z -= height
            frames.append((stamp + system, bytes(message.pack(packer))))
        companion = mavlink.MAVLink(None, system, 191)
        for stamp in range(frames[0][0], frames[-1][0], 20_000):
            target = (0, system, 1, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.1 * system)
            frames.append((stamp + 5, bytes(mavlink.MAVLink_set_attitude_target_message(*target).pack(companion))))
    path = tmp_path_factory.mktemp("tlogs") / "both.tlog"
    path.write_bytes(b"".join(STAMP.pack(stamp) + frame for stamp, frame in sorted(frames)))
    return path


def _messages(data: bytes) -> Iterator[tuple[int, mavlink.MAVLink_message]]:
    parser = mavlink.MAVLink(None)
    while data:
        length = 12 + data[9]
        yield STAMP.unpack_from(data)[0], parser.decode(bytearray(data[8 : 8 + length]))
        data = data[8 + length :]


def height_of(path: Path) -> float:
    """Mean height of the vehicle that is read, above that of the first, m."""
    positions = [stream for stream in read_log(path).streams if stream.name == "position"]
    return float(np.mean(positions[0].values[:, 2])) - float(np.mean(manoeuvre(duration=3.0).position[:, 2]))


def height_of_flight(flight: alula.Flight) -> float:
    """Mean height of a flight above that of the first vehicle, m."""
    return float(np.nanmean(flight["position"][:, 2])) - float(np.mean(manoeuvre(duration=3.0).position[:, 2]))


@pytest.mark.parametrize(("system", "vehicle"), [(None, 1), (1, 1), (2, 2)])
def test_the_vehicle_that_was_chosen_is_read_with_what_was_sent_to_it(
    both: Path, system: int | None, vehicle: int
) -> None:
    lines: list[str] = []
    choose_system(system, lines.append)
    assert height_of(both) == pytest.approx(HEIGHTS[vehicle], abs=0.1)
    log = read_log(both)
    (line,) = lines  # once, however often it is read
    assert f"2 vehicles are on this link (1/1, 2/1); system {vehicle}, " in line
    assert any(note in line for note in log.provenance.notes)
    (thrust,) = [stream.values for stream in log.streams if "thrust" in stream.name]
    assert np.unique(np.round(thrust, 3)) == pytest.approx([0.1 * vehicle])


def test_a_vehicle_that_is_not_in_the_recording_is_refused_with_those_that_are(both: Path) -> None:
    choose_system(3)
    with pytest.raises(RequestError, match=r"both\.tlog: no vehicle with system id 3.*one of: 1, 2;"):
        read_log(both)


def test_processes_that_do_part_of_the_work_read_the_same_vehicle(both: Path) -> None:
    choose_system(2)
    heights = dict(parallel_map(height_of, [both, both], jobs=2))
    assert list(heights.values()) == pytest.approx([50.0, 50.0], abs=0.1)


def test_a_recording_of_one_vehicle_says_nothing(tmp_path: Path) -> None:
    lines: list[str] = []
    choose_system(1, lines.append)
    (tmp_path / "one.tlog").write_bytes(tlog(manoeuvre(duration=1.0)))
    read_log(tmp_path / "one.tlog")
    assert not lines


def test_python_chooses_for_a_call_and_leaves_the_process_as_it_was(both: Path) -> None:
    for system in (2, 1):
        flight = alula.read_flight(both, system=system)
        assert height_of_flight(flight) == pytest.approx(HEIGHTS[system], abs=0.1)
        assert height_of_flight(alula.read_flights(both, system=system)[0]) == pytest.approx(HEIGHTS[system], abs=0.1)
        assert any(f"system {system}, which was chosen" in note for note in alula.inspect(both, system=system).notes)
    assert chosen_system() is None
    choose_system(2)
    assert height_of_flight(alula.read_flight(both)) == pytest.approx(HEIGHTS[2], abs=0.1)
    with pytest.raises(RequestError, match="system = 256 is no system id"):
        alula.read_flight(both, system=256)
    with pytest.raises(RequestError, match="no vehicle with system id 9"):
        alula.read_flight(both, system=9)
    assert chosen_system() == 2


@pytest.mark.parametrize("function", CHOOSING)
def test_every_function_that_reads_logs_chooses(function: str) -> None:
    parameters = inspect.signature(getattr(alula, function)).parameters
    assert parameters["system"].default is None
    assert "system" in str(getattr(alula, function).__doc__)


def test_the_studio_chooses_by_an_option_of_the_case(both: Path, tmp_path: Path) -> None:
    case = Case.create(tmp_path / "case")
    case.add_logs([both])
    case.set_vehicle("arpl_250g")  # without one there is no script
    without, keys = command(case, "check"), {case.key("flights")}
    for system in ("1", "2"):
        case.set_options(Options(system=system))
        assert command(case, "check") == f"{without} --system {system}"
        assert f"--system {system}" in script(case)
        keys.add(case.key("flights"))
        opened = OpenCase(case, WorkerHere)  # type: ignore[arg-type]
        opened.start("check")
        opened.wait()
        checked = opened.result(Checked, "check")
        assert checked is not None
        (inspection,) = checked.by_log
        assert inspection is not None
        assert any(f"system {system}, which was chosen" in note for note in inspection.notes)
    assert len(keys) == 3
    case.close()


def test_the_command_line_chooses_and_says_what_it_read(both: Path, run: Run) -> None:
    _, _, err = run("inspect", both)
    assert "system 1, the first, is read" in err.replace("\n", " ")
    _, _, err = run("inspect", both, "--system", "2")
    assert "system 2, which was chosen, is read" in err.replace("\n", " ")
    code, _, err = run("inspect", both, "--system", "3")
    assert code == 2
    assert "one of: 1, 2" in err
