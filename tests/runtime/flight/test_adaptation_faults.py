"""A model that follows in flight stays bounded under bad input, names it, and never makes the vehicle swing."""

from collections.abc import Callable

import numpy as np
import pytest

from dynamics.references import named_reference
from dynamics.state import POSITION
from dynamics.vehicle import Vehicle
from runtime.control.adaptation_settings import AdaptationSettings, Mode
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.events import Event
from runtime.flight.phases import Phase
from runtime.flight.thrust import ThrustMap
from tests.support.rate_controlled_vehicle import Flight

WIND = np.array([1.5, 0.0, 0.0])  # m/s^2
LIMIT = AdaptationSettings().linear.limit
SWINGS = {Event.MODEL_OSCILLATES, Event.SETPOINT_REFUSED, Event.CRASHED, Event.OVERTURNED}


def flight_in_wind(
    vehicle: Vehicle, reference: str = "circle:laps=6,speed=1.5", mode: Mode = "on", follow: tuple[str, ...] = ()
) -> Flight:
    """A flight that is about to begin."""
    options = ControllerOptions.for_vehicle(vehicle, adaptation=AdaptationSettings(mode=mode, follow=follow))
    controller = Controller.build(vehicle, options)
    flight = Flight(vehicle, controller, named_reference(reference, vehicle, duration=40.0))
    flight.plant.disturbance = WIND.copy()
    return flight


def in_wind(vehicle: Vehicle, reference: str = "circle:laps=6,speed=1.5", follow: tuple[str, ...] = ()) -> Flight:
    """A flight that has followed its disturbance for some seconds."""
    flight = flight_in_wind(vehicle, reference, follow=follow)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(4.0)
    assert np.linalg.norm(followed(flight)[:3] - WIND) < 0.3
    flight.story.errors.clear()
    return flight


def followed(flight: Flight) -> np.ndarray:
    adaptation = flight.flyer.controllers.adaptation
    assert adaptation is not None
    return np.array(adaptation.followed.disturbance)


def storm(flight: Flight, highest: float) -> None:
    """A wind that rises within six seconds, m/s^2: a step is an impact."""
    for push in np.linspace(WIND[0], highest, 60):
        flight.plant.disturbance = np.array([push, 0.0, 0.0])
        flight.run(0.1)


def constant_imu(flight: Flight) -> None:
    force, step = flight.plant.specific_force.copy(), flight.plant.step

    def stuck(rate_body: np.ndarray, thrust: float, dt: float) -> None:
        step(rate_body, thrust, dt)
        flight.plant.specific_force = force

    flight.plant.step = stuck  # type: ignore[method-assign]


def no_imu(flight: Flight) -> None:
    flight.imu = False


def jumped_position(flight: Flight) -> None:
    flight.offset = np.array([0.4, -0.3, 0.2])


def reset_position(flight: Flight) -> None:
    flight.offset = flight.reset = np.array([0.8, -0.5, 0.3])


@pytest.mark.parametrize("fault", [no_imu, constant_imu, jumped_position, reset_position])
def test_a_fault_of_the_input_moves_neither_estimate_nor_vehicle_far(
    arpl_250g: Vehicle, fault: Callable[[Flight], None]
) -> None:
    flight = in_wind(arpl_250g)
    before, away = followed(flight), []
    fault(flight)
    for _ in range(60):
        flight.run(0.05)
        away.append(np.abs(followed(flight) - before)[:3].max())
    assert flight.flyer.mission.phase is Phase.TRACK
    assert max(away[-20:]) < 0.5  # m/s^2: the estimate is what it was
    assert max(away) < 2.5
    assert max(flight.story.errors[-100:]) < 0.15
    assert not flight.story.raised & SWINGS


