"""Fallbacks escalate in order, none lasts for ever, and the level hold levels."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dynamics import quaternion
from runtime.flight.events import POLICIES, Event, Fallback
from runtime.flight.failsafe import FallbackBounds, FallbackChain, LevelHold, level_rate, level_thrust

STALE, LATE, FAILED = Event.ESTIMATE_STALE, Event.DEADLINES_MISSED, Event.SOLVER_FAILED
MODEL_EVENTS = [event for event in Event if POLICIES[event].fallback is Fallback.NOMINAL_MODEL]


def fly(chain: FallbackChain, events: Iterable[Event], ticks: int, start: float = 0.0, **facts: bool) -> list[Fallback]:
    options = {"estimate_usable": False, "solution_left": True, "nominal_available": False} | facts
    active = dict.fromkeys(events, "planted")
    return [chain.choose(active, time=start + 0.01 * tick, **options) for tick in range(ticks)]


def test_a_blind_flight_goes_through_the_chain_in_order_and_ends() -> None:
    chosen = fly(FallbackChain(FallbackBounds(shifted_ticks=10, level_hold=1.0)), [STALE], 200)
    assert chosen[:10] == [Fallback.SHIFTED_SOLUTION] * 10
    assert chosen[10:110] == [Fallback.LEVEL_HOLD] * 100
    assert set(chosen[112:]) == {Fallback.STOP_STREAMING}
    assert chosen == sorted(chosen)


def test_the_nominal_model_flies_on_as_long_as_there_are_estimates() -> None:
    chain = FallbackChain(FallbackBounds())
    chosen = fly(chain, [Event.ESTIMATE_JUMP], 1000, estimate_usable=True, nominal_available=True)
    assert set(chosen[10:]) == {Fallback.NOMINAL_MODEL}


@pytest.mark.parametrize("event", Event)
def test_a_milder_fallback_than_the_required_one_is_never_flown(event: Event) -> None:
    chosen = fly(FallbackChain(FallbackBounds()), [event], 300, estimate_usable=True, nominal_available=True)
    assert min(chosen) >= POLICIES[event].fallback


def test_a_flickering_fault_uses_up_the_budget_all_the_same() -> None:
    chain = FallbackChain(FallbackBounds(shifted_ticks=10, recovery=1.0))
    chosen = []
    for tick in range(60):
        chosen += fly(chain, [STALE] if tick % 3 else [], 1, start=tick * 0.01)
    assert chosen.count(Fallback.SHIFTED_SOLUTION) == 10
    fly(chain, [], 120, start=1.0)
    assert fly(chain, [STALE], 1, start=3.0) == [Fallback.SHIFTED_SOLUTION]


@pytest.mark.parametrize("event", MODEL_EVENTS)
def test_a_stale_estimate_gets_the_shifted_solution_whatever_asks_for_the_nominal_model(event: Event) -> None:
    chain = FallbackChain(FallbackBounds())
    fly(chain, [event], 50, estimate_usable=True, nominal_available=True)
    assert fly(chain, [event, STALE], 3, start=0.5, nominal_available=True) == [Fallback.SHIFTED_SOLUTION] * 3
    assert (
        fly(chain, [event], 2, start=0.6, estimate_usable=True, nominal_available=True) == [Fallback.NOMINAL_MODEL] * 2
    )


def test_the_budget_fills_again_while_the_nominal_model_flies() -> None:
    chain = FallbackChain(FallbackBounds(shifted_ticks=10, recovery=1.0))
    for gap in range(20):
        start = 1.2 * gap
        assert set(fly(chain, [LATE, STALE], 8, start=start, nominal_available=True)) == {Fallback.SHIFTED_SOLUTION}
        healthy = fly(chain, [LATE], 110, start=start + 0.08, estimate_usable=True, nominal_available=True)
        assert set(healthy) == {Fallback.NOMINAL_MODEL}


def test_the_reason_is_the_event_that_excludes_what_is_milder() -> None:
    chain = FallbackChain(FallbackBounds())
    fly(chain, [LATE], 10, estimate_usable=True, nominal_available=True)
    assert chain.reason == "ticks are late: planted"
    fly(chain, [LATE, STALE], 30, start=0.1, nominal_available=True)
    assert chain.current is Fallback.LEVEL_HOLD
    assert chain.reason == "no fresh estimate: planted"
    fly(chain, [LATE, STALE], 300, start=0.4, nominal_available=True)
    assert chain.current is Fallback.STOP_STREAMING
    assert chain.reason == "no fresh estimate: planted"


def test_the_reason_names_the_event_that_used_up_the_budget() -> None:
    chain = FallbackChain(FallbackBounds(shifted_ticks=10))
    fly(chain, [STALE], 9)
    fly(chain, [], 10, start=0.1)
    fly(chain, [FAILED], 5, start=0.2, estimate_usable=True)
    assert chain.current is Fallback.LEVEL_HOLD
    assert chain.reason == "no fresh estimate: planted used 9 ticks of fallbacks up; now the solver failed: planted"


def test_a_solution_that_does_not_come_is_replaced_within_the_bounds() -> None:
    chain = FallbackChain(FallbackBounds(shifted_ticks=10, level_hold=1.0))
    chosen = []
    for tick in range(200):
        fly(chain, [], 1, start=0.01 * tick, estimate_usable=True, nominal_available=True)
        chosen.append(chain.replace_solution(FAILED, "status 3"))
        assert chain.reason == "the solver failed: status 3"
    assert chosen[:10] == [Fallback.SHIFTED_SOLUTION] * 10
    assert chosen == sorted(chosen)
    assert chosen[-1] is Fallback.STOP_STREAMING


TICKS = st.tuples(
    st.integers(1, 30), st.sets(st.sampled_from([STALE, FAILED, Event.ESTIMATE_JUMP, *MODEL_EVENTS]), max_size=3)
)


@example([(13, set()), (30, set()), (30, set()), (30, {STALE}), (72, set()), (30, {Event.DEADLINES_MISSED})], False)
@given(st.lists(TICKS, max_size=30), st.booleans())
def test_over_any_lateness_nothing_milder_that_is_possible_is_passed_over(
    history: list[tuple[int, set[Event]]], nominal_available: bool
) -> None:
    bounds, time = FallbackBounds(), 0.0
    chain, shifted, quiet_since = FallbackChain(bounds), 0, 0.0
    for ticks, events in history:
        blind = bool(events - set(MODEL_EVENTS))
        for _ in range(ticks):
            time += 0.01
            quiet_since = time if blind else quiet_since
            shifted = 0 if time - quiet_since >= bounds.recovery + 0.011 else shifted
            usable = STALE not in events
            (chosen,) = fly(chain, events, 1, start=time, estimate_usable=usable, nominal_available=nominal_available)
            solves = usable and nominal_available
            if not events:
                assert chosen is Fallback.NONE
            elif solves and events & set(MODEL_EVENTS):
                assert chosen is Fallback.NOMINAL_MODEL
            elif shifted < bounds.shifted_ticks:
                assert chosen is Fallback.SHIFTED_SOLUTION
            elif solves:
                assert chosen <= Fallback.NOMINAL_MODEL
            assert bool(chain.reason) is (chosen is not Fallback.NONE)
            shifted += chosen is Fallback.SHIFTED_SOLUTION


@settings(max_examples=15, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(-1.5, 1.5), st.floats(-np.pi, np.pi))
def test_level_rates_bring_any_attitude_upright_without_yawing(roll: float, pitch: float, yaw: float) -> None:
    attitude = quaternion.from_euler(roll, pitch, yaw)
    for _ in range(400):
        rate = level_rate(attitude, gain=3.0, limit=2.0)
        assert rate[2] == 0.0
        assert np.linalg.norm(rate) <= 2.0 + 1e-9
        attitude = quaternion.normalise(quaternion.multiply(attitude, quaternion.exponential(rate * 0.02)))
    assert quaternion.rotate(attitude, [0.0, 0.0, 1.0])[2] > 0.999


def test_level_thrust_holds_the_weight_and_never_pushes_downwards() -> None:
    assert level_thrust(quaternion.IDENTITY, 2.0) == pytest.approx(2.0)
    assert level_thrust(quaternion.from_euler(0.5, 0.0, 1.0), 2.0) == pytest.approx(2.0 / np.cos(0.5))
    assert level_thrust(quaternion.from_euler(1.5, 0.0, 0.0), 2.0) == pytest.approx(3.0)
    assert level_thrust(quaternion.from_euler(2.5, 0.0, 0.0), 2.0) == 0.0


def test_the_level_hold_levels_from_the_last_attitude_and_then_keeps_still() -> None:
    hold = LevelHold(2.0)
    attitude = quaternion.from_euler(0.6, -0.3, 0.5)
    hold.observe(attitude)
    for _ in range(300):
        rate, thrust = hold.command(0.01)
        attitude = quaternion.multiply(attitude, quaternion.exponential(rate * 0.01))
    assert quaternion.rotate(attitude, [0.0, 0.0, 1.0])[2] > 0.999
    assert np.linalg.norm(rate) < 0.01
    assert thrust == pytest.approx(2.0, rel=1e-3)
