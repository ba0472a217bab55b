"""compare, diagnose and add as a user meets them: on CSV files, with exit codes and the next vehicle file."""

import json
import shlex
import shutil
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from alula.cli import app
from dynamics.references import named_reference
from dynamics.vehicle_file import read_vehicle, write_vehicle
from fixtures.planted import planted_flights
from flights import Flight
from simulation.trial_flight import TrialFlight
from vehicles import FOLDER

MANOEUVRES = ("line:laps=3,ramp=1", "circle:laps=2,ramp=1,speed=1.2", "Lemniscate:laps=3,ramp=1.5,speed=0.9")


@pytest.fixture(scope="module")
def logs(arpl_250g, tmp_path_factory) -> Path:
    """A folder with three flights and a vehicle file that claims 6 % more than the vehicle weighs."""
    folder = tmp_path_factory.mktemp("logs")
    flights: list[Flight] = planted_flights(arpl_250g, [], seed=5, manoeuvres=MANOEUVRES)
    for i, flight in enumerate(flights):
        flight.to_csv(folder / f"flight_{i}.csv")
    body = msgspec.structs.replace(arpl_250g.body, mass=1.06 * arpl_250g.body.mass)
    write_vehicle(msgspec.structs.replace(arpl_250g, body=body), folder / "heavy.toml")
    shutil.copy(FOLDER / "arpl_250g.toml", folder / "right.toml")
    return folder


@pytest.fixture
def run(monkeypatch, capsys, logs):
    """Run a command on the flights; returns exit code, standard output, standard error."""

    def ended(command, *options, vehicle="heavy.toml", files=("flight_0.csv", "flight_1.csv", "flight_2.csv")):
        arguments = [
            *command.split(),
            *(str(logs / name) for name in files),
            "--vehicle",
            str(logs / vehicle),
            *options,
        ]
        monkeypatch.setattr(sys, "argv", ["alula", *arguments])
        with pytest.raises(SystemExit) as caught:
            app.main()
        return caught.value.code, *capsys.readouterr()

    return ended


def test_the_next_flight_is_a_file_and_the_last_line_flies_it(run, logs, tmp_path, monkeypatch):
    monkeypatch.setattr("diagnosis.experiment.expectation.TRIALS", (8, 8))
    monkeypatch.setattr("simulation.trial_flight.fly_trial", lambda *_: TrialFlight(0.02, 0.05))
    verdict, table = tmp_path / "verdict.json", tmp_path / "next flight.csv"
    code, shown, _ = run("diagnose", "--json", str(verdict), "--next-flight", str(table), vehicle="right.toml")
    assert code == 0
    last = shlex.split(shown.splitlines()[-1].removeprefix("next: alula "))
    vehicle = str(logs / "right.toml")
    assert last == ["fly", "--vehicle", vehicle, "--reference", str(table), "--record", "recordings"]
    flown = named_reference(str(table), read_vehicle(vehicle))
    assert flown.duration == pytest.approx(60.0)
    request = json.loads(verdict.read_text())["next_reference"]
    assert table.read_text().startswith(f"# alula fly --reference {request or 'identify'} for ")


def test_diagnose_names_the_effect_in_a_sentence_and_in_json(run, logs, tmp_path):
    effects = Path(__file__).parents[2] / "examples" / "my_effects.py"
    file = tmp_path / "verdict.json"
    code, shown, _ = run("diagnose", "--json", str(file), "--hold-out", "flight_2*", "--effects", str(effects))
    assert code == 0
    assert "mass" in shown
    assert "one flight only" not in shown
    assert "One-step log score" in shown
    verdict = json.loads(file.read_text())
    assert verdict["held_out_score"]["gain"] > 2 * verdict["held_out_score"]["gain_std"]
    contract = {"verdict", "effects", "channels", "not_excited", "fails_where", "next_flight"}
    added = {
        "refused",
        "candidates",
        "leftover",
        "rotors",
        "next_reference",
        "command_gain",
        "in_flight",
        "held_out_score",
        "alula_version",
    }
    assert set(verdict) == contract | added
    assert "mass" in [one["name"] for one in verdict["candidates"][:3]]
    assert verdict["verdict"] in ("effect", "ambiguous")
    first = verdict["effects"][0]
    assert set(first) == {"name", "rotor", "parameters", "confidence", "ambiguous_with", "by_resamples"}
    assert "mass" in [first["name"], *first["ambiguous_with"]]
    mocap = verdict["channels"]["mocap"]
    assert set(mocap) == {"before", "after", "floor", "unit", "sensors", "fast_remainder"}
    assert mocap["after"] < 1.15 * mocap["floor"] < mocap["before"]
    assert set(verdict["fails_where"][0]) == {"regime", "low", "high", "channel", "rms_over_floor"}


def test_add_writes_the_next_vehicle_file_and_keeps_the_old_one(run, logs):
    before = (logs / "heavy.toml").read_bytes()
    code, shown, _ = run("add mass")
    assert code == 0
    assert "heavy.v2.toml" in shown.replace("\n", "")
    assert (logs / "heavy.toml").read_bytes() == before
    assert read_vehicle(logs / "heavy.v2.toml").history[0].action == "added mass"


def test_add_ends_with_3_when_the_held_out_error_does_not_fall(run, logs):
    code, _, message = run("add wind", vehicle="right.toml")
    assert code == 3
    assert "was not added" in message
    assert not (logs / "right.v2.toml").exists()


