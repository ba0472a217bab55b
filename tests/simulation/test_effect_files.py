"""Effects of one's own that the vehicle file names are those of every command: flown, hidden, exported, recorded."""

import shutil
from pathlib import Path

import msgspec
import pytest

from dynamics.effect_source import read_effect_file
from dynamics.errors import DataError, RequestError
from dynamics.own_effects import catalogue_of
from dynamics.trust import approve_given
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_editing import edited_toml
from dynamics.vehicle_file import parse_vehicle, read_vehicle, vehicle_text
from export.bundle import _vehicle_texts
from export.trained import read_model
from runtime.control.bundle import VEHICLE
from runtime.flight_setup import VEHICLE_TEXT, FlightSetup, prepare_flight, recorded_flight
from runtime.record.recording import FlightRecording
from sitl_mock.mock import MockOptions, build_autopilot

OWN = Path("examples/my_effects.py").resolve()


@pytest.fixture
def tethered(arpl_250g: Vehicle, tmp_path: Path) -> Path:
    """A vehicle file that names a file beside it, and an effect of it."""
    shutil.copy(OWN, tmp_path / "mine.py")
    text = Path("vehicles/arpl_250g.toml").read_text()
    path = tmp_path / "tethered.toml"
    path.write_text(
        'effect_files = ["mine.py"]\n'
        + text
        + '\n[[effects]]\nname = "tether"\n[effects.parameters]\nstiffness = 0.2\n'
    )
    return path


def test_a_vehicle_names_its_files_relative_to_itself(tethered: Path) -> None:
    vehicle = read_vehicle(tethered)
    assert [file.path for file in vehicle.effect_files] == [str(tethered.with_name("mine.py"))]
    assert "tether" in catalogue_of(vehicle)
    assert parse_vehicle(vehicle_text(tethered)) == vehicle


def test_a_file_that_is_not_there_or_given_twice(tethered: Path) -> None:
    assert read_vehicle(tethered, effect_files=[tethered.with_name("mine.py")]) == read_vehicle(tethered)
    tethered.with_name("mine.py").unlink()
    with pytest.raises(RequestError, match=r"mine\.py is no file with effects: there is none"):
        read_vehicle(tethered)


def test_the_next_version_keeps_the_files_and_adds_those_of_the_command(tethered: Path, arpl_250g: Vehicle) -> None:
    text, folder = tethered.read_text(), tethered.parent
    heavier = msgspec.structs.replace(read_vehicle(tethered), source="weighed")
    assert 'effect_files = ["mine.py"]' in edited_toml(text, heavier, folder=folder)
    plain = Path("vehicles/arpl_250g.toml").read_text()
    added = arpl_250g.with_effects(EffectUse("tether", {"stiffness": 0.2}))
    added = msgspec.structs.replace(added, effect_files=(read_effect_file(folder / "mine.py"),))
    assert 'effect_files = ["mine.py"]' in edited_toml(plain, added, folder=folder)


def test_the_mock_flies_and_hides_them(tethered: Path) -> None:
    autopilot = build_autopilot(MockOptions(vehicle=tethered, effects=("late_drag:coefficient=0.1",)))
    names = autopilot.vehicle.plant.model.parameter_names
    assert {"tether.stiffness", "late_drag.coefficient"} <= set(names)


def test_a_flight_has_them_in_its_model_and_the_recording_their_text(tethered: Path) -> None:
    setup = FlightSetup(link="udpin:127.0.0.1:14540", reference="hover", vehicle=str(tethered))
    flight = prepare_flight(setup)
    assert flight.request.attachments["effects/mine.py"] == OWN.read_text()
    assert "sha256 of effects/mine.py" in flight.request.metadata
    assert "tether" in {use.name for use in flight.vehicle.effects}


def test_a_bundle_holds_them_beside_its_vehicle_file(tethered: Path, tmp_path: Path) -> None:
    texts = _vehicle_texts(read_model(tethered))
    (tmp_path / "bundle").mkdir()
    for name, text in texts.items():
        (tmp_path / "bundle" / name).write_text(text)
    tethered.with_name("mine.py").unlink()
    assert "tether" in catalogue_of(read_vehicle(tmp_path / "bundle" / VEHICLE))


def test_a_replay_refuses_another_files_content(tethered: Path, tmp_path: Path) -> None:
    setup = FlightSetup(link="udpin:127.0.0.1:14540", reference="hover", vehicle=str(tethered))
    request = prepare_flight(setup).request
    metadata = {"reference": "hover", "plan": msgspec.json.encode(request.plan).decode()}
    recording = FlightRecording(tmp_path / "flight.mcap", metadata, request.attachments, {}, complete=True)
    vehicle, _, _ = recorded_flight(recording, None, None)
    assert vehicle == parse_vehicle(request.attachments[VEHICLE_TEXT])
    mine = tethered.with_name("mine.py")
    mine.write_text(mine.read_text() + "\n# changed\n")
    approve_given([mine])
    with pytest.raises(DataError, match="was flown with another mine"):
        recorded_flight(recording, None, None, [mine])


@pytest.mark.parametrize("lacking", ["reference", "plan"])
def test_a_replay_of_a_recording_that_lacks_a_part_says_which(tethered: Path, tmp_path: Path, lacking: str) -> None:
    request = prepare_flight(
        FlightSetup(link="udpin:127.0.0.1:14540", reference="hover", vehicle=str(tethered))
    ).request
    metadata = {"reference": "hover", "plan": msgspec.json.encode(request.plan).decode()}
    del metadata[lacking]
    recording = FlightRecording(tmp_path / "flight.mcap", metadata, request.attachments, {}, complete=True)
    with pytest.raises(DataError, match=f"holds no {lacking}: `alula fly` did not write it"):
        recorded_flight(recording, None, None)
