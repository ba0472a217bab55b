"""Flights from the ground to the ground on the mock's estimators and grounds, in lockstep."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

from dynamics.references import named_reference
from runtime.flight.composition import Controllers
from runtime.flight.mission import Phase, Plan
from simulation.whole_flight import WholeFlight, fly_whole
from sitl_mock.mock import MockOptions
from sitl_mock.scenario import Scenario
from sitl_mock.vehicle.estimator import Estimator
from sitl_mock.vehicle.ground import Ground
from vehicles import FOLDER

FILE = FOLDER / "px4_sih.toml"
SHORT = Plan(height=1.0, duration=3.0, settle=0.3, origin="takeoff")
STEEPEST = radians(12.0)  # that a landing may tilt after contact


def fly(controllers: Controllers, **options: object) -> WholeFlight:
    reference = named_reference("circle", controllers.flying.trim)
    return fly_whole(MockOptions(FILE, **options), reference, plan=SHORT, controllers=controllers)  # type: ignore[arg-type]


@pytest.mark.parametrize("estimator", ["px4", "mocap", pytest.param("perfect", marks=pytest.mark.slow)])
def test_it_takes_off_tracks_and_lands(controllers: Controllers, estimator: Estimator) -> None:
    flight = fly(controllers, estimator=estimator, seed=21)
    assert flight.landed, flight.outcome
    assert flight.landing_reason == ""
    assert set(Phase) - {Phase.CONTACT, Phase.APPROACH, Phase.BRAKE} <= set(flight.phases)
    assert flight.tracking_error(flight.estimate) < (0.1 if estimator == "px4" else 0.03)
    assert flight.tilt_after_contact < STEEPEST
    assert flight.time[flight.contact] < flight.disarmed < flight.time[flight.contact] + 4.0
    assert np.isnan(flight.touched)


@pytest.mark.slow
def test_the_same_flight_has_the_same_bits(controllers: Controllers) -> None:
    first, again = (fly(controllers, seed=22) for _ in range(2))
    np.testing.assert_array_equal(first.truth, again.truth)


@pytest.mark.parametrize("error", [-1.5, 1.5])
def test_a_wrong_height_at_the_start_leads_into_no_ground(controllers: Controllers, error: float) -> None:
    flight = fly(controllers, start_height_error=error, seed=23)
    assert flight.landed, flight.outcome
    assert np.isnan(flight.touched)
    assert flight.tilt_after_contact < STEEPEST


@pytest.mark.parametrize(
    "ground",
    [
        Ground(kind="legs", slope=radians(15.0), uphill=0.6),
        Ground(kind="legs", heave=0.2, heave_period=5.0),
        Ground(kind="legs", speed=(0.3, 0.0), heave=0.15),
    ],
    ids=["slope of 15 degrees", "heaving deck", "deck that heaves and goes sideways"],
)
def test_it_takes_off_from_and_lands_on_whatever_it_stands_on(controllers: Controllers, ground: Ground) -> None:
    flight = fly(controllers, scenario=Scenario(ground=ground), seed=24)
    assert flight.landed, flight.outcome
    assert flight.tilt_after_contact - ground.slope < STEEPEST