def test_add_without_an_effect_adds_the_first_one_and_writes_errors_before_and_after_as_json(run, logs, tmp_path):
    file, out = tmp_path / "added.json", tmp_path / "next.toml"
    code, shown, message = run("add", "--json", str(file), "--out", str(out), "--hold-out", "flight_2*")
    assert code == 0, message
    addition = json.loads(file.read_text())
    assert set(addition) == {
        "alula_version",
        "effect",
        "effects",
        "parameters",
        "channels",
        "misfit",
        "open_loop",
        "refused",
        "notes",
        "vehicle",
    }
    assert addition["vehicle"] == str(out)
    assert addition["misfit"]["after"] < 0.5 * addition["misfit"]["before"]
    assert [error["horizon"] for error in addition["open_loop"]["before"]] == [0.1, 0.5, 1.0]
    for before, after in zip(addition["open_loop"]["before"], addition["open_loop"]["after"], strict=True):
        assert after["velocity"] < before["velocity"]
    assert addition["effect"] in ("mass", "thrust_constant")  # which share 99.7 % of their signal
    assert addition["parameters"][addition["effect"]]["ratio"]["value"] == pytest.approx(1.0, abs=0.07)
    assert read_vehicle(out).effects[0].name == addition["effect"]
    assert "open loop" in shown


def test_add_without_an_effect_adds_nothing_to_a_model_that_explains_the_flights(run, logs):
    code, _, message = run("add", vehicle="right.toml")
    assert code == 3
    assert "the model explains these flights" in message
    assert not (logs / "right.v2.toml").exists()


def test_add_refuses_a_gust_with_the_reason(run):
    code, _, message = run("add gust")
    assert code == 3
    assert "no value in a vehicle file predicts it" in " ".join(message.split())


def test_add_needs_logs_and_an_effect_for_a_rotor(run):
    code, _, message = run("add mass", files=())
    assert code == 2
    assert "no log was given" in message
    code, _, message = run("add", "--rotor", "1")
    assert code == 2
    assert "Name the effect" in message


def test_compare_prints_channels_and_open_loop_errors(run):
    code, shown, _ = run("compare", "--json", "-")
    assert code == 0
    comparison = json.loads(shown)
    assert {axis["kind"] for axis in comparison["axes"]} == {"imu", "mocap", "angular", "attitude_rate"}
    assert [error["horizon"] for error in comparison["open_loop"]] == [0.1, 0.5, 1.0]
    assert comparison["open_loop"][0]["position"] < comparison["open_loop"][2]["position"]
    assert any(axis["rms"] > 1.5 * axis["floor"] for axis in comparison["axes"])


def test_compare_tries_an_effect_by_hand(run, logs, tmp_path):
    levels = []
    for number, options in enumerate(([], ["--with", f"mass:ratio={1 / 1.06}"])):
        file = tmp_path / f"{number}.json"
        code, _, _ = run("compare", "--json", str(file), *options)
        assert code == 0
        levels.append([axis["rms"] for axis in json.loads(file.read_text())["axes"] if axis["kind"] == "imu"])
    assert levels[1][2] < 0.8 * levels[0][2]  # the vertical axis
    code, _, message = run("compare", "--with", "mass:weight=1")
    assert code == 2
    assert "unknown parameter 'weight'" in message


def test_prove_compares_two_versions_on_held_out_flights_and_in_flight(run, logs, tmp_path):
    file, before = tmp_path / "proof.json", ["--before", str(logs / "heavy.toml")]
    code, shown, _ = run("prove", *before, "--fly", "hover", "--json", str(file), vehicle="right.toml")
    assert code == 0
    last = shlex.split(shown.splitlines()[-1].removeprefix("next: alula "))
    assert last[:5] == ["fly", "--vehicle", str(logs / "right.toml"), "--reference", "hover"]
    proof = json.loads(file.read_text())
    assert proof["channels"]["imu"]["after"] < 0.9 * proof["channels"]["imu"]["before"]
    assert proof["open_loop"]["after"][-1]["position"] < proof["open_loop"]["before"][-1]["position"]
    assert 0 < proof["flown"]["after"]["rmse"] < 0.03  # m
    assert proof["held_out"]


def test_prove_refuses_a_version_of_another_vehicle(run, arpl_250g, tmp_path):
    angles = np.radians([30, 90, 150, 210, 270, 330])
    places = tuple((float(0.2 * np.cos(angle)), float(0.2 * np.sin(angle)), 0.0) for angle in angles)
    rotors = msgspec.structs.replace(arpl_250g.rotors, position=places, spin=(1, -1) * 3, motor=())
    other = tmp_path / "hexa.toml"
    write_vehicle(msgspec.structs.replace(arpl_250g, rotors=rotors), other)
    code, _, message = run("prove", "--before", str(other), vehicle="right.toml")
    assert code == 2
    assert "has 6 rotors" in message
    assert "4" in message


def test_data_that_cannot_answer_end_with_3_and_wrong_requests_with_2(run, logs, tmp_path):
    short = Flight.read(logs / "flight_0.csv").rows(0, 500).to_csv(logs / "short.csv")
    code, _, message = run("diagnose", files=(short.name,))
    assert code == 3
    assert "Fly" in message
    code, _, message = run("add rotor_drg")
    assert code == 2
    assert "rotor_drag" in message
    code, _, _ = run("diagnose", files=("absent.csv",))
    assert code == 2
    code, _, message = run("diagnose", "--effects", str(tmp_path / "absent.py"))
    assert code == 2
    assert "is no file" in message
