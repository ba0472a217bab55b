"""The demo flies, diagnoses its own flights, adds what it found and flies again; it always ends cleanly."""

import csv
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from alula.cli.app import app
from dynamics.errors import RequestError, VehicleError
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import find_vehicle, read_vehicle, write_vehicle
from flights.parallel import parallel_map
from runtime.flight_setup import FlightSetup, prepare_flight
from runtime.link.framing import FrameParser, frame_length
from simulation.mock_process import mock_process
from simulation.starvation import StarvationMeter, Window
from studies.demo import run as demo_module
from studies.demo.flights import (
    NOMINAL,
    STARVED,
    DemoOptions,
    TaskOutcome,
    clear_of_the_ground,
    clear_old_files,
    first_error,
    fly_task,
    naming_starvation,
    recording_name,
    tasks_of,
)
from studies.demo.report import closing_lines, flown_and_setpoint, write_report
from studies.demo.result import DemoReport, FlownManoeuvre
from studies.demo.run import check_options, run_demo


def ignore(*_: object) -> None:
    """Discard an announcement."""


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> tuple[DemoOptions, DemoReport, list[tuple[str, float]]]:
    """Both halves, as `alula demo` flies them, of two manoeuvres."""
    folder = tmp_path_factory.mktemp("demo")
    options = DemoOptions(folder, manoeuvres=("WarpedEllipse_2", "Lemniscate"))
    parts: list[tuple[str, float]] = []
    report, learning = run_demo(options, ignore, lambda *part: parts.append(part), command="alula demo")
    return options, write_report(report, folder, learning), parts


def answer(report: DemoReport) -> bytes:
    """The report without the times of day in its files' names, and without its folder."""
    folder = str(Path(report.files[0]).parent)
    text = msgspec.json.encode(report).decode().replace(folder, "FOLDER")
    return re.sub(r"\d{8}-\d{6}", "TIME", text).encode()


def mavlink_messages(tlog: Path) -> Counter[str]:
    """How often each message is in a .tlog, in either direction."""
    data, parser, counts = tlog.read_bytes(), FrameParser(), Counter[str]()
    while data:  # 8 bytes of a stamp before each frame
        length = frame_length(data, 8)
        assert length
        counts.update(frame.message.get_type() for frame in parser.feed(data[8 : 8 + length]))
        data = data[8 + length :]
    return counts


@pytest.mark.slow
def test_another_run_gives_the_same_answer_byte_for_byte(learned, tmp_path: Path) -> None:
    options, report, _ = learned
    again, learning = run_demo(msgspec.structs.replace(options, folder=tmp_path, jobs=1), ignore, ignore)
    assert answer(write_report(again, tmp_path, learning)) == answer(report)


@pytest.mark.long("two flights, one in another process")
def test_a_flight_has_the_same_bytes_in_any_process_and_at_any_speed_of_the_machine(tmp_path: Path) -> None:
    options = DemoOptions(tmp_path, manoeuvres=("hover",), duration=5.0)
    (task, _) = tasks_of(options, str(find_vehicle(options.vehicle)), NOMINAL, "20260101-000000")
    tasks = [msgspec.structs.replace(task, file=name) for name in ("here", "elsewhere")]
    here = fly_task(tasks[0])
    ((_, elsewhere),) = parallel_map(fly_task, tasks[1:], jobs=2, killed=lambda _: TaskOutcome(error="killed"))
    assert not here.error
    assert here.lines == elsewhere.lines
    for suffix in (".mcap", ".tlog"):
        files = [tmp_path / "recordings" / f"{name}{suffix}" for name in ("here", "elsewhere")]
        assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.long("both halves of the demo")
def test_a_flights_recording_is_that_of_a_flight_over_the_link(learned) -> None:
    """The frames of both directions are there, and the setpoints went as messages."""
    _, report, _ = learned
    recording = Path(report.nominal[0].recording)
    sent = mavlink_messages(recording.with_suffix(".tlog"))
    assert {"SET_ATTITUDE_TARGET", "COMMAND_LONG", "HEARTBEAT", "TIMESYNC", "ODOMETRY", "HIGHRES_IMU"} <= set(sent)
    times, position, setpoint = flown_and_setpoint(recording)
    assert times[-1] - times[0] == pytest.approx(10.0, abs=0.2)
    error = ((position - setpoint) ** 2).sum(axis=1).mean() ** 0.5
    assert error == pytest.approx(report.nominal[0].position_rmse, rel=0.05)


def test_progress_comes_at_once_and_reaches_the_end(learned) -> None:
    _, report, parts = learned
    shares = [share for _, share in parts]
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    assert "diagnosis" in [name for name, _ in parts]
    assert len(parts) > 4 * len(report.nominal)


