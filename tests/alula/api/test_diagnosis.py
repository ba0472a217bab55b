"""Comparison, diagnosis and addition from Python: files or flights, results that hold what the commands print."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

import alula
from dynamics.vehicle import Vehicle
from fixtures.planted import planted_flights

MANOEUVRES = ("line:laps=3,ramp=1", "circle:laps=2,ramp=1,speed=1.2", "Lemniscate:laps=3,ramp=1.5,speed=0.9")


@pytest.fixture(scope="module")
def heavy(arpl_250g: Vehicle) -> Vehicle:
    """A vehicle file that claims 6 % more than the vehicle weighs."""
    body = msgspec.structs.replace(arpl_250g.body, mass=1.06 * arpl_250g.body.mass)
    return msgspec.structs.replace(arpl_250g, body=body)


@pytest.fixture(scope="module")
def logs(arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for place, flight in enumerate(planted_flights(arpl_250g, [], seed=5, manoeuvres=MANOEUVRES)):
        flight.to_csv(folder / f"flight_{place}.csv")
    return folder


def test_logs_and_the_flights_in_them_give_the_same_report(logs: Path, heavy: Vehicle, tmp_path: Path) -> None:
    flights = alula.read_flights(logs)
    result = alula.compare(flights, heavy)
    assert result.report == alula.compare(logs, heavy).report
    result.write_json(tmp_path / "comparison.json")
    written = msgspec.json.decode((tmp_path / "comparison.json").read_bytes(), type=type(result.report))
    assert written == result.report
    with pytest.raises(alula.RequestError, match="logs and flights are mixed"):
        alula.compare([*flights, logs / "flight_0.csv"], heavy)


def test_what_diagnosis_names_is_added_and_written_as_the_next_version(
    logs: Path, heavy: Vehicle, tmp_path: Path
) -> None:
    alula.write_vehicle(heavy, tmp_path / "heavy.toml")
    verdict = alula.diagnose(logs, heavy, hold_out="flight_2*")
    assert verdict.report.verdict in ("effect", "ambiguous")
    assert verdict.report.effects[0].name in verdict.sentence
    result = alula.add_effect(logs, tmp_path / "heavy.toml", hold_out="flight_2*")
    assert result.report.effect == verdict.report.effects[0].name
    written = result.write_next_version(tmp_path / "heavy.toml")
    assert written.name == "heavy.v2.toml"
    assert alula.load_vehicle(written) == result.vehicle
    assert result.vehicle.history[-1].command
    with pytest.raises(alula.RequestError, match="never overwritten"):
        result.write(written)


def test_a_rotor_needs_an_effect_and_an_unknown_effect_is_refused(logs: Path, heavy: Vehicle) -> None:
    with pytest.raises(alula.RequestError, match="Name the effect"):
        alula.add_effect("absent", heavy, rotor=1)
    with pytest.raises(alula.RequestError, match="rotor_drag"):
        alula.add_effect(logs, heavy, "rotor_drg")
