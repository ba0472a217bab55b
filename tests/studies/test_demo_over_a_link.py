"""The demo over a real link, against the clock; in lockstep it is in `test_demo.py`, which others may run beside."""

import csv
from pathlib import Path

import msgspec
import pytest

from dynamics.errors import VehicleError
from runtime.record.recording import read_recording
from simulation.mock_process import mock_process
from studies.demo.flights import DemoOptions
from studies.demo.report import tracked, write_report
from studies.demo.result import DemoReport
from studies.demo.run import run_demo

pytestmark = pytest.mark.realtime


def ignore(_: str) -> None:
    """Discard an announcement."""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[DemoOptions, DemoReport, list[str]]:
    """The first half over a real link."""
    folder = tmp_path_factory.mktemp("demo")
    options = DemoOptions(folder, manoeuvres=("WarpedEllipse_1",), duration=8.0, learn=False)
    announcements: list[str] = []
    report, learning = run_demo(options, announcements.append, announcements.append)
    assert learning is None
    return options, write_report(report, folder), announcements


def test_a_manoeuvre_is_tracked_over_mavlink_with_an_effect_hidden(flown) -> None:
    options, report, announcements = flown
    (manoeuvre,) = report.nominal
    assert manoeuvre.name == "WarpedEllipse_1"
    assert 0 < manoeuvre.position_rmse < 0.3
    assert manoeuvre.position_max >= manoeuvre.position_rmse
    assert report.hidden_effects == options.effects
    assert any("ENGAGED" in line for line in announcements)


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
    times, position, setpoint = tracked(read_recording(Path(report.nominal[0].recording)))
    assert 6 < times[-1] - times[0] < 9
    error = ((position - setpoint) ** 2).sum(axis=1).mean() ** 0.5
    assert error == pytest.approx(report.nominal[0].position_rmse, rel=0.15)


def test_a_vehicle_that_cannot_be_flown_ends_the_demo_with_an_error(tmp_path: Path) -> None:
    options = DemoOptions(
        tmp_path, vehicle="arpl_250g", effects=("weak_rotor:rotor=1,loss=0.9",), manoeuvres=("hover",)
    )
    with pytest.raises(VehicleError):
        run_demo(msgspec.structs.replace(options, duration=5.0), ignore, ignore)


def test_a_mock_that_dies_is_named_as_the_cause_of_the_flights_end() -> None:
    def fly_until_it_is_gone() -> None:
        with mock_process(vehicle="arpl_250g") as mock:
            mock.process.kill()
            mock.process.wait()
            raise VehicleError("no vehicle was heard")

    with pytest.raises(VehicleError, match=r"the mock ended by itself with exit code -9") as caught:
        fly_until_it_is_gone()
    assert "no vehicle was heard" in str(caught.value.__cause__)
