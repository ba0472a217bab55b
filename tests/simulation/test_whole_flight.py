"""Flights from the ground to the ground on the mock's estimators and grounds, in lockstep."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynamics.references import named_reference
from runtime.flight.composition import Controllers
from runtime.flight.mission import Phase, Plan
from simulation.whole_flight import WholeFlight, fly_whole
from sitl_mock.mock import MockOptions
from sitl_mock.vehicle.estimator import Estimator
from vehicles import FOLDER

FILE = FOLDER / "px4_sih.toml"
SHORT = Plan(height=1.0, duration=3.0, settle=0.3, origin="takeoff")
STEEPEST = np.radians(12.0)  # that a landing may tilt after contact


def fly(controllers: Controllers, **options: object) -> WholeFlight:
    reference = named_reference("circle", controllers.flying.trim)
    return fly_whole(MockOptions(FILE, **options), reference, plan=SHORT, controllers=controllers)  # type: ignore[arg-type]


@pytest.mark.parametrize("estimator", ["px4", "mocap", pytest.param("perfect", marks=pytest.mark.slow)])
def test_it_takes_off_tracks_and_lands(controllers: Controllers, estimator: Estimator) -> None:
    flight = fly(controllers, estimator=estimator, seed=21)
    assert flight.landed, flight.outcome
    assert set(Phase) - {Phase.CONTACT, Phase.APPROACH, Phase.BRAKE} <= set(flight.phases)
    assert flight.tracking_error(flight.estimate) < (0.1 if estimator == "px4" else 0.03)
    assert flight.tilt_after_contact < STEEPEST
    assert flight.time[flight.contact] < flight.disarmed < flight.time[flight.contact] + 4.0
    assert not flight.touched_in_flight


@pytest.mark.slow
def test_the_same_flight_has_the_same_bits(controllers: Controllers) -> None:
    first, again = (fly(controllers, seed=22) for _ in range(2))
    np.testing.assert_array_equal(first.truth, again.truth)


@pytest.mark.parametrize("error", [-1.5, 1.5])
def test_a_wrong_height_at_the_start_leads_into_no_ground(controllers: Controllers, error: float) -> None:
    flight = fly(controllers, start_height_error=error, seed=23)
    assert flight.landed, flight.outcome
    assert not flight.touched_in_flight
    assert flight.tilt_after_contact < STEEPEST


def test_it_leaves_a_slope_and_lands_on_it(controllers: Controllers) -> None:
    flight = fly(controllers, slope=10.0, seed=24)
    assert flight.landed, flight.outcome
    assert flight.tilt_after_contact < STEEPEST


def test_it_lands_on_a_deck_that_heaves(controllers: Controllers, tmp_path: Path) -> None:
    deck = tmp_path / "deck.toml"
    deck.write_text('ground = { kind = "legs", speed = [0.3, 0.0], heave = 0.15, heave_period = 6.0 }')
    flight = fly(controllers, scenario=deck, seed=25)
    assert flight.landed, flight.outcome
    assert flight.tilt_after_contact < STEEPEST