@pytest.mark.parametrize("fault", [no_imu, constant_imu, jumped_position, reset_position])
def test_a_fault_of_the_input_names_nothing_that_is_not_there(
    arpl_250g: Vehicle, fault: Callable[[Flight], None]
) -> None:
    """With wind and drags followed: the push here is none of them, and a fault makes it none."""
    flight = in_wind(arpl_250g, follow=("wind", "rotor_drag", "parasitic_drag"))
    adaptation = flight.flyer.controllers.adaptation
    assert adaptation is not None
    before = {name: value.value for name, value in adaptation.values}
    fault(flight)
    flight.run(3.0)
    for name, value in adaptation.values:
        assert abs(value.value - before[name]) < 3 * value.std, name
    assert max(flight.story.errors[-100:]) < 0.15
    assert not flight.story.raised & SWINGS


@pytest.mark.parametrize(("assumed", "actual"), [(0.6, 0.0), (0.0, 0.6)])
def test_a_wrong_thrust_curve_is_effectiveness_and_leaves_its_variation(
    arpl_250g: Vehicle, assumed: float, actual: float
) -> None:
    """A wrong THR_MDL_FAC scales thrust by a ratio that varies with thrust; one factor takes its mean, d the rest."""
    flight, rotors = flight_in_wind(arpl_250g), arpl_250g.rotors
    flight.flyer.output.thrust_map = ThrustMap(rotors.thrust_max, rotors.thrust_curve, assumed)
    flight.plant._map = ThrustMap(rotors.thrust_max, rotors.thrust_curve, actual)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(8.0)  # some time constants of the effectiveness, 1.3 s
    away, modelled, realised = [], [], []
    for _ in range(160):
        flight.run(0.05)
        away.append(np.linalg.norm(followed(flight)[:3] - WIND))
        setpoint = flight.flyer.output.thrust_map.setpoint(
            flight.story.decisions[-1].collective_thrust, flight.flyer.effectiveness.value
        )
        modelled.append(flight.flyer.output.thrust_map.collective_thrust(setpoint))
        realised.append(flight.plant._map.collective_thrust(setpoint))
    ratio = np.array(realised) / modelled
    left = float(np.ptp(ratio)) * max(modelled) / arpl_250g.body.mass  # m/s^2 that no factor explains
    assert abs(flight.flyer.effectiveness.value - 1) > 0.1  # the fault is there
    assert max(away) < 0.3 + left  # 0.3 without it
    assert max(flight.story.errors[-200:]) < 0.1
    assert not flight.story.raised & SWINGS


def test_a_reset_of_the_estimator_keeps_what_was_estimated(arpl_250g: Vehicle) -> None:
    flight = in_wind(arpl_250g)
    before = followed(flight)
    reset_position(flight)
    flight.run(0.1)
    assert np.abs(followed(flight) - before)[:3].max() < 0.2


def test_estimates_of_nan_move_nothing(arpl_250g: Vehicle) -> None:
    flight = in_wind(arpl_250g)
    before = followed(flight)
    flight.estimate_error = lambda time: np.full(9, np.nan)
    flight.findings = {Event.INPUT_NOT_FINITE.value: "the velocity"}
    flight.frozen = True  # the link accepts none of them
    flight.run(0.15)
    np.testing.assert_array_equal(followed(flight), before)
    flight.estimate_error, flight.findings, flight.frozen = flight.estimator(), {}, False
    flight.run(2.0)
    assert np.isfinite(followed(flight)).all()
    assert np.abs(followed(flight) - before)[:3].max() < 0.3
    assert not flight.story.raised & SWINGS


def test_a_storm_that_it_can_hold_moves_it_little(arpl_250g: Vehicle) -> None:
    """It leans by 41 degrees: along body z the storm is effectiveness, and the disturbance what is across."""
    flight = in_wind(arpl_250g, "Hover")
    before = len(flight.story.errors)
    storm(flight, 8.5)
    flight.run(4.0)
    assert flight.flyer.mission.phase is Phase.TRACK
    assert not flight.story.raised & SWINGS
    assert max(flight.story.errors[before:]) < 0.1
    assert np.abs(followed(flight)[:3]).max() < 6.0


