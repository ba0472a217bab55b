"""A rotor is flagged when it works harder than in normal flights of the same vehicle, and seldom when it does not."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.hover_trim import compare_trim, hover_shares, judge_shares, trim_sentence
from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import Vehicle
from flights import Flight
from flights.log import Provenance

RATE = 50.0
UNEVEN = np.array([0.9, 1.12, 0.95, 1.03])  # as a healthy Crazyflie shares its load


def flown(shares: Floats, *, name: str, seconds: float = 12.0, moving: bool = False) -> Flight:
    """Hover at 1 m with commands that are shared like this."""
    count = round(seconds * RATE)
    random = np.random.default_rng(len(name))
    signals = 0.5 * shares + 0.02 * random.standard_normal((count, len(shares)))
    columns = {f"rotor_command_{i}": signals[:, i] for i in range(len(shares))}
    for i, axis in enumerate("xyz"):
        columns[f"velocity_{axis}"] = (1.5 if moving and i == 0 else 0.0) + 0.03 * random.standard_normal(count)
        columns[f"position_{axis}"] = np.full(count, float(axis == "z"))
    return Flight(np.arange(count) / RATE, columns, Provenance(name, name, "flight CSV", ""))


def drawn(random: np.random.Generator, flights: int, spread: float, harder: float = 0.0) -> Floats:
    """Shares of flights with a spread between them, rotor 2 working harder by a share."""
    shares = UNEVEN + spread * random.standard_normal((flights, 4))
    shares[:, 2] *= 1 + harder
    return np.asarray(shares / shares.mean(axis=1, keepdims=True))


def test_shares_are_the_means_over_hover(arpl_250g: Vehicle) -> None:
    shares = hover_shares(flown(UNEVEN, name="a"), arpl_250g)
    np.testing.assert_allclose(shares.shares, UNEVEN, atol=0.01)
    assert shares.seconds == pytest.approx(12.0, abs=0.5)


def test_a_flight_that_never_hovers_is_refused(arpl_250g: Vehicle) -> None:
    with pytest.raises(DataError, match=r"0\.0 s of hover.*hover longer"):
        hover_shares(flown(UNEVEN, name="a", moving=True), arpl_250g)


def test_a_weak_rotor_is_flagged_with_its_loss(arpl_250g: Vehicle) -> None:
    normal = [flown(UNEVEN, name=f"normal {i}") for i in range(3)]
    weak = UNEVEN.copy()
    weak[2] /= 1 - 0.2
    comparison = compare_trim([flown(weak, name="weak")], normal, arpl_250g)
    (effect,) = comparison.effects
    assert (comparison.verdict, effect.name, effect.rotor) == ("ambiguous", "weak_rotor", 2)
    assert effect.parameters["loss"].value == pytest.approx(0.2, abs=0.02)
    assert effect.ambiguous_with == ("centre_of_mass",)
    x, y = comparison.centre_of_mass_moved
    assert x < 0  # the rotor behind on the right carries more
    assert y < 0
    assert "Rotor 2 (back right; PX4 and ArduPilot motor 4, Crazyflie M2) works harder" in trim_sentence(comparison)


@pytest.mark.parametrize("normal", [1, 2, 5, 8])
@pytest.mark.parametrize("spread", [0.01, 0.02])
def test_normal_flights_are_seldom_flagged_and_strong_faults_nearly_always(
    arpl_250g: Vehicle, normal: int, spread: float
) -> None:
    random = np.random.default_rng(5)
    alarms = detected = 0
    for _ in range(200):
        usual = drawn(random, normal, spread)
        alarms += judge_shares(drawn(random, 1, spread), usual, arpl_250g).verdict == "ambiguous"
        comparison = judge_shares(drawn(random, 1, spread, harder=0.2), usual, arpl_250g)
        detected += [(e.name, e.rotor) for e in comparison.effects] == [("weak_rotor", 2)]
    assert alarms <= 14  # 5 % of 200 and a little more
    assert detected >= 190


def test_normal_flights_that_differ_much_make_it_more_careful(arpl_250g: Vehicle) -> None:
    random = np.random.default_rng(6)
    now = drawn(random, 1, 0.0, harder=0.14)
    alike, unlike = (drawn(random, 8, spread) for spread in (0.01, 0.08))
    assert judge_shares(now, alike, arpl_250g).effects
    assert not judge_shares(now, unlike, arpl_250g).effects


def test_a_flight_is_not_compared_with_itself(arpl_250g: Vehicle) -> None:
    flight = flown(UNEVEN, name="a")
    with pytest.raises(RequestError, match="among the normal flights too"):
        compare_trim([flight], [flight], arpl_250g)


def test_signals_are_not_compared_with_speeds(arpl_250g: Vehicle) -> None:
    signals = flown(UNEVEN, name="a")
    columns = {name.replace("rotor_command", "rotor_speed"): values for name, values in signals.columns.items()}
    speeds = Flight(signals.time, columns, Provenance("b", "b", "flight CSV", ""))
    with pytest.raises(DataError, match="rotor_command, rotor_speed"):
        compare_trim([signals], [speeds], arpl_250g)


def test_without_velocity_and_position_hover_is_not_assumed(arpl_250g: Vehicle) -> None:
    flight = flown(UNEVEN, name="a")
    blind = Flight(flight.time, {n: v for n, v in flight.columns.items() if n.startswith("rotor")}, flight.provenance)
    with pytest.raises(DataError, match="hover cannot be told from travel"):
        hover_shares(blind, arpl_250g)
