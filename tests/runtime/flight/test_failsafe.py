"""Fallbacks escalate in order, none lasts for ever, and the level hold levels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics import quaternion
from runtime.flight.events import Fallback
from runtime.flight.failsafe import FallbackBounds, FallbackChain, LevelHold, level_rate, level_thrust


def fly(
    chain: FallbackChain, required: Fallback, ticks: int, start: float = 0.0, **availability: bool
) -> list[Fallback]:
    options = {"estimate_usable": False, "solution_left": True, "nominal_available": False} | availability
    return [chain.choose(required, time=start + 0.01 * tick, **options) for tick in range(ticks)]


def test_a_blind_flight_goes_through_the_chain_in_order_and_ends() -> None:
    chosen = fly(FallbackChain(FallbackBounds(shifted_ticks=10, level_hold=1.0)), Fallback.SHIFTED_SOLUTION, 200)
    assert chosen[:10] == [Fallback.SHIFTED_SOLUTION] * 10
    assert chosen[10:110] == [Fallback.LEVEL_HOLD] * 100
    assert set(chosen[112:]) == {Fallback.STOP_STREAMING}
    assert chosen == sorted(chosen)


def test_the_nominal_model_flies_on_as_long_as_there_are_estimates() -> None:
    chain = FallbackChain(FallbackBounds())
    chosen = fly(chain, Fallback.SHIFTED_SOLUTION, 1000, estimate_usable=True, nominal_available=True)
    assert set(chosen[10:]) == {Fallback.NOMINAL_MODEL}


def test_a_milder_fallback_than_the_required_one_is_never_flown() -> None:
    for required in Fallback:
        chosen = fly(FallbackChain(FallbackBounds()), required, 300, estimate_usable=True, nominal_available=True)
        assert min(chosen) >= required


def test_a_flickering_fault_uses_up_the_budget_all_the_same() -> None:
    chain = FallbackChain(FallbackBounds(shifted_ticks=10, recovery=1.0))
    chosen = []
    for tick in range(60):
        required = Fallback.SHIFTED_SOLUTION if tick % 3 else Fallback.NONE
        chosen += fly(chain, required, 1, start=tick * 0.01)
    assert chosen.count(Fallback.SHIFTED_SOLUTION) == 10
    fly(chain, Fallback.NONE, 120, start=1.0)
    assert fly(chain, Fallback.SHIFTED_SOLUTION, 1, start=3.0) == [Fallback.SHIFTED_SOLUTION]


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
