"""Body rates that are not followed, and a learned model that makes the vehicle oscillate, are detected."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.vehicle import Vehicle
from runtime.flight.events import Event
from runtime.flight.health import FlightHealth, HealthLimits

PERIOD = 0.01
LIMITS = HealthLimits()
AMPLITUDE, LATE = 4.0, 0.2  # rad/s of a slow swing, s by which the vehicle follows it


def swing(time: float) -> np.ndarray:
    return np.array([AMPLITUDE * np.sin(2 * np.pi * time), 0.0, 0.0])


def events_after(health: FlightHealth, seconds: float, late: float, *, learned: bool) -> set[Event]:
    """Events while rates of a cycle a second are commanded and followed so many seconds late."""
    events: set[Event] = set()
    for tick in range(round(seconds / PERIOD)):
        now = PERIOD * tick
        health.sent(swing(now), 1.0, now)
        state = np.array([*[0.0] * 6, 1.0, *[0.0] * 3, *swing(now - late)])
        events |= set(health.flight(state, now, learned=learned))
    return events


def test_rates_that_miss_a_learned_model_s_setpoints_replace_it_before_the_stream_is_stopped(
    arpl_250g: Vehicle,
) -> None:
    """Followed 0.2 s late instead of 0.06, a swing of 4 rad/s is missed by 2.2 rad/s on average."""
    missed = 2 * AMPLITUDE * np.sin(np.pi * (LATE - LIMITS.rate_delay)) * 2 / np.pi
    assert LIMITS.swing < missed < LIMITS.unfollowed
    assert events_after(FlightHealth(arpl_250g), 5.0, LATE, learned=True) == {Event.MODEL_OSCILLATES}
    assert events_after(FlightHealth(arpl_250g), 5.0, LIMITS.rate_delay, learned=True) == set()


def test_without_a_learned_model_rates_may_miss_as_much(arpl_250g: Vehicle) -> None:
    assert events_after(FlightHealth(arpl_250g), 5.0, LATE, learned=False) == set()


@pytest.mark.parametrize(("jump", "events"), [(0.9, set()), (1.1, {Event.MODEL_OSCILLATES})])
def test_setpoints_that_alternate_from_tick_to_tick_are_detected_at_the_limit(
    arpl_250g: Vehicle, jump: float, events: set[Event]
) -> None:
    health = FlightHealth(arpl_250g)
    state = np.array([*[0.0] * 6, 1.0, *[0.0] * 6])
    for tick in range(300):
        health.sent(np.array([0.0, (-1) ** tick * jump * LIMITS.chatter / 4, 0.0]), 1.0, PERIOD * tick)
    assert set(health.flight(state, 3.0, learned=True)) == events
    health.rest()
    assert health.flight(state, 3.0, learned=True) == {}


def refused_after(arpl_250g: Vehicle, miss: float, seconds: float) -> bool:
    """Whether rates that miss their setpoints by so much, rad/s, for so long end a flight that went well before."""
    health, refused = FlightHealth(arpl_250g), False
    for tick in range(500):
        now, since = PERIOD * tick, PERIOD * tick - 2.0
        health.sent(np.zeros(3), 1.0, now)
        rate = miss if 0.0 <= since < seconds else 0.0
        state = np.array([*[0.0] * 6, 1.0, *[0.0] * 3, rate, 0.0, 0.0])
        refused |= Event.SETPOINT_REFUSED in health.flight(state, now)
    return refused


def test_a_blow_that_is_taken_up_within_a_moment_is_no_refusal_of_setpoints(arpl_250g: Vehicle) -> None:
    """25 rad/s for 0.3 s turn a vehicle over; a vehicle that acts on nothing goes on to miss."""
    assert not refused_after(arpl_250g, 25.0, 0.3)
    assert refused_after(arpl_250g, 25.0, 2.0)
    assert refused_after(arpl_250g, 1.2 * LIMITS.unfollowed, 3.0)
