"""A planned flight becomes a file that `fly` takes, beside the recordings, and no file of another flight is lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from alula.api.reference_file import FILE, planned_reference
from dynamics.errors import RequestError
from dynamics.references import named_reference
from dynamics.vehicle import Vehicle
from simulation.trial_flight import TrialFlight
from vehicles import FOLDER


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diagnosis.experiment.expectation.TRIALS", (6, 6))
    monkeypatch.setattr("simulation.trial_flight.fly_trial", lambda *_: TrialFlight(0.02, 0.05))


def test_the_file_lies_in_the_folder_of_the_recordings_and_none_is_overwritten(
    arpl_250g: Vehicle, tmp_path: Path
) -> None:
    folder, reports = tmp_path / "recordings", []
    for _ in range(2):
        planned = planned_reference(
            "identify:for=rotor_drag",
            arpl_250g,
            duration=12.0,
            folder=folder,
            progress=lambda *what: reports.append(what),
        )
    assert sorted(path.name for path in folder.iterdir()) == [FILE, "identification_flight_2.csv"]
    assert planned.file == str(folder / "identification_flight_2.csv")
    assert named_reference(planned.file, arpl_250g).duration == pytest.approx(12.0)
    assert "on the mock: 0.020 m RMS off" in planned.text
    assert "rotor_drag.coefficient" in planned.text
    assert ("flying on the mock", 0.0) in reports
    assert any(what == "planning" and 0.0 < share <= 1.0 for what, share in reports)


def test_a_bundles_own_vehicle_file_is_planned_for(tmp_path: Path) -> None:
    bundle = tmp_path / "bundle"
    bundle.mkdir()
    (bundle / "vehicle.toml").write_text((FOLDER / "crazyflie.toml").read_text())
    planned = planned_reference("identify:for=rotor_drag,duration=12", bundle, folder=tmp_path)
    assert "for crazyflie" in Path(planned.file).read_text().splitlines()[0]


def test_nothing_is_planned_for_no_vehicle() -> None:
    with pytest.raises(RequestError, match=r"--vehicle V\.toml or --bundle B"):
        planned_reference("identify", None)
