"""Events are raised, cleared and turned into fallbacks as in their policies."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.flight.events import NEVER, POLICIES, Event, EventMonitor, Fallback


def test_every_event_has_a_policy_with_a_text() -> None:
    assert set(POLICIES) == set(Event)
    assert all(policy.text for policy in POLICIES.values())


def test_an_event_is_raised_once_and_cleared_once() -> None:
    monitor = EventMonitor()
    raised = monitor.update({Event.ESTIMATE_STALE: "80 ms old"}, 1.0)
    assert [(change.event, change.active) for change in raised] == [(Event.ESTIMATE_STALE, True)]
    assert raised[0].text == "no fresh estimate: 80 ms old"
    assert monitor.update({Event.ESTIMATE_STALE: "90 ms old"}, 1.01) == ()
    assert monitor.update({}, 1.02) == ()
    cleared = monitor.update({}, 1.10)
    assert [(change.event, change.active) for change in cleared] == [(Event.ESTIMATE_STALE, False)]
    assert monitor.counts[Event.ESTIMATE_STALE] == 1


def test_an_event_with_an_onset_ignores_a_short_presence() -> None:
    monitor = EventMonitor()
    onset = POLICIES[Event.THRUST_LIMIT].onset
    assert monitor.update({Event.THRUST_LIMIT: ""}, 0.0) == ()
    assert monitor.update({}, onset / 2) == ()
    assert monitor.update({Event.THRUST_LIMIT: ""}, onset) == ()
    assert monitor.update({Event.THRUST_LIMIT: ""}, 2.1 * onset) != ()
    assert Event.THRUST_LIMIT in monitor.active


@pytest.mark.parametrize("event", [Event.MODEL_UNHEALTHY, Event.MODEL_OSCILLATES])
def test_a_latched_event_clears_only_by_engaging_again(event: Event) -> None:
    monitor = EventMonitor()
    assert POLICIES[event].clear_after == NEVER
    monitor.update({event: ""}, 0.0)
    monitor.update({event: ""}, 1.0)
    assert monitor.update({}, 1e6) == ()
    assert monitor.fallback is Fallback.NOMINAL_MODEL
    assert [change.active for change in monitor.rearm(1e6)] == [False]
    assert monitor.fallback is Fallback.NONE


def test_the_strongest_fallback_wins_and_gives_the_reason() -> None:
    monitor = EventMonitor()
    monitor.update({Event.ESTIMATE_STALE: "60 ms old", Event.LINK_LOST: "2 s of silence"}, 0.0)
    assert monitor.fallback is Fallback.STOP_STREAMING
    assert "2 s of silence" in monitor.reason


@pytest.mark.parametrize("event", [Event.BATTERY_LOW, Event.GEOFENCE])
def test_some_events_end_the_mission_with_a_landing_and_no_fallback(event: Event) -> None:
    monitor = EventMonitor()
    monitor.update({event: ""}, 0.0)
    monitor.update({event: ""}, 5.0)
    assert monitor.landing_reason
    assert monitor.fallback is Fallback.NONE


@given(st.lists(st.tuples(st.floats(0, 0.3), st.sets(st.sampled_from(list(Event)))), max_size=60))
def test_raised_and_cleared_alternate_for_every_event(history: list[tuple[float, set[Event]]]) -> None:
    monitor = EventMonitor()
    time = 0.0
    active: set[Event] = set()
    for step, present in history:
        time += step
        for change in monitor.update(dict.fromkeys(present, ""), time):
            assert (change.event in active) is not change.active
            active ^= {change.event}
    assert active == set(monitor.active)
