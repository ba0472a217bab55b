"""Whole flights on the mock with PX4's estimate, from ground and with faults that no flat test field has."""

from __future__ import annotations

from math import degrees, radians

import pytest

from dynamics.references import named_reference
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect, read_vehicle
from runtime.control.controller import ControllerOptions
from runtime.flight.composition import Controllers, build_controllers
from runtime.flight.mission import Phase, Plan
from simulation.ground_to_ground import GroundToGround, after_contact
from sitl_mock.vehicle.estimator import ERRORS
from sitl_mock.vehicle.ground import Ground
from sitl_mock.vehicle.vehicle import VehicleOptions

PLAN = Plan(height=1.2, duration=1.0, speed=2.5, acceleration=3.0, settle=0.3, origin="takeoff")


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return read_vehicle("vehicles/px4_sih.toml")


@pytest.fixture(scope="module")
def controllers(vehicle: Vehicle) -> Controllers:
    return build_controllers(vehicle, None, ControllerOptions.for_vehicle(vehicle, period=0.01))


def prepare(
    vehicle: Vehicle, controllers: Controllers, ground: Ground, *hidden: str, height_error: float | None = None
) -> GroundToGround:
    sensors, wander = ERRORS["px4"]
    return GroundToGround(
        vehicle,
        controllers,
        named_reference("hover:laps=1,height=1.2", vehicle),
        PLAN,
        effects=[parse_effect(text, vehicle.rotors.count) for text in hidden],
        options=VehicleOptions(sensors=sensors, wander=wander, ground=ground, start_height_error=height_error),
        seed=3,
        refusals=2,
    )


@pytest.mark.parametrize(
    ("ground", "height_error"),
    [
        (Ground(kind="sih"), 1.4),
        (Ground(kind="sih"), -1.4),
        (Ground(kind="legs", slope=radians(15.0), uphill=0.6), 0.5),
        (Ground(kind="legs", heave=0.2, heave_period=5.0), 0.5),
    ],
    ids=["height 1.4 m too large", "height 1.4 m too small", "slope of 15 degrees", "heaving deck"],
)
def test_it_takes_off_and_lands_whatever_it_stands_on(
    vehicle: Vehicle, controllers: Controllers, ground: Ground, height_error: float
) -> None:
    flight = prepare(vehicle, controllers, ground, height_error=height_error).fly(60.0)
    assert flight.outcome == "landed and disarmed"
    assert flight.landing_reason == ""
    contact, times, tilts = after_contact(flight)
    assert degrees(tilts.max() - ground.slope) < 12.0
    flown = [tick.height for tick in flight.ticks if tick.phase is Phase.TRACK]
    assert all(0.4 < height < 2.2 for height in flown)
    assert times[-1] - contact < 3.0


def test_with_a_propeller_missing_it_gives_up_on_the_ground(vehicle: Vehicle, controllers: Controllers) -> None:
    flight = prepare(vehicle, controllers, Ground(kind="legs"), "weak_rotor:rotor=1,loss=0.9").fly(30.0)
    assert {"takeoff_failed", "tipping"} & {event for _, event, _ in flight.events}
    assert flight.landing_reason
    assert max(tick.height for tick in flight.ticks) < 0.4
    assert not flight.ticks[-1].armed


def test_a_hand_that_holds_it_down_is_no_take_off(vehicle: Vehicle, controllers: Controllers) -> None:
    def hold(flown: GroundToGround) -> None:
        if flown.flyer.mission.phase is Phase.RAMP and flown.plant.time - flown.flyer.mission.phase_started < 0.015:
            flown.plant.hold(True)

    flight = prepare(vehicle, controllers, Ground(kind="legs")).fly(30.0, hold)
    assert flight.times("takeoff_failed")
    assert "is it held" in flight.landing_reason
    assert not flight.ticks[-1].armed