def test_a_flight_that_ends_early_says_what_the_vehicle_hides_and_the_first_one_counts(tmp_path: Path) -> None:
    options = DemoOptions(tmp_path, effects=("weak_rotor:rotor=1,loss=0.9",), manoeuvres=("hover",), duration=5.0)
    early = r"(?s)flight of hover with the nominal model ended early.*weak_rotor.*Hide less"
    with pytest.raises(VehicleError, match=early) as caught:
        run_demo(msgspec.structs.replace(options, jobs=1), ignore, ignore)
    assert "machine" not in str(caught.value)
    outcomes = [TaskOutcome(), TaskOutcome(error="the first"), TaskOutcome(error="finished before it")]
    assert first_error(outcomes) == "the first"


def test_the_demo_finds_what_is_hidden_and_the_prediction_error_falls_to_the_noise(learned) -> None:
    _, report, _ = learned
    assert set(report.learned.added) == {"rotor_drag", "parasitic_drag"}
    for kind in ("imu", "mocap"):
        error = report.learned.channels[kind]
        assert error.before > 4 * error.floor
        assert error.after < 1.2 * error.floor


@pytest.mark.parametrize(
    ("name", "higher"),
    [
        ("Lemniscate", "Lemniscate:height=2.5"),
        ("circle:speed=2", "circle:speed=2,height=2.5"),
        ("circle:speed=2,height=1", "circle:speed=2,height=1"),
    ],
)
def test_on_px4s_estimate_a_manoeuvre_is_flown_higher_up(name: str, higher: str) -> None:
    assert clear_of_the_ground(name) == higher


def test_the_same_manoeuvres_are_tracked_better_with_what_was_found(learned) -> None:
    _, report, _ = learned
    assert [after.name for after in report.learned.flown] == [before.name for before in report.nominal]
    for before, after in report.pairs:
        assert before.position_rmse > 2 * after.position_rmse
        assert before.position_rmse < before.px4_rmse < 0.3
        assert after.px4_rmse < before.px4_rmse + 0.02


def test_the_next_vehicle_file_knows_the_effects_and_where_they_come_from(learned) -> None:
    options, report, _ = learned
    path = Path(report.learned.vehicle_file)
    assert path.parent == options.folder
    vehicle = read_vehicle(path)
    rows = {use.name: use.parameters["coefficient"] for use in vehicle.effects}
    assert rows == pytest.approx({"rotor_drag": 2.2e-5, "parasitic_drag": 0.01}, rel=0.1)
    (entry,) = vehicle.history
    assert "rotor_drag" in entry.action
    assert entry.command == "alula demo"
    assert all(entry.after[kind] < entry.before[kind] for kind in ("imu", "mocap"))
    assert any("WarpedEllipse_2" in name for name in entry.flights)


