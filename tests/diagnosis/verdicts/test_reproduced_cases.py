"""Wrong answers that were given once and are not given again, on the outside simulator's flights and on real logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagnosis.addition import add_effect
from diagnosis.data.dataset import Dataset, make_dataset, read_dataset
from diagnosis.data.rotor_moments import require_rotor_moments
from diagnosis.diagnose import diagnose_dataset
from diagnosis.report import Diagnosis
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import write_vehicle
from fixtures.mutated_flights import with_columns
from fixtures.outside_cases import LAYOUTS, Campaign, captured_flights, flown, sized, vehicle_of
from fixtures.outside_effects import Hidden
from fixtures.outside_sensors import Recorder
from fixtures.real_flights import DATA, px4_nominal
from flights import Flight
from tests.support.command_line import command_line

SEEDS = {  # of a vehicle of each layout
    layout: next(s for s in range(100) if Campaign({}, {}, Recorder(), False, False, 1, s).layout == layout)
    for layout in LAYOUTS
}


def flights_of(campaign: Campaign) -> list[Flight]:
    """The campaign's flights as they are logged."""
    (truths,) = flown([campaign])
    assert truths is not None
    return captured_flights(campaign, truths)


def diagnosed(flights: list[Flight], vehicle: Vehicle) -> Diagnosis:
    """By the whole catalogue."""
    return diagnose_dataset(make_dataset(flights, vehicle), vehicle, CATALOGUE).diagnosis


@pytest.mark.parametrize("layout", LAYOUTS)
def test_of_fast_flights_the_one_hidden_drag_is_named_alone(layout: str) -> None:
    """It was `unknown`: an inertia wrong by 0.7 % stood beside the drag."""
    plain = Campaign({}, {}, Recorder(), lag_declared=False, fast=True, flights=4, seed=SEEDS[layout])
    hidden = {"rotor_drag": sized("rotor_drag", plain.frame, np.random.default_rng(plain.seed))}
    campaign = replace(plain, hidden=hidden)
    diagnosis = diagnosed(flights_of(campaign), vehicle_of(campaign))
    assert diagnosis.verdict in ("effect", "ambiguous")
    assert [effect.name for effect in diagnosis.effects] == ["rotor_drag"]
    coefficient = diagnosis.effects[0].parameters["coefficient"].value
    assert coefficient == pytest.approx(hidden["rotor_drag"]["coefficient"], rel=0.01)


@pytest.fixture(scope="module", params=LAYOUTS)
def quiet(request: pytest.FixtureRequest) -> tuple[Dataset, Vehicle]:
    """Commands with little noise and nothing hidden, and the vehicle."""
    recorder = Recorder(commands=True, noise=0.1)
    campaign = Campaign({}, {}, recorder, lag_declared=True, fast=False, flights=4, seed=SEEDS[request.param])
    vehicle = vehicle_of(campaign)
    return make_dataset(flights_of(campaign), vehicle), vehicle


def test_quiet_logs_of_commands_with_nothing_hidden_are_explained(quiet: tuple[Dataset, Vehicle]) -> None:
    """Of ten, three named a rotor's inertia of zero."""
    diagnosis = diagnose_dataset(*quiet, CATALOGUE).diagnosis
    assert diagnosis.verdict == "explained"
    assert diagnosis.effects == ()


def test_a_rotors_inertia_that_may_be_zero_is_not_added_by_name_either(quiet: tuple[Dataset, Vehicle]) -> None:
    with pytest.raises(DataError, match="rotor_gyroscopic was not added: "):
        add_effect("rotor_gyroscopic", *quiet, CATALOGUE, date="2026-01-02")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_propeller_that_lost_thrust_and_torque_is_no_speed_sensor_alone(layout: str) -> None:
    """It was a wrong speed sensor without a rival, so that its owner flew the broken propeller again."""
    hidden: Hidden = {"lost_propeller": {"loss": 0.08, "rotor": 2.0}}
    campaign = Campaign(hidden, {}, Recorder(), lag_declared=False, fast=False, flights=4, seed=SEEDS[layout])
    diagnosis = diagnosed(flights_of(campaign), vehicle_of(campaign))
    assert diagnosis.verdict in ("effect", "ambiguous")
    (effect,) = diagnosis.effects
    assert (effect.name, effect.rotor) == ("weak_rotor", 2)
    assert "rotor_speed_fault" in effect.ambiguous_with
    for name in ("loss", "torque_loss"):
        assert effect.parameters[name].value == pytest.approx(0.08, abs=0.002)


