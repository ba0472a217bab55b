"""What a model followed in flight, as a user meets it: recordings in lockstep, diagnose and add --from-flight."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import alula
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle, write_vehicle
from fixtures.followed_flight import fly_following
from studies.results.read import show
from tests.support.command_line import Run, command_line

DRAGS = (EffectUse("rotor_drag", {"coefficient": 2.2e-5}), EffectUse("parasitic_drag", {"coefficient": 0.01}))


@pytest.fixture(scope="module")
def folder(arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A vehicle file, a flight with hidden drags and one with a hidden mass, whose model followed in shadow."""
    folder = tmp_path_factory.mktemp("followed")
    write_vehicle(arpl_250g, folder / "quad.toml")
    fly_following(arpl_250g, folder / "drags.mcap", hidden=DRAGS, seed=11)
    heavy = [EffectUse("mass", {"ratio": 1.15})]
    fly_following(
        arpl_250g, folder / "mass.mcap", hidden=heavy, follow=["mass"], mode="shadow", reference="hover", duration=5.0
    )
    return folder


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


def test_what_was_followed_becomes_the_next_vehicle_file(run: Run, folder: Path) -> None:
    report = folder / "added.json"
    words = ("add", folder / "drags.mcap", "--vehicle", folder / "quad.toml", "--from-flight")
    code, shown, _ = run(*words, "--json", report)
    assert code == 0
    path = folder / "quad.v2.toml"
    assert shown.splitlines()[-1].startswith(f"next: alula fly --vehicle {path} ")
    assert "accelerometer, in that flight: " in shown
    assert "left out: wind (x = " in shown
    added = read_vehicle(path)
    by_name = {use.name: use.parameters["coefficient"] for use in added.effects}
    answer = json.loads(report.read_text())
    for use in DRAGS:
        value = answer["parameters"][use.name]["coefficient"]
        assert abs(value["value"] - use.parameters["coefficient"]) < 3 * value["std"]
        assert by_name[use.name] == pytest.approx(value["value"], rel=1e-3)
    (entry,) = added.history
    assert entry.flights[0].startswith("drags.mcap ")
    assert entry.after["imu"] < 0.3 * entry.before["imu"]
    assert (answer["mode"], answer["vehicle"]) == ("on", str(path))
    code, _, message = run(*words[:3], path, "--from-flight")
    assert code == 2
    assert "was not there in flight" in message


def test_the_diagnosis_agrees_with_the_flight(run: Run, folder: Path) -> None:
    report = folder / "verdict.json"
    page = folder / "diagnosis.html"
    words = ("diagnose", folder / "drags.mcap", "--vehicle", folder / "quad.toml", "--json", report, "--html", page)
    code, shown, _ = run(*words)
    assert code == 0
    assert "in flight: rotor_drag agrees: coefficient = " in shown
    by_name = {one["name"]: one for one in json.loads(report.read_text())["in_flight"]}
    assert by_name["rotor_drag"]["outcome"] == by_name["parasitic_drag"]["outcome"] == "agrees"
    assert by_name["rotor_drag"]["named"]
    assert set(by_name["wind"]["parameters"]) == {"x", "y", "z"}
    text = page.read_text()
    assert "<li>rotor_drag agrees: coefficient = " in text
    assert "rotor_drag.coefficient, N s" in text


def test_a_strong_wind_in_one_flight_is_named_and_agrees(arpl_250g: Vehicle, tmp_path: Path) -> None:
    """It was taken for a gust, with the wrong effects beside it: about a vehicle without drag wind has no moments."""
    hidden = [EffectUse("rotor_drag", {"coefficient": 3.2e-5}), EffectUse("wind", {"x": -2.0, "y": -6.4, "z": 0.0})]
    fly_following(arpl_250g, tmp_path / "windy.mcap", hidden=hidden, seed=40014, duration=24.0)
    report = alula.diagnose(tmp_path / "windy.mcap", arpl_250g).report
    values = {effect.name: effect.parameters for effect in report.effects}
    assert set(values) == {"rotor_drag", "wind"}
    assert values["wind"]["y"].value == pytest.approx(-6.4, abs=0.1)
    (wind,) = [one for one in report.in_flight if one.name == "wind"]
    assert wind.parameters["y"].value == pytest.approx(-6.4, abs=0.3)


def test_the_page_of_a_recording_has_the_parameters_over_time(folder: Path) -> None:
    shown = show(folder / "drags.mcap")
    drawn = json.loads(shown.pictures["Followed in flight"].data)
    bands = [trace for trace in drawn["data"] if trace.get("fill") == "toself"]
    assert len(bands) == 5
    (table,) = [table for table in shown.tables if table.title == "Followed in flight"]
    assert [row[0] for row in table.rows][-1] == "parasitic_drag.coefficient"
    assert float(str(table.rows[3][3]).split()[0]) < 2.2e-5 < float(str(table.rows[3][3]).split()[-1])


def test_a_flight_that_changes_nothing_ends_with_3_and_says_where_the_mass_is(run: Run, folder: Path) -> None:
    code, _, message = run("add", folder / "mass.mcap", "--vehicle", folder / "quad.toml", "--from-flight")
    assert code == 3
    assert "mass (ratio = " in message
    assert "in its effectiveness, 0.8" in message
    assert "alone, mass would be 1.1" in message
    assert not (folder / "quad.v3.toml").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--hold-out", "a*"), "--hold-out with --from-flight, which fits nothing"),
        (("--rotor", "1"), "--rotor with --from-flight"),
        (("mass.mcap",), "takes one recording, not 2"),
    ],
)
def test_requests_that_make_no_sense_end_with_2(run: Run, folder: Path, words: tuple[str, ...], message: str) -> None:
    code, _, error = run("add", folder / "drags.mcap", *words, "--vehicle", folder / "quad.toml", "--from-flight")
    assert code == 2
    assert message in error


def test_the_newest_recording_of_a_folder_and_one_effect(folder: Path) -> None:
    with pytest.raises(alula.RequestError, match="wind was not followed in this flight"):
        alula.add_from_flight(folder, folder / "quad.toml", "wind")  # mass.mcap, the last by name
    result = alula.add_from_flight(folder / "drags.mcap", folder / "quad.toml", "rotor_drag")
    assert [use.name for use in result.vehicle.effects] == ["rotor_drag"]
    assert result.followed.tracked.all()
    assert result.write(folder / "own.toml").is_file()
    with pytest.raises(alula.RequestError, match="never overwritten"):
        result.write(folder / "own.toml")


def test_a_log_without_is_refused(folder: Path) -> None:
    table = folder / "flight.csv"
    table.write_text("t\n0\n")
    with pytest.raises(alula.DataError, match="no recording of a flight whose model followed"):
        alula.add_from_flight(table, folder / "quad.toml")
