"""The demo over a real link, against the clock; in simulated time it is in `test_demo.py`."""

from pathlib import Path

import pytest

from dynamics.errors import VehicleError
from runtime.record.recording import read_recording
from simulation.mock_process import mock_process
from studies.demo.flights import DemoOptions
from studies.demo.report import tracked, write_report
from studies.demo.result import DemoReport
from studies.demo.run import run_demo

pytestmark = pytest.mark.realtime


def ignore(*_: object) -> None:
    """Discard an announcement."""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[DemoOptions, DemoReport, list[str]]:
    """The first half over a real link."""
    folder = tmp_path_factory.mktemp("demo")
    options = DemoOptions(folder, manoeuvres=("WarpedEllipse_1",), duration=8.0, learn=False, realtime=True)
    announcements: list[str] = []
    report, learning = run_demo(options, announcements.append, ignore)
    assert learning is None
    return options, write_report(report, folder), announcements


@pytest.mark.long("a flight against the clock")
def test_a_manoeuvre_is_tracked_over_mavlink_with_an_effect_hidden(flown) -> None:
    options, report, announcements = flown
    (manoeuvre,) = report.nominal
    assert manoeuvre.name == "WarpedEllipse_1"
    assert 0 < manoeuvre.position_rmse < 0.3
    assert manoeuvre.position_max >= manoeuvre.position_rmse
    assert not report.lockstep
    assert report.hidden_effects == options.effects
    assert any("ENGAGED" in line for line in announcements)


def test_the_recording_holds_reference_and_flight_while_tracking(flown) -> None:
    _, report, _ = flown
    times, position, setpoint = tracked(read_recording(Path(report.nominal[0].recording)))
    assert 6 < times[-1] - times[0] < 9
    error = ((position - setpoint) ** 2).sum(axis=1).mean() ** 0.5
    assert error == pytest.approx(report.nominal[0].position_rmse, rel=0.15)


def test_a_mock_that_dies_is_named_as_the_cause_of_the_flights_end() -> None:
    def fly_until_it_is_gone() -> None:
        with mock_process(vehicle="arpl_250g") as mock:
            mock.process.kill()
            mock.process.wait()
            raise VehicleError("no vehicle was heard")

    with pytest.raises(VehicleError, match=r"the mock ended by itself with exit code -9") as caught:
        fly_until_it_is_gone()
    assert "no vehicle was heard" in str(caught.value.__cause__)
