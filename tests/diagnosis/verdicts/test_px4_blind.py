"""Changes of PX4's simulated quadrotor are named from logs as real PX4 writes them: commands, and its estimate."""

from __future__ import annotations

from pathlib import Path

import pytest

import alula
from dynamics.vehicle_file import read_vehicle
from fixtures.outside_sih import PATHS, fly_sih, sih_flight
from vehicles import FOLDER

VEHICLE = FOLDER / "px4_sih.toml"
DURATION = 34.0  # s
SETS = {  # what is hidden, the seed of each path, and how far a value may be off
    # the open loop's position refused it
    "inertia": ({"ratio_x": 1.3, "ratio_y": 1.3, "ratio_z": 1.3}, {0: 40, 1: 41, 3: 43}, 0.05),
    # in a circle it was a difference between motors
    "rotational_damping": ({"coefficient": 0.05}, {0: 40, 1: 41, 3: 43}, 0.03),
    # what is held out hardly yaws, so that the torque constant that is beside the gain was too small
    "thrust_constant": ({"ratio": 0.8926782847918181}, {3: 2034474693, 1: 54338872}, 0.05),
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of each set."""
    folder, vehicle = tmp_path_factory.mktemp("px4"), read_vehicle(VEHICLE)
    names = [name for name, (_, seeds, _) in SETS.items() for _ in seeds]
    flights = [
        sih_flight(PATHS[path], vehicle, {name: hidden}, DURATION, seed)
        for name, (hidden, seeds, _) in SETS.items()
        for path, seed in seeds.items()
    ]
    for number, (name, log) in enumerate(zip(names, fly_sih(flights), strict=True)):
        assert log is not None
        (folder / name).mkdir(exist_ok=True)
        (folder / name / f"{number}.ulg").write_bytes(log)
    return folder


@pytest.mark.parametrize("name", SETS)
def test_a_change_is_named_alone_and_with_its_value(flown: Path, name: str) -> None:
    diagnosis = alula.diagnose(str(flown / name), str(VEHICLE))
    assert [effect.name for effect in diagnosis.report.effects] == [name], diagnosis.sentence
    assert diagnosis.report.verdict != "unknown", diagnosis.sentence
    hidden, _, tolerance = SETS[name]
    for key, value in hidden.items():
        assert diagnosis.report.effects[0].parameters[key].value == pytest.approx(value, rel=tolerance)