def test_a_sensor_that_reads_too_low_is_no_propeller() -> None:
    """No rotor gains thrust."""
    hidden: Hidden = {"rotor_speed_fault": {"gain": 0.95, "rotor": 1.0}}
    campaign = Campaign(hidden, {}, Recorder(), lag_declared=False, fast=False, flights=4, seed=SEEDS["x"])
    diagnosis = diagnosed(flights_of(campaign), vehicle_of(campaign))
    (effect,) = diagnosis.effects
    assert (effect.name, effect.rotor) == ("rotor_speed_fault", 1)
    assert effect.parameters["gain"].value == pytest.approx(0.95, abs=0.002)


def test_rotors_that_answer_what_yaws_the_vehicle_turn_the_right_way() -> None:
    """A right file was refused: drag off the centre of mass yaws this vehicle five times as strongly as its rotors."""
    hidden: Hidden = {
        "parasitic_drag": {"coefficient": 0.015746614231786155},
        "centre_of_mass": {"x": -0.0018666400589965745, "y": 0.008334570806390027},
        "rotational_damping": {"coefficient": 0.004156537319129529},
        "blade_flapping": {"coefficient": 1.0959514081245313e-06},
        "rotor_drag": {"coefficient": 2.7351975252961494e-05},
    }
    recorder = Recorder(200.0, noise=1.836626486498121)
    campaign = Campaign(hidden, {}, recorder, lag_declared=False, fast=False, flights=9, seed=49728483)
    vehicle = vehicle_of(campaign)
    data = make_dataset(flights_of(campaign), vehicle)
    assert require_rotor_moments(data.everything, vehicle) == ()


def test_one_flights_turbulence_doubts_no_speed_sensor() -> None:
    """A canted rotor turns its neighbour at 0.79 of the others' speed; in one flight moments looked like a fault."""
    hidden: Hidden = {
        "rotor_cant": {"tangential": 0.06736091862075942, "radial": 0.03050517477623028, "rotor": 3.0},
        "rotor_gyroscopic": {"inertia": 1.6984406172726995e-05},
        "axial_inflow": {"coefficient": 0.000129413720131842},
        "thrust_constant": {"ratio": 1.069657938102059},
        "blade_flapping": {"coefficient": 2.0199645603151207e-06},
        "centre_of_mass": {"x": -0.0015080059572509328, "y": -0.006630473474150594},
        "rotor_drag": {"coefficient": 7.103806983651235e-05},
    }
    recorder = Recorder(100.0, noise=1.3303905394572888)
    campaign = Campaign(hidden, {}, recorder, lag_declared=False, fast=False, flights=9, seed=374580846)
    data = make_dataset(flights_of(campaign), vehicle_of(campaign))
    assert data.fitted[0].rotor_source == "measured"


@pytest.fixture(scope="module")
def sound() -> tuple[list[Flight], Vehicle]:
    """Flights that hold rotor speeds and commands, and their vehicle, whose file knows its drag and lag."""
    frame = Campaign({}, {}, Recorder(), False, False, 1, SEEDS["x"]).frame
    drag: Hidden = {"rotor_drag": sized("rotor_drag", frame, np.random.default_rng(1))}
    campaign = Campaign({}, drag, Recorder(), lag_declared=True, fast=False, flights=4, seed=SEEDS["x"])
    (truths,) = flown([campaign])
    assert truths is not None
    by_command = captured_flights(replace(campaign, recorder=Recorder(commands=True)), truths)
    flights = [
        with_columns(flight, {name: other[name] for name in commands(other)})
        for flight, other in zip(captured_flights(campaign, truths), by_command, strict=True)
    ]
    return flights, vehicle_of(campaign)


def commands(flight: Flight) -> list[str]:
    """The columns of the motors' commands."""
    return [name for name in flight.columns if name.startswith("rotor_speed_command_")]


def with_a_third(flight: Flight, rotor: int) -> Flight:
    """The flight whose sensor of one rotor reads a third."""
    name = f"rotor_speed_{rotor}"
    return with_columns(flight, {name: flight[name] / 3})


