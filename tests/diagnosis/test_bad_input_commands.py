"""Bad input through the command line: exit code 3 and what to do, before any model is judged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import write_vehicle
from fixtures.joined_flights import joined_flights
from flights import Flight
from tests.diagnosis.conftest import with_columns
from tests.support.command_line import Run, command_line

ROTORS = range(4)
POSE = ("position", "velocity", "attitude")
Change = Callable[[Flight], Flight]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.fixture
def refused(run: Run, plain_flights: list[Flight], arpl_250g: Vehicle, tmp_path: Path) -> Callable[..., str]:
    """The message of `alula diagnose` on changed flights and a changed vehicle file; it must end with exit code 3."""

    def message(change: Change = lambda flight: flight, vehicle: Vehicle = arpl_250g, count: int = 6) -> str:
        file = tmp_path / "vehicle.toml"
        write_vehicle(vehicle, file)
        logs = [change(f).to_csv(tmp_path / f"flight_{i}.csv") for i, f in enumerate(plain_flights[:count])]
        code, shown, wrong = run("diagnose", *logs, "--vehicle", file)
        assert (code, shown) == (3, "")
        return wrong

    return message


def scaled(factor: float, *columns: str) -> Change:
    return lambda flight: with_columns(flight, {name: factor * flight[name] for name in columns})


def without(*quantities: str) -> Change:
    def change(flight: Flight) -> Flight:
        return with_columns(flight, {c: None for c in flight.columns if c.startswith(quantities)})

    return change


def commands(flight: Flight, vehicle: Vehicle) -> Flight:
    """Motor signals in place of rotor speeds."""
    signals = {f"rotor_command_{i}": flight[f"rotor_speed_{i}"] / vehicle.rotors.speed_max for i in ROTORS}
    return with_columns(without("rotor_")(flight), signals)


def weighing(vehicle: Vehicle, factor: float) -> Vehicle:
    body = msgspec.structs.replace(vehicle.body, mass=factor * vehicle.body.mass)
    return msgspec.structs.replace(
        vehicle, body=body, rotors=msgspec.structs.replace(vehicle.rotors, thrust_constant=4e-7, speed_max=2600.0)
    )


def dead_without_commands(flight: Flight) -> Flight:
    return without("rotor_command")(scaled(0.0, "rotor_speed_2")(flight))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.rows(200, 500), ["6 s of flight are too few", "Fly at least 20 s"]),
        (lambda f: replace_rows(f, 5), ["20 rows a second", "Wanted 40 Hz"]),
        (without("rotor_"), ["Wanted rotor speeds, motor commands"]),
        (without("rate", "specific_force", "attitude"), ["it lacks attitude, gyro, accelerometer", "--normal"]),
        (scaled(30 / np.pi, *(f"rotor_speed_{i}" for i in ROTORS)), ["in rpm"]),
        (scaled(180 / np.pi, *(f"rate_{a}" for a in "xyz")), ["deg/s"]),
        (scaled(1 / 9.81, *(f"specific_force_{a}" for a in "xyz")), ["in g"]),
        (
            scaled(1000.0, *(f"{q}_{a}" for q in POSE[:2] for a in "xyz")),
            ["the velocity is in mm/s", "the position is in mm"],
        ),
        (scaled(-1.0, "rate_y", "rate_z"), ["the gyro is in FRD axes"]),
        (
            dead_without_commands,
            ["rotor 2 (back right; ", "reads 0.00 times the speed", "rotor_speed_fault"],
        ),
    ],
    ids=["short", "slow", "motors", "lacking", "rpm", "degrees", "g", "millimetres", "frames", "dead"],
)
def test_flights_that_cannot_answer_are_refused_with_what_to_do(refused, change: Change, words: list[str]) -> None:
    wrong = refused(change, count=2 if "Fly at least 20 s" in words else 6)
    assert all(word in wrong for word in words), wrong


def replace_rows(flight: Flight, every: int) -> Flight:
    columns = {name: values[::every] for name, values in flight.columns.items()}
    return Flight(flight.time[::every], columns, flight.provenance)


def test_degrees_are_noticed_without_an_attitude_and_below_a_gyroscopes_limit_too(refused) -> None:
    slowly = scaled(0.45 * 180 / np.pi, *(f"rate_{a}" for a in "xyz"))
    assert "degrees for radians" in refused(lambda flight: slowly(without(*POSE)(flight)))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_mass_that_is_off_by_two_is_noticed(refused, arpl_250g: Vehicle, factor: float) -> None:
    assert "Check mass" in refused(vehicle=weighing(arpl_250g, factor))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_mass_that_is_off_by_two_is_noticed_with_commands_alone(refused, arpl_250g: Vehicle, factor: float) -> None:
    vehicle = weighing(arpl_250g, factor)
    assert "Check mass" in refused(lambda f: commands(f, vehicle), vehicle)


@pytest.mark.parametrize("commanded", [False, True])
def test_another_order_of_rotors_is_named(refused, arpl_250g: Vehicle, commanded: bool) -> None:
    order = [2, 0, 3, 1]  # the file's rotor i is the log's column order[i]

    def shuffled(flight: Flight) -> Flight:
        speeds = {f"rotor_speed_{column}": flight[f"rotor_speed_{i}"] for i, column in enumerate(order)}
        mixed = with_columns(flight, speeds)
        return commands(mixed, arpl_250g) if commanded else mixed

    assert "columns [2, 0, 3, 1] are the file's rotors [0, 1, 2, 3]" in refused(shuffled)


def test_rotors_that_turn_the_other_way_are_noticed(refused, arpl_250g: Vehicle) -> None:
    turned = msgspec.structs.replace(arpl_250g.rotors, spin=tuple(-s for s in arpl_250g.rotors.spin))
    assert "Turn the signs of [rotors] spin" in refused(vehicle=msgspec.structs.replace(arpl_250g, rotors=turned))


def test_an_inertia_in_another_unit_is_noticed(refused, arpl_250g: Vehicle) -> None:
    body = msgspec.structs.replace(arpl_250g.body, inertia=tuple(20 * j for j in arpl_250g.body.inertia))
    assert "Check inertia" in refused(vehicle=msgspec.structs.replace(arpl_250g, body=body))


def test_copies_of_one_flight_are_no_flights(refused, plain_flights: list[Flight]) -> None:
    assert "one and the same" in refused(lambda _: plain_flights[0])


def test_one_flight_and_a_log_without_imu_are_answered_with_notes_on_what_is_missing(
    run: Run, plain_flights: list[Flight], tmp_path: Path
) -> None:
    """One recording with an interruption."""
    parts = [without("rate", "specific_force")(f) for f in plain_flights[4:6]]
    log = joined_flights(parts).to_csv(tmp_path / "log.csv")
    code, shown, _ = run("diagnose", log, "--vehicle", "arpl_250g")
    assert code == 0
    for words in ("no accelerometer in the log", "no gyro in the log", "one flight only"):
        assert words in shown
    assert not shown.startswith("effect")