def test_both_halves_are_in_every_form_of_the_report(learned) -> None:
    options, report, _ = learned
    assert msgspec.json.decode((options.folder / "report.json").read_bytes(), type=DemoReport) == report
    with (options.folder / "tracking.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["model"] for row in rows] == ["textbook"] * 2 + ["learned"] * 2
    assert float(rows[0]["position_rmse"]) == pytest.approx(report.nominal[0].position_rmse, rel=1e-5)
    assert not list(options.folder.glob(".part-*"))
    text = (options.folder / "report.md").read_text()
    for before, after in report.pairs:
        assert f"| {before.position_rmse:.3f} | {after.position_rmse:.3f} |" in text
    assert report.learned.vehicle_file in text
    assert {Path(name).name for name in report.files} >= {"tracking.png", "report.html"}


@pytest.mark.long("a half of the demo")
def test_where_nothing_is_hidden_nothing_is_added_and_nothing_flown_again(tmp_path: Path) -> None:
    manoeuvres = ("Ellipse_2", "Lemniscate")
    options = DemoOptions(tmp_path, effects=(), manoeuvres=manoeuvres)
    report, learning = run_demo(options, ignore, ignore)
    assert report.learned.added == ()
    assert report.learned.flown == ()
    assert report.learned.vehicle_file == ""
    assert not list(tmp_path.glob("*.toml"))
    assert "nothing was flown again" in closing_lines(report)[-1]
    files = {Path(name).name for name in write_report(report, tmp_path, learning).files}
    assert files == {"tracking.csv", "tracking.png", "report.html", "report.md", "report.json"}


def test_without_the_workbenchs_libraries_the_first_half_names_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(demo_module, "NEEDED", ("scipy", "no_such_library"))
    report = DemoReport("arpl_250g", (), 1, (), missing=demo_module.absent_libraries())
    assert "no_such_library" in closing_lines(report)[0]
    assert "[workbench]'" in closing_lines(report)[0]


def test_what_was_flown_once_is_flown_again_though_the_better_model_calls_it_infeasible(tmp_path: Path) -> None:
    weak = read_vehicle(find_vehicle("arpl_250g")).with_effects(EffectUse("thrust_constant", {"ratio": 0.6}))
    write_vehicle(weak, tmp_path / "weak.toml")
    setup = FlightSetup(
        link="udpin:127.0.0.1:14540", reference="ExtendedLemniscate", vehicle=str(tmp_path / "weak.toml")
    )
    with pytest.raises(RequestError, match="cannot fly ExtendedLemniscate"):
        prepare_flight(setup)
    assert prepare_flight(setup, flown_before=True).reference.name == "ExtendedLemniscate"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"manoeuvres": ("Lemniskate",)}, "did you mean 'Lemniscate'"),
        ({"manoeuvres": ()}, "no manoeuvre"),
        ({"effects": ("rotor_dragg",)}, "did you mean 'rotor_drag'"),
        ({"vehicle": "absent.toml"}, "there is no vehicle file"),
    ],
)
def test_what_cannot_be_flown_is_refused_before_anything_starts(tmp_path: Path, change: dict, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        check_options(DemoOptions(tmp_path, **change))


def test_a_folder_that_cannot_be_written_is_refused_before_anything_starts(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    result = CliRunner().invoke(app, ["demo", "--out", str(tmp_path / "file" / "demo")])
    assert isinstance(result.exception, RequestError)
    assert "--out" in str(result.exception)


def test_a_table_without_a_paper_figure_leaves_its_cell_empty(tmp_path: Path) -> None:
    flown = FlownManoeuvre("circle", 2.4, 0.05, 0.1, None, "none")
    report = DemoReport("arpl_250g", (), 1, (flown,))
    with pytest.raises(Exception, match="none"):
        write_report(report, tmp_path)
    with (tmp_path / "tracking.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["manoeuvre"], row["paper_rmse"]) == ("circle", "")


def test_a_mock_that_does_not_start_is_an_error_with_its_message() -> None:
    with (
        pytest.raises(VehicleError, match=r"(?s)the mock ended by itself with exit code 2.*rotor_dragg"),
        mock_process("--effect", "rotor_dragg", vehicle="arpl_250g"),
    ):
        pass


def test_an_earlier_demos_files_are_cleared_and_others_stay(tmp_path: Path) -> None:
    old = [
        "recordings/20260101-120000_nominal_line.mcap",
        "recordings/20260101-120100_learned_line.tlog",
        "arpl_250g.v2.toml",
    ]
    others = ["recordings/mine.mcap", "my.toml"]
    (tmp_path / "recordings").mkdir()
    for name in (*old, *others):
        (tmp_path / name).touch()
    clear_old_files(DemoOptions(tmp_path))
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()} == set(others)


class ScriptedMeter(StarvationMeter):
    """A meter of one window in which a thread of ours waited."""

    def __init__(self, wait: float) -> None:
        super().__init__()
        self._wait = wait

    def start(self) -> None:
        now = time.monotonic()
        self.windows = [Window(now, now + 0.2, self._wait, others=1.9, stolen=0.0)]


@pytest.mark.parametrize(("wait", "is_named"), [(2 * STARVED, True), (0.5 * STARVED, False)])
def test_a_real_time_flight_that_the_host_starved_says_that_and_nothing_else(wait: float, is_named: bool) -> None:
    text = "the vehicle does not act on setpoints. Hide less"
    with pytest.raises(VehicleError) as caught, naming_starvation(ScriptedMeter(wait)):
        raise VehicleError(text)
    if not is_named:
        assert str(caught.value) == text
        return
    assert "this machine was too busy for a flight in real time" in str(caught.value)
    assert "without --realtime" in str(caught.value)
    assert "ide less" not in str(caught.value)
    assert "vehicle" not in str(caught.value)


def test_manoeuvres_that_are_flown_twice_have_two_recordings() -> None:
    names = [recording_name("20260101-000000", NOMINAL, number, "circle:speed=2") for number in range(2)]
    assert names == ["20260101-000000_nominal_1_circle_speed_2", "20260101-000000_nominal_2_circle_speed_2"]


def test_an_interrupt_ends_the_demo_at_once_with_its_processes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "alula", "demo", "--out", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    printed = ""
    while "flights, nominal" not in printed:  # the working processes start now
        line = process.stdout.readline()
        assert line, printed
        printed += line
    process.send_signal(signal.SIGINT)
    rest, _ = process.communicate(timeout=60)
    assert process.returncode == 130, printed + rest
    assert "interrupted" in rest
    assert "Traceback" not in rest
