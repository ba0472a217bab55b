"""What cannot move the vehicle moves no estimate: ground, take-off, saturation, landing, resets and fallbacks."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics import quaternion
from dynamics.references import named_reference
from dynamics.state import ATTITUDE
from dynamics.vehicle import Vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.rti.problem import MIN_SPEED
from runtime.flight.events import Fallback
from runtime.flight.phases import Phase
from tests.support.rate_controlled_vehicle import Flight

WIND = np.array([1.5, 0.0, 0.0])  # m/s^2


def flight_of(
    vehicle: Vehicle, *, seconds: float = 40.0, wind: bool = False, effectiveness: float = 1.0, height: float = 1.0
) -> Flight:
    options = ControllerOptions.for_vehicle(vehicle, adaptation=AdaptationSettings(mode="on"))
    reference = named_reference(f"hover:height={height:g}", vehicle, duration=seconds)
    flight = Flight(vehicle, Controller.build(vehicle, options), reference, effectiveness=effectiveness)
    flight.plant.disturbance = WIND * wind
    return flight


def followed(flight: Flight) -> np.ndarray:
    adaptation = flight.flyer.controllers.adaptation
    assert adaptation is not None
    return np.array(adaptation.followed.disturbance[:3])


def largest(flight: Flight, seconds: float, about: np.ndarray, until: Phase | None = None) -> float:
    """Greatest distance of the estimate from a value in some seconds or until a phase, m/s^2."""
    away = [0.0]
    for _ in range(round(seconds / 0.01)):
        flight.run(0.01)
        away.append(float(np.linalg.norm(followed(flight) - about)))
        if flight.flyer.mission.phase is until or flight.flyer.over:
            break
    return max(away)


@pytest.mark.parametrize("effectiveness", [0.8, 1.0, 1.2])
def test_on_the_ground_and_on_the_ramp_nothing_is_estimated(arpl_250g: Vehicle, effectiveness: float) -> None:
    """The ground carries the weight, which would be 9.8 m/s^2 upwards."""
    flight = flight_of(arpl_250g, effectiveness=effectiveness)
    flight.grants = set()  # it stands, armed by nobody
    assert largest(flight, 3.0, np.zeros(3)) == 0.0
    flight = flight_of(arpl_250g, effectiveness=effectiveness)
    assert largest(flight, 10.0, np.zeros(3), until=Phase.CLIMB) == 0.0
    assert flight.flyer.mission.phase is Phase.CLIMB


def test_a_take_off_that_is_held_down_is_no_disturbance(arpl_250g: Vehicle) -> None:
    flight = flight_of(arpl_250g)
    flight.plant.disturbance = np.array([0.0, 0.0, -30.0])
    assert largest(flight, 12.0, np.zeros(3)) == 0.0


@pytest.mark.parametrize("effectiveness", [0.8, 1.0, 1.2])
def test_a_take_off_in_wind_estimates_the_wind_alone(arpl_250g: Vehicle, effectiveness: float) -> None:
    """An effectiveness that the first moments do not know yet is no wind that goes on upwards or downwards."""
    flight = flight_of(arpl_250g, wind=True, effectiveness=effectiveness)
    flight.run(20.0, until=Phase.CLIMB)
    assert largest(flight, 8.0, WIND) < np.linalg.norm(WIND) + 1.0
    assert np.linalg.norm(followed(flight) - WIND) < 0.3
    thrust = flight.flyer.effectiveness  # the same force, split between both
    assert abs(thrust.value - effectiveness) < 3 * np.sqrt(thrust.variance)


def test_a_landing_keeps_the_wind_and_takes_the_ground_for_none(arpl_250g: Vehicle) -> None:
    flight = flight_of(arpl_250g, seconds=4.0, wind=True)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(3.5)
    assert largest(flight, 30.0, WIND) < 1.5
    assert flight.flyer.landed


def test_the_ground_that_carries_a_half_is_not_followed_beyond_the_touch_down(arpl_250g: Vehicle) -> None:
    """What a second flight begins with is what the first one had in the air."""
    flight = flight_of(arpl_250g, seconds=3.0, wind=True)
    flight.run(60.0)
    assert flight.flyer.landed
    after = followed(flight)
    flight.run(3.0)
    np.testing.assert_array_equal(followed(flight), after)
    assert np.linalg.norm(after - WIND) < 1.5


@pytest.mark.parametrize(("height", "slowest"), [(-1.5, False), (1.5, True)])
def test_thrust_at_its_limits_is_no_disturbance(arpl_250g: Vehicle, height: float, slowest: bool) -> None:
    """A height that steps away needs more thrust than there is, or less than the least."""
    flight = flight_of(arpl_250g, wind=True, height=8.0)
    rotors = arpl_250g.rotors
    min_thrust = rotors.thrust_max * (MIN_SPEED * arpl_250g.hover_speed / rotors.speed_max) ** 2  # N
    limit = flight.thrust_map.setpoint(min_thrust) if slowest else 1.0
    flight.run(30.0, until=Phase.TRACK)
    flight.run(4.0)
    before = len(flight.story.decisions)
    flight.offset = np.array([0.0, 0.0, height])
    assert largest(flight, 3.0, WIND) < 1.2
    assert np.linalg.norm(followed(flight) - WIND) < 0.3
    thrusts = [decision.thrust for decision in flight.story.decisions[before:]]
    assert min(abs(thrust - limit) for thrust in thrusts) < 0.05
    assert flight.flyer.mission.phase is Phase.TRACK
    assert max(flight.story.errors[-50:]) < 0.1


@pytest.mark.parametrize(
    ("drop", "wind"), [(2.55, (1.07, 0.39)), (2.08, (0.04, -1.71)), (1.73, (1.0, -0.69)), (2.76, (0.19, -1.12))]
)
def test_a_height_that_steps_down_in_wind_turns_nothing_over(
    arpl_250g: Vehicle, drop: float, wind: tuple[float, float]
) -> None:
    """A vehicle that falls with its rotors at rest would have no tilt to hold its place by, and looked for one."""
    flight = flight_of(arpl_250g, seconds=60.0, height=12.0)
    flight.plant.disturbance = np.array([*wind, 0.0])
    flight.run(30.0, until=Phase.TRACK)
    flight.run(4.0)
    before = len(flight.story.states)
    flight.offset = np.array([0.0, 0.0, drop])
    flight.run(4.0)
    attitudes = np.array(flight.story.states[before:])[:, ATTITUDE]
    assert min(quaternion.rotate(attitude, np.array([0.0, 0.0, 1.0]))[2] for attitude in attitudes) > 0
    assert max(flight.story.errors[-50:]) < 0.1


@pytest.mark.parametrize("gap", [0.06, 0.3])
def test_a_fallback_leaves_the_estimate_as_it_was(arpl_250g: Vehicle, gap: float) -> None:
    """A shifted solution, then a level hold: neither is compared with what no estimate shows."""
    flight = flight_of(arpl_250g, wind=True)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(4.0)
    before = followed(flight)
    flight.frozen = True
    assert largest(flight, gap, before) < 0.05
    used = {decision.fallback for decision in flight.story.decisions[-round(gap / 0.01) :]}
    assert used - {Fallback.NONE}
    flight.frozen = False
    assert largest(flight, 2.0, before) < 0.5
    assert max(flight.story.errors[-50:]) < 0.05


def test_a_solver_that_is_reset_keeps_the_estimate(arpl_250g: Vehicle) -> None:
    flight = flight_of(arpl_250g, wind=True)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(4.0)
    before = followed(flight)
    state = flight.flyer._measured.state
    assert state is not None
    flight.flyer.controllers.start(state, flight.time)
    assert largest(flight, 2.0, before) < 0.3
    assert max(flight.story.errors[-50:]) < 0.05
