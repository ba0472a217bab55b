"""Flights from the ground to the ground on the mock's estimators and grounds, in lockstep."""

from __future__ import annotations

from math import radians
from pathlib import Path

import numpy as np
import pytest

from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.composition import Controllers
from runtime.flight.events import Event
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from simulation.whole_flight import RotorMessage, WholeFlight, fly_whole
from sitl_mock.autopilot.fault_schedule import Fault
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


@pytest.mark.slow
def test_a_small_vehicle_with_motors_of_90_ms_hovers_with_a_price_on_its_body_rates(tmp_path: Path) -> None:
    """Its rate loop follows 0.2 s late; with the usual weight the controller outruns it."""
    file = tmp_path / "arpl_250g.toml"
    lag = '[[effects]]\nname = "motor_lag"\n[effects.parameters]\ntime_constant = 0.09\n'
    price = "[controller]\nrate_weight = [1.0, 1.0, 0.05]\n"
    file.write_text(f"{(FOLDER / 'arpl_250g.toml').read_text()}\n{price}\n{lag}")
    vehicle = read_vehicle(file)
    reference = named_reference("hover", vehicle)
    flight = fly_whole(
        MockOptions(file, seed=26), reference, plan=SHORT, controllers=Controllers(Controller.build(vehicle))
    )
    assert flight.landed, flight.outcome
    assert flight.tracking_error(flight.truth) < 0.05


@pytest.mark.parametrize("message", ["ESC_STATUS", "SERVO_OUTPUT_RAW"])
def test_a_rotor_that_loses_thrust_is_named_from_the_autopilot_s_messages(message: RotorMessage) -> None:
    """Revolutions a minute that ESCs report, or pulses behind the motors' lag; with PX4's estimator."""
    vehicle = read_vehicle(FILE)
    options = ControllerOptions.for_vehicle(vehicle, adaptation=AdaptationSettings(mode="on"))
    controller = Controller.build(vehicle, options)
    rotor = EffectUse("weak_rotor", {"loss": 0.0, "torque_loss": 0.0}, 1)
    fault = Fault(kind="effect", at=6.0, after="takeoff", values={f"{rotor.label}.loss": 0.15})
    flight = fly_whole(
        MockOptions(FILE, scenario=Scenario(effects=(rotor,), faults=(fault,)), estimator="px4", seed=4),
        named_reference("circle", vehicle, duration=8.0),
        plan=Plan(height=1.5, settle=0.3, origin="takeoff"),
        controllers=Controllers(controller),
        rotors=message,
    )
    assert flight.landed
    ((_, _, text),) = [raised for raised in flight.events if raised[1] is Event.ROTOR_WEAK]
    assert text.startswith("rotor 1 (motor 2) has lost 1")
    assert controller.adaptation is not None
    assert controller.adaptation.rotors is not None
    (loss,) = controller.adaptation.rotors.losses
    assert abs(loss.share - 0.15) < 2.5 * loss.deviation


def test_a_contact_in_the_tick_that_ends_the_flight_has_touched() -> None:
    phases = [Phase.CLIMB, Phase.TRACK, Phase.TRACK, Phase.TOUCHDOWN]
    flown = WholeFlight(time=[0.0, 0.1, 0.2, 0.3], phases=phases, ground_force=[0.0, 0.0, 0.0, 1.0])
    assert flown.touched == 0.3
    flown.ground_force[-1] = 0.0
    assert np.isnan(flown.touched)