@pytest.mark.parametrize("rotor", range(4))
def test_a_speed_sensor_that_reads_a_third_is_not_believed(sound: tuple[list[Flight], Vehicle], rotor: int) -> None:
    """It was a centre of mass beside a wrong sensor of the opposite rotor."""
    flights, vehicle = sound
    wrong = [with_columns(with_a_third(f, rotor), dict.fromkeys(commands(f))) for f in flights]
    with pytest.raises(DataError, match=rf"rotor {rotor} \(.*\) reads 0\.33 times.*rotor_speed_fault"):
        make_dataset(wrong, vehicle)


def test_beside_commands_it_is_left_out_and_said_and_nothing_is_named(sound: tuple[list[Flight], Vehicle]) -> None:
    flights, vehicle = sound
    dataset = make_dataset([with_a_third(flight, 1) for flight in flights], vehicle)
    assert {segment.rotor_source for segment in dataset.everything} == {"speed_command"}
    assert any("no measured rotor speed is used" in n and "rotor 1 reads 0.33 times" in n for n in dataset.notes)
    assert diagnose_dataset(dataset, vehicle, CATALOGUE).diagnosis.effects == ()


def in_the_world(flight: Flight) -> dict[str, Floats]:
    """Specific force along world axes."""
    turned = quaternion.rotate(flight["attitude"], flight["specific_force"])
    return {f"specific_force_{axis}": turned[:, i] for i, axis in enumerate("xyz")}


def in_millimetres(flight: Flight) -> dict[str, Floats]:
    """Positions in mm."""
    return {f"position_{axis}": 1000 * flight[f"position_{axis}"] for axis in "xyz"}


def of_another_time(flight: Flight) -> dict[str, Floats]:
    """Rotor speeds from the last to the first."""
    return {name: flight[name][::-1] for name in (f"rotor_speed_{i}" for i in range(4))}


def as_it_is(_: Flight) -> dict[str, Floats]:
    """Nothing is changed."""
    return {}


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (as_it_is, 0, ""),
        (in_the_world, 3, "world axes"),
        (in_millimetres, 3, "position is in mm"),
        (of_another_time, 3, "they say nothing about moments"),
    ],
)
def test_logs_of_wrong_axes_units_or_speeds_are_refused_and_sound_ones_are_not(
    sound: tuple[list[Flight], Vehicle],
    change: Callable[[Flight], dict[str, Floats]],
    code: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """All were accepted without a word."""
    flights, vehicle = sound
    write_vehicle(vehicle, tmp_path / "vehicle.toml")
    logs = [
        with_columns(f, {**dict.fromkeys(commands(f)), **change(f)}).to_csv(tmp_path / f"flight_{i}.csv")
        for i, f in enumerate(flights)
    ]
    run = command_line(monkeypatch, capsys)
    ended, shown, wrong = run("diagnose", *logs, "--vehicle", tmp_path / "vehicle.toml")
    assert ended == code, shown + wrong
    assert words in wrong
    assert bool(shown) == (code == 0)


def test_a_file_without_effects_is_completed_from_a_real_flight_and_no_error_rises() -> None:
    """A damping was added with which the error of held-out angular acceleration rose from 6.2 to 6.5 rad/s^2."""
    vehicle = px4_nominal()
    dataset = read_dataset([str(DATA / "px4_sih_flights" / "textbook_1_circle.ulg.gz")], vehicle)
    added = add_effect(None, dataset, vehicle, CATALOGUE, date="2026-01-02")
    values = {use.name: use.parameters for use in added.vehicle.effects}
    assert set(added.keys) == set(values) == {"rotational_damping", "linear_drag", "motor_lag"}
    assert all(key in added.vehicle.history[-1].action for key in added.keys)
    assert values["linear_drag"]["coefficient"] == pytest.approx(1.0, rel=0.05)
    assert values["motor_lag"]["time_constant"] == pytest.approx(0.05, rel=0.1)
    assert all(change.after <= 1.01 * change.before for change in added.channels.values())
    assert all(
        getattr(now, name) <= 1.01 * getattr(was, name)
        for was, now in zip(*added.open_loop, strict=True)
        for name in ("position", "velocity", "attitude", "rate")
    )
    with pytest.raises(DataError, match="nothing was added"):
        add_effect(None, dataset, added.vehicle, CATALOGUE, date="2026-01-02")
