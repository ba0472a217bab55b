"""A setpoint that may be the last one is checked before it leaves, and replaced where it must not be."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY, Limits, Vehicle
from runtime.control.controller import Controller
from runtime.control.rti.last_setpoint import LastSetpointCheck, LastSetpointModel, Outcome
from runtime.flight.decision import FlyerSettings
from runtime.flight.engagement import State
from runtime.flight.events import Event
from runtime.flight.last_setpoint import last_setpoint_model
from runtime.flight.mission import Plan
from runtime.flight.motion import Transfer
from runtime.flight.phases import Phase
from runtime.flight.plan_review import BATCH, SAMPLES
from tests.support.rate_controlled_vehicle import PERIOD, Flight

STEP = 0.005  # s, of the simulation in this file
BOX = ((-6.0, -6.0, -1.0), (6.0, 6.0, 8.0))
SMALL_BOX = ((-2.5, -2.5, -1.0), (2.5, 2.5, 3.0))
AGE = 0.02  # s
MODEL_ERROR = 0.07  # of the distance travelled, in which two models of one failsafe differ beyond the check's margins
BRAKING_UPRIGHT = 0.69  # cosine of the 45 degrees at which PX4 brakes: when it still does so is what models differ in


@pytest.fixture(scope="module")
def controller(arpl_250g: Vehicle) -> Controller:
    return Controller.build(arpl_250g)


@pytest.fixture(scope="module")
def check(controller: Controller) -> LastSetpointCheck:
    model = last_setpoint_model(controller, None, 1.0)
    model.low[:], model.high[:] = BOX
    model.ground, model.drag = 0.0, 0.2
    return controller.solver.last_setpoint_check(model)


class Simulation:
    """Setpoint held, then PX4's failsafe, in small steps of Python: integration and attitude control are others."""

    def __init__(self, model: LastSetpointModel, state: Floats, thrust: float) -> None:
        self.model = model
        self.position, self.velocity = state[:3].copy(), state[3:6].copy()
        self.attitude, self.rate, self.thrust = state[6:10].copy(), state[10:13].copy(), thrust
        self.outside, self.impact, self.touched = 0.0, 0.0, False
        self.start, self.distance = self.position, 0.0

    def step(self, rate: Floats, thrust: float) -> None:
        model = self.model
        self.rate = self.rate + (rate - self.rate) * STEP / np.array(model.lag)
        self.thrust += (thrust - self.thrust) * STEP / model.thrust_lag
        turned = quaternion.multiply(self.attitude, quaternion.exponential(self.rate * STEP))
        self.attitude = quaternion.normalise(turned)
        up = quaternion.rotate(self.attitude, np.array([0.0, 0.0, 1.0]))
        acceleration = self.thrust / model.mass * up - model.drag * self.velocity - [0.0, 0.0, GRAVITY]
        self.velocity = self.velocity + acceleration * STEP
        self.position = self.position + self.velocity * STEP
        self.distance = max(self.distance, float(np.linalg.norm(self.position - self.start)))
        beyond = np.maximum(np.array(model.low) - self.position, self.position - np.array(model.high))
        self.outside = max(self.outside, float(beyond.max()))
        if self.position[2] <= model.ground and self.velocity[2] <= 0.0:
            self.touched = True
            if -self.velocity[2] > model.touch_speed + 0.1 or up[2] < BRAKING_UPRIGHT:
                self.impact = -float(self.velocity[2])

    def hold(self, rate: Floats, thrust: float, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            if not self.touched:
                self.step(rate, thrust)

    def failsafe(self, seconds: float) -> None:
        """Position control of PX4 with its integral, and attitude control on the whole quaternion."""
        model, integral = self.model, np.zeros(3)
        anchor = self.position[:2] + 0.5 * self.velocity[:2]
        for _ in range(round(seconds / STEP)):
            if self.touched:
                return
            demand = np.append(0.95 * (anchor - self.position[:2]), -model.sink)
            demand[:2] *= min(1.0, 5.0 / max(float(np.linalg.norm(demand[:2])), 1e-9))
            error = demand - self.velocity
            integral = np.clip(integral + np.array([0.4, 0.4, 2.0]) * error * STEP, -2.0, 2.0)
            acceleration = np.array([1.5, 1.5, 4.0]) * error + integral
            sideways = float(np.linalg.norm(acceleration[:2]))
            tilt = min(math.atan2(sideways, GRAVITY), math.radians(45.0))
            direction = np.append(math.tan(tilt) * acceleration[:2] / max(sideways, 1e-9), 1.0)
            thrust = model.mass * (acceleration[2] + GRAVITY) / math.cos(tilt)
            here = quaternion.rotate(self.attitude, np.array([0.0, 0.0, 1.0]))
            axis = np.cross(here, direction / np.linalg.norm(direction))
            sine = float(np.linalg.norm(axis))
            angle = math.atan2(sine, float(here @ direction) / float(np.linalg.norm(direction)))
            rate = quaternion.rotate_inverse(self.attitude, axis / max(sine, 1e-9)) * 2 * math.sin(angle / 2)
            rate = np.clip(model.attitude_gain * rate, -model.attitude_rate_max, model.attitude_rate_max)
            self.step(rate, min(max(thrust, 0.12 * model.thrust_max), model.thrust_max))


def simulated(model: LastSetpointModel, state: Floats, thrust_now: float, rate: Floats, thrust: float) -> Simulation:
    """The simulation after hold and failsafe."""
    simulation = Simulation(model, state, thrust_now)
    simulation.hold(state[10:13], thrust_now, AGE)
    simulation.outside, simulation.start = 0.0, simulation.position
    simulation.hold(rate, thrust, model.hold)
    simulation.failsafe(model.patience)
    return simulation


@st.composite
def states(draw: Any) -> Floats:
    def numbers(count: int, limit: float) -> Floats:
        each = st.floats(-limit, limit, allow_nan=False, allow_subnormal=False)
        return np.array(draw(st.lists(each, min_size=count, max_size=count)))

    tilt, heading = numbers(2, 0.7), draw(st.floats(-math.pi, math.pi))
    attitude = quaternion.multiply(
        quaternion.exponential(np.array([0.0, 0.0, heading])), quaternion.exponential(np.append(tilt, 0.0))
    )
    position = np.append(numbers(2, 4.0), draw(st.floats(0.5, 6.0)))
    return np.concatenate([position, numbers(3, 2.0), attitude, numbers(3, 2.0)])


RATES = st.lists(st.floats(-8.0, 8.0), min_size=3, max_size=3)


@settings(max_examples=60, deadline=None)
@given(states(), RATES, st.floats(0.0, 6.0))
def test_what_leaves_passes_a_simulation_of_its_own(
    check: LastSetpointCheck, state: Floats, rates: list[float], thrust: float
) -> None:
    now = check.model.mass * GRAVITY
    left = check.check(state, AGE, now, np.array(rates), thrust)
    if left.outcome is Outcome.NONE_PASSES:
        assert 0.0 < left.harm <= left.harm_given
        return
    assert left.harm == 0.0
    simulation = simulated(check.model, state, now, left.rate_body, left.collective_thrust)
    assert simulation.impact == 0.0
    assert simulation.outside <= MODEL_ERROR * simulation.distance


@settings(max_examples=200, deadline=None)
@given(states(), RATES, st.floats(-1.0, 12.0))
def test_a_setpoint_that_leaves_keeps_its_limits_and_passes_a_second_check(
    check: LastSetpointCheck, state: Floats, rates: list[float], thrust: float
) -> None:
    model, now = check.model, check.model.mass * GRAVITY
    left = check.check(state, AGE, now, np.array(rates), thrust)
    assert np.all(np.abs(left.rate_body) <= np.array(model.rate_max))
    assert 0.0 <= left.collective_thrust <= model.thrust_max
    again = check.harm(state, AGE, now, left.rate_body, left.collective_thrust)
    assert again == left.harm
    if left.outcome is not Outcome.NONE_PASSES:
        assert check.check(state, AGE, now, left.rate_body, left.collective_thrust).outcome is Outcome.PASSES


@settings(max_examples=100, deadline=None)
@given(states(), st.integers(0, 12), st.sampled_from([math.nan, math.inf]))
def test_a_state_that_is_not_finite_passes_nothing(
    check: LastSetpointCheck, state: Floats, place: int, value: float
) -> None:
    state = state.copy()
    state[place] = value
    assert check.harm(state, AGE, 2.0, np.zeros(3), 2.0) > 0.0


def test_a_turn_that_is_right_for_a_tick_and_overturns_in_a_second_is_replaced_by_a_slower_one(
    check: LastSetpointCheck,
) -> None:
    hover = check.model.mass * GRAVITY
    state = np.array([0.0, 0.0, 2.0, *[0.0] * 3, 1.0, *[0.0] * 6])
    left = check.check(state, AGE, hover, np.array([0.0, 4.5, 0.0]), hover)
    assert left.outcome is Outcome.REPLACED
    assert left.harm_given > 1.0
    assert 0.0 < left.rate_body[1] < 1.5
    assert check.check(state, AGE, hover, np.zeros(3), hover).outcome is Outcome.PASSES


def with_box(vehicle: Vehicle, box: Any) -> Vehicle:
    limits = Limits(rate=vehicle.limits.rate, box=box)
    return msgspec.structs.replace(vehicle, limits=limits)


def flight_in(vehicle: Vehicle, mode: Any, distance: float, seconds: float) -> Flight:
    """To one side and back, faster the shorter it takes."""
    start, end = np.array([-distance, 0.0, 1.5, 0.0]), np.array([distance, 0.0, 1.5, 0.0])
    return Flight(
        vehicle,
        Controller.build(vehicle),
        Transfer(vehicle, start, end, seconds),
        plan=Plan(height=1.5, speed=0.5, acceleration=0.5, settle=0.3),
        settings=FlyerSettings(last_setpoint=mode),
    )


def setpoints(flight: Flight) -> list[Floats]:
    return [d.rate_body for d in flight.story.decisions if d.rate_body is not None]


def test_a_flight_that_is_planned_too_fast_is_flown_as_planned_and_says_so(arpl_250g: Vehicle) -> None:
    vehicle = with_box(arpl_250g, SMALL_BOX)
    flights = {mode: flight_in(vehicle, mode, 1.5, 1.6) for mode in ("off", "auto")}
    for flight in flights.values():
        flight.run(30.0)
    assert Event.LAST_SETPOINT_UNCHECKED in flights["auto"].story.raised
    assert Event.LAST_SETPOINT_UNCHECKED not in flights["off"].story.raised
    np.testing.assert_array_equal(setpoints(flights["auto"]), setpoints(flights["off"]))


def test_where_setpoints_are_replaced_an_event_says_so_and_those_that_leave_pass(arpl_250g: Vehicle) -> None:
    vehicle = with_box(arpl_250g, SMALL_BOX)
    flight = flight_in(vehicle, "replace", 1.5, 1.6)
    story = flight.run(20.0, until=Phase.RETURN)
    assert Event.LAST_SETPOINT_REPLACED in story.raised
    replaced = next(change for change in story.event_changes if change.event is Event.LAST_SETPOINT_REPLACED)
    assert "rad/s, thrust" in replaced.text


def test_a_slow_flight_is_checked_and_not_touched(arpl_250g: Vehicle) -> None:
    """A box that is large for its speed; at lift-off a thrust far below the weight may be held back a little."""
    vehicle = with_box(arpl_250g, ((-20.0, -20.0, -5.0), (20.0, 20.0, 20.0)))
    flights, climbed = {mode: flight_in(vehicle, mode, 0.5, 4.0) for mode in ("off", "auto")}, {}
    for flight in flights.values():
        flight.run(30.0, until=Phase.APPROACH)
        climbed[flight] = len(flight.story.event_changes)
        flight.run(12.0, until=Phase.DESCEND)
    assert Phase.RETURN in flights["auto"].story.phases
    assert not flights["auto"].story.raised & {Event.LAST_SETPOINT_UNCHECKED, Event.LAST_SETPOINT_UNSAFE}
    after = flights["auto"].story.event_changes[climbed[flights["auto"]] :]
    assert Event.LAST_SETPOINT_REPLACED not in {change.event for change in after if change.active}
    np.testing.assert_allclose(setpoints(flights["auto"]), setpoints(flights["off"]), atol=1e-4)


def test_a_disturbed_flight_is_replaced_though_its_plan_passes(arpl_250g: Vehicle) -> None:
    vehicle = with_box(arpl_250g, ((-6.0, -6.0, -1.0), (6.0, 6.0, 8.0)))
    flight = flight_in(vehicle, "auto", 0.3, 6.0)
    flight.run(30.0, until=Phase.TRACK)
    assert Event.LAST_SETPOINT_UNCHECKED not in flight.story.raised
    flight.plant.state[3:6] = [6.0, 0.0, 0.5]  # as after a push
    flight.run(1.0)
    assert Event.LAST_SETPOINT_REPLACED in flight.story.raised


def test_the_tick_in_which_control_is_taken_does_not_look_at_the_planned_flight(
    arpl_250g: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each tick looks at a part, once its setpoint has left, and all is looked at before control is taken."""
    flight = flight_in(with_box(arpl_250g, SMALL_BOX), "auto", 1.5, 1.6)
    harm, looks = LastSetpointCheck.harm, list[tuple[bool, State]]()
    departed = [False]
    step, prepare = flight.flyer.step, flight.flyer.prepare

    def count(check: LastSetpointCheck, *arguments: Any) -> float:
        looks.append((departed[0], flight.flyer.engagement.state))
        return harm(check, *arguments)

    def mark(inner: Any, value: bool) -> Any:
        def call(*arguments: Any) -> Any:
            departed[0] = value
            return inner(*arguments)

        return call

    monkeypatch.setattr(LastSetpointCheck, "harm", count)
    monkeypatch.setattr(flight.flyer, "step", mark(step, False))
    monkeypatch.setattr(flight.flyer, "prepare", mark(prepare, True))
    per_tick = 0
    while flight.flyer.engagement.state is not State.ENGAGED:
        before = len(looks)
        flight.run(PERIOD)
        per_tick = max(per_tick, len(looks) - before)
    assert set(looks) == {(True, State.STREAMING)}
    assert len(looks) == 2 * SAMPLES
    assert per_tick <= BATCH
    flight.run(1.0)
    assert len(looks) == 2 * SAMPLES
    assert Event.LAST_SETPOINT_UNCHECKED in flight.story.raised


def test_a_vehicle_that_was_moved_before_control_is_taken_is_looked_at_where_it_is(arpl_250g: Vehicle) -> None:
    """A place beside the box's middle from which the same flight leaves the box."""
    vehicle = with_box(arpl_250g, ((-6.0, -6.0, -1.0), (6.0, 6.0, 8.0)))
    flight = flight_in(vehicle, "auto", 0.3, 6.0)
    flight.run(30.0, until=State.STREAMING)
    flight.run(0.6)
    flight.plant.state[0] = 5.9
    flight.run(30.0, until=Phase.CLIMB)
    assert Event.LAST_SETPOINT_UNCHECKED in flight.story.raised


def test_a_flight_that_is_held_back_for_long_goes_on_without_the_check(arpl_250g: Vehicle) -> None:
    vehicle = with_box(arpl_250g, ((-6.0, -6.0, -1.0), (6.0, 6.0, 8.0)))
    flight = flight_in(vehicle, "auto", 0.3, 6.0)
    flight.run(30.0, until=Phase.TRACK)
    model = flight.flyer.last_setpoint.planned(flight.flyer.output)
    assert model is not None
    model.low[:], model.high[:] = [-0.1, -0.1, 0.0], [0.1, 0.1, 2.0]  # in which next to nothing passes
    flight.run(1.0)
    assert Event.LAST_SETPOINT_UNCHECKED not in flight.story.raised
    flight.run(3.0)
    assert Event.LAST_SETPOINT_UNCHECKED in flight.story.raised
    assert flight.flyer.last_setpoint.planned(flight.flyer.output) is None
