"""The demo flies, diagnoses its own flights, adds what it found and flies again; it always ends cleanly."""

import csv
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from alula.cli.app import app
from dynamics.errors import RequestError, VehicleError
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import find_vehicle, read_vehicle, write_vehicle
from runtime.flight_setup import FlightSetup, prepare_flight
from simulation.mock_process import mock_process
from studies.demo import run as demo_module
from studies.demo.flights import DemoOptions, clear_of_the_ground, clear_old_files
from studies.demo.report import closing_lines, write_report
from studies.demo.result import DemoReport, FlownManoeuvre
from studies.demo.run import check_options, run_demo


def ignore(_: str) -> None:
    """Discard an announcement."""


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> tuple[DemoOptions, DemoReport, list[str]]:
    """Both halves in lockstep."""
    folder = tmp_path_factory.mktemp("lockstep")
    options = DemoOptions(folder, lockstep=True, duration=16.0)
    parts: list[str] = []
    report, learning = run_demo(options, ignore, parts.append, command="alula demo --lockstep")
    return options, write_report(report, folder, learning), parts


def test_the_demo_finds_what_is_hidden_and_the_prediction_error_falls_to_the_noise(learned) -> None:
    _, report, parts = learned
    assert set(report.learned.added) == {"rotor_drag", "parasitic_drag"}
    for kind in ("imu", "mocap"):
        error = report.learned.channels[kind]
        assert error.before > 4 * error.floor
        assert error.after < 1.2 * error.floor
    assert parts.index("diagnosis") == len(report.nominal)


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
    assert entry.command == "alula demo --lockstep"
    assert all(entry.after[kind] < entry.before[kind] for kind in ("imu", "mocap"))
    assert any("WarpedEllipse_2" in name for name in entry.flights)


def test_both_halves_are_in_every_form_of_the_report(learned) -> None:
    options, report, _ = learned
    assert msgspec.json.decode((options.folder / "report.json").read_bytes(), type=DemoReport) == report
    with (options.folder / "tracking.csv").open() as file:
        models = [row["model"] for row in csv.DictReader(file)]
    assert models == ["textbook"] * 3 + ["learned"] * 3
    text = (options.folder / "report.md").read_text()
    for before, after in report.pairs:
        assert f"| {before.position_rmse:.3f} | {after.position_rmse:.3f} |" in text
    assert report.learned.vehicle_file in text
    assert {Path(name).name for name in report.files} >= {"tracking.png", "report.html"}


def test_where_nothing_is_hidden_nothing_is_added_and_nothing_flown_again(tmp_path: Path) -> None:
    manoeuvres = ("Ellipse_2", "Lemniscate")
    options = DemoOptions(tmp_path, effects=(), manoeuvres=manoeuvres, lockstep=True, duration=16.0)
    report, learning = run_demo(options, ignore, ignore)
    assert report.learned.added == ()
    assert report.learned.flown == ()
    assert report.learned.vehicle_file == ""
    assert not list(tmp_path.glob("*.toml"))
    assert "nothing was flown again" in closing_lines(report)[-1]
    files = {Path(name).name for name in write_report(report, tmp_path, learning).files}
    assert files == {"tracking.csv", "tracking.png", "report.html", "report.md", "report.json"}


def test_without_the_workbenchs_libraries_the_first_half_names_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_module, "NEEDED", ("scipy", "no_such_library"))
    report = DemoReport("arpl_250g", (), 1, (), missing=demo_module.absent_libraries())
    assert "no_such_library" in closing_lines(report)[0]
    assert "[workbench]'" in closing_lines(report)[0]
    with pytest.raises(RequestError, match="no_such_library"):
        check_options(DemoOptions(tmp_path, lockstep=True))


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
        ({"vehicle": "absent.toml"}, "cannot read"),
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