def test_wind_beyond_what_it_can_hold_is_named_and_it_lands(arpl_250g: Vehicle) -> None:
    flight = in_wind(arpl_250g, "Hover")
    storm(flight, 18.0)  # with its weight 20.5 m/s^2, and all rotors give 19.4
    flight.run(4.0)
    assert Event.PUSHED in flight.story.raised
    assert "more than it can hold" in flight.flyer.mission.landing_reason
    assert Event.MODEL_OSCILLATES not in flight.story.raised
    assert np.abs(followed(flight)[:3]).max() <= LIMIT + 1e-9


def test_a_storm_is_not_the_ground_where_nothing_adapts(arpl_250g: Vehicle) -> None:
    """The effectiveness takes the part of it along body z; what is left is across, and points upwards."""
    flight = flight_in_wind(arpl_250g, "Hover", mode="off")
    flight.run(30.0, until=Phase.TRACK)
    flight.run(4.0)
    storm(flight, 8.5)
    flight.run(4.0)
    assert flight.flyer.effectiveness.value < 0.7  # it did
    assert flight.flyer.mission.phase is Phase.TRACK
    assert not flight.story.raised


def test_a_rope_that_pulls_in_one_half_of_the_way_is_bounded(arpl_250g: Vehicle) -> None:
    """What it pulls contradicts itself: nothing where it is slack, up to 4 m/s^2 where it is taut."""
    flight = in_wind(arpl_250g)
    step = flight.plant.step
    anchor = flight.plant.state[POSITION].copy()

    def tied(rate_body: np.ndarray, thrust: float, dt: float) -> None:
        away = flight.plant.state[POSITION] - anchor
        length = float(np.linalg.norm(away))
        pull = min(8.0 * max(length - 1.0, 0.0), 4.0)
        flight.plant.disturbance = -pull * away / max(length, 1e-9)
        step(rate_body, thrust, dt)

    flight.plant.step = tied  # type: ignore[method-assign]
    flight.run(6.0)
    assert np.abs(followed(flight)[:3]).max() <= LIMIT + 1e-9
    assert max(flight.story.errors) < 0.5
    assert not flight.story.raised & SWINGS


def test_what_changed_is_an_event_with_its_interval(arpl_250g: Vehicle) -> None:
    flight = in_wind(arpl_250g)
    adaptation = flight.flyer.controllers.adaptation
    assert adaptation is not None
    text = "rotor_drag.coefficient 2.2e-05 +- 2e-06 N s^2/(m rad)"
    adaptation._describe_changes = lambda: text  # type: ignore[method-assign]
    flight.run(1.5)
    (change,) = [change for change in flight.story.event_changes if change.event is Event.MODEL_CHANGED]
    assert change.active
    assert text in change.text  # which is the STATUSTEXT


def test_an_estimate_that_swings_is_refused_with_an_event_and_the_vehicle_flies_on(arpl_250g: Vehicle) -> None:
    """Velocities that a disturbance would follow, and be late for: the vehicle file's model forecasts better."""
    flight = in_wind(arpl_250g, "Hover")
    flight.plant.disturbance = np.zeros(3)
    flight.run(4.0)
    swing = 2 * np.pi * 2.0
    flight.estimate_error = lambda time: np.r_[0, 0, 0, 0.15 * np.sin(swing * time), 0, 0, 0, 0, 0]
    flight.run(5.0)
    assert Event.ADAPTATION_REFUSED in flight.story.raised
    assert flight.flyer.mission.phase is Phase.TRACK
    flight.estimate_error = flight.estimator()
    flight.run(8.0)  # the errors' averages have to fall to their resolution
    assert Event.ADAPTATION_REFUSED not in flight.flyer.events.active
    assert max(flight.story.errors[-50:]) < 0.05
