"""The demo flies over a real link and leaves a report that says what was flown; twice in the same folder as well."""

import csv
from pathlib import Path

import msgspec
import pytest

from alula.demo import DemoOptions, DemoReport, FlownManoeuvre, check_options, run_demo
from alula.demo_report import tracked, write_report
from dynamics.errors import RequestError, VehicleError
from runtime.recording import read_recording


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[DemoOptions, DemoReport, list[str]]:
    folder = tmp_path_factory.mktemp("demo")
    options = DemoOptions(folder, manoeuvres=("WarpedEllipse_1",), duration=8.0)
    news: list[str] = []
    return options, write_report(run_demo(options, news.append, news.append), folder), news


def test_a_manoeuvre_is_tracked_over_mavlink_with_an_effect_hidden(flown) -> None:
    options, report, news = flown
    (manoeuvre,) = report.nominal
    assert manoeuvre.name == "WarpedEllipse_1"
    assert 0 < manoeuvre.position_rmse < 0.3
    assert manoeuvre.position_max >= manoeuvre.position_rmse
    assert report.hidden_effects == options.effects
    assert any("ENGAGED" in line for line in news)


def test_the_report_says_the_same_in_every_form(flown) -> None:
    options, report, _ = flown
    with (options.folder / "tracking.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert float(row["position_rmse"]) == pytest.approx(report.nominal[0].position_rmse, rel=1e-5)
    assert msgspec.json.decode((options.folder / "report.json").read_bytes(), type=DemoReport) == report
    text = (options.folder / "report.md").read_text()
    assert f"{report.nominal[0].position_rmse:.3f}" in text
    assert "rotor_drag" in text
    assert not list(options.folder.glob(".part-*"))


def test_the_recording_holds_reference_and_flight_while_tracking(flown) -> None:
    _, report, _ = flown
    times, position, asked = tracked(read_recording(Path(report.nominal[0].recording)))
    assert 6 < times[-1] - times[0] < 9
    error = ((position - asked) ** 2).sum(axis=1).mean() ** 0.5
    assert error == pytest.approx(report.nominal[0].position_rmse, rel=0.15)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"manoeuvres": ("Lemniskate",)}, "did you mean 'Lemniscate'"),
        ({"manoeuvres": ()}, "no manoeuvre"),
        ({"effects": ("rotor_dragg",)}, "did you mean 'rotor_drag'"),
        ({"vehicle": "absent.toml"}, "cannot read"),
    ],
)
def test_what_cannot_be_flown_is_refused_before_anything_starts(tmp_path: Path, change: dict, told: str) -> None:
    with pytest.raises(RequestError, match=told):
        check_options(DemoOptions(tmp_path, **change))


def test_a_table_without_a_paper_figure_leaves_its_cell_empty(tmp_path: Path) -> None:
    flown = FlownManoeuvre("circle", 2.4, 0.05, 0.1, None, "none")
    report = DemoReport("arpl_250g", (), 1, (flown,))
    with pytest.raises(Exception, match="none"):
        write_report(report, tmp_path)
    assert (tmp_path / "tracking.csv").read_text().count("circle") == 1


def test_a_vehicle_that_cannot_be_flown_ends_the_demo_with_an_error(tmp_path: Path) -> None:
    options = DemoOptions(
        tmp_path, vehicle="arpl_250g", effects=("weak_rotor:rotor=1,loss=0.9",), manoeuvres=("hover",)
    )
    with pytest.raises(VehicleError):
        run_demo(msgspec.structs.replace(options, duration=5.0), lambda _: None, lambda _: None)
