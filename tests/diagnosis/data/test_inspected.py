"""What inspection doubts is not diagnosed: a wrong speed sensor, a column that stands still."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.data.dataset import make_dataset, read_dataset
from diagnosis.data.rotor_moments import compared_moments, rotor_gains
from dynamics.errors import DataError
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from fixtures.outside_cases import Campaign, captured_flights, flown, vehicle_of
from fixtures.outside_draws import Draw, written
from fixtures.outside_sensors import Recorder
from fixtures.planted import planted_flights
from flights.exclusion import free_flight
from flights.quality.rotor_balance import uneven_rotors
from tests.diagnosis.conftest import MANOEUVRES, with_columns

COMMANDS = {f"rotor_command_{i}": None for i in range(4)}


def test_a_doubted_speed_sensor_is_replaced_by_the_commands_and_named(changed, arpl_250g):
    dataset = make_dataset(changed(rotor_speed_1=lambda old: old / 3), arpl_250g)
    assert {segment.rotor_source for segment in dataset.everything} == {"command"}
    (note,) = [note for note in dataset.notes if "rotor_speed_fault" in note]
    assert "rotor 1 reads 0.33 times the speed of its peers" in note
    assert {finding.name for finding in dataset.findings} == {"rotor_speed_fault"}


@pytest.mark.parametrize(("rotor", "gain"), [(1, 1 / 3), (3, 0.7), (0, 1.5)])
def test_without_commands_it_is_refused_by_name(changed, arpl_250g, rotor, gain):
    wrong = changed(**{f"rotor_speed_{rotor}": lambda old: gain * old})
    with pytest.raises(DataError, match=rf"rotor {rotor} \(.*\) reads {gain:.2f} times.*rotor_speed_fault"):
        make_dataset([with_columns(flight, COMMANDS) for flight in wrong], arpl_250g)


def test_rotors_that_turn_unevenly_for_a_load_off_the_centre_are_used(arpl_250g):
    moved = [EffectUse("centre_of_mass", {"x": 0.025, "y": 0.025})]
    flights = planted_flights(arpl_250g, moved, seed=7, manoeuvres=MANOEUVRES[:4])
    bare = [with_columns(flight, COMMANDS) for flight in flights]
    uneven = {rotor.rotor for flight in bare for rotor in uneven_rotors(free_flight(flight))}
    assert uneven
    assert make_dataset(bare, arpl_250g).fitted[0].rotor_source == "measured"


def test_rotors_that_hold_a_canted_one_are_used():
    """One flight about one axis does not tell the moments of opposite rotors apart, and was refused for a sensor."""
    canted = {"rotor_cant": {"tangential": -0.0657, "radial": 0.0155, "rotor": 0.0}}
    recorder = Recorder(100.0, noise=0.5864196107357226)
    campaign = Campaign(canted, {}, recorder, lag_declared=False, fast=False, flights=4, seed=913936977)
    (truths,) = flown([campaign])
    flights = captured_flights(campaign, truths)
    shares = [round(rotor.share, 1) for flight in flights for rotor in uneven_rotors(free_flight(flight))]
    assert shares == [1.3, 0.8, 1.3, 0.8] * 4
    assert make_dataset(flights, vehicle_of(campaign)).fitted[0].rotor_source == "measured"


@pytest.mark.parametrize(
    "draw",
    [
        Draw("nothing", "estimator", 108001),
        Draw("estimator", "mass", 100000),
        Draw("estimator", "motor_lag", 109001),
        Draw("estimator", "rotor_drag", 120000),
    ],
    ids=lambda draw: draw.key,
)
def test_an_estimators_errors_are_no_other_clock_and_no_other_hand(draw, tmp_path):
    """Velocities were on another clock by 1.6 s, for 0.91 against 0.84, or by 0.08 s, for 0.97 against 0.95, and axes
    left-handed for 0.52 against 0.50."""
    logs = written(draw, tmp_path)
    assert read_dataset(logs, read_vehicle(tmp_path / "vehicle.toml")).fitted


def test_the_moments_show_each_rotors_gain(changed, arpl_250g):
    dataset = make_dataset(changed(rotor_speed_3=lambda old: 0.9 * old), arpl_250g)
    gains = rotor_gains(compared_moments(dataset.everything, arpl_250g), arpl_250g)
    np.testing.assert_allclose(gains, [1, 1, 1, 0.9**-2], rtol=0.03)


def test_rows_in_which_a_column_stands_still_are_left_out(plain_flights, arpl_250g):
    def frozen(flight):
        speed = flight["rotor_speed_2"].copy()
        speed[-1200:] = speed[-1200]
        return with_columns(flight, {"rotor_speed_2": speed})

    longest = max(plain_flights, key=len)
    others = [flight for flight in plain_flights if flight is not longest]
    dataset = make_dataset([frozen(longest), *others], arpl_250g)
    used = sum(s.duration for s in dataset.everything if s.flight == longest.provenance.path)
    assert used < longest.duration - 1200 * longest.period
    assert any("rotor_speed_2 stands at" in note for note in dataset.notes)


def test_flights_whose_accelerometer_stands_still_are_refused_with_the_column(changed, arpl_250g):
    with pytest.raises(DataError, match=r"specific_force_x stands at 0\.3 m/s\^2"):
        make_dataset(changed(specific_force_x=lambda old: np.full_like(old, 0.3)), arpl_250g)


def test_units_that_contradict_the_motion_are_refused_whatever_the_flights_were_read_from(changed, arpl_250g):
    with pytest.raises(DataError, match=r"flight_0.*about y stands still while the attitude turns"):
        make_dataset(changed(rate_y=lambda old: np.full_like(old, 0.3)), arpl_250g)


def test_healthy_flights_have_no_findings(plain_flights, arpl_250g):
    assert make_dataset(plain_flights, arpl_250g).findings == ()


@pytest.mark.parametrize("volts", [0.0, 1.5])
def test_a_battery_that_sags_to_nothing_is_not_used(plain_flights, arpl_250g, volts):
    def sagging(flight):
        return with_columns(flight, {"battery_voltage": np.linspace(8.0, volts, len(flight))})

    dataset = make_dataset([sagging(flight) for flight in plain_flights], arpl_250g)
    assert all(segment.battery_ratio is None for segment in dataset.everything)
    assert any("not a plausible pack voltage in flight" in note for note in dataset.notes)


def test_what_some_flights_lack_is_noted_with_their_number(plain_flights, arpl_250g):
    bare = {f"specific_force_{a}": None for a in "xyz"}
    dataset = make_dataset([*plain_flights[:4], *(with_columns(f, bare) for f in plain_flights[4:])], arpl_250g)
    assert any("no accelerometer in the log" in note and "in 2 of 6 flights" in note for note in dataset.notes)
