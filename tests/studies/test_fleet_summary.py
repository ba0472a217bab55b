"""Summaries of a fleet: drifts, outliers, verdicts and dates of many flights, and the page about them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date, timedelta
from typing import Any

import numpy as np
import pytest

from studies.fleet.date import date_in_name, day_of
from studies.fleet.flight import FleetChannel, FleetEffect, FleetFlight, FleetParameter
from studies.fleet.page import fleet_page
from studies.fleet.summary import FleetReport, summarise

DRAG = "rotor_drag"  # any effect: the summaries know none


def flight(
    vehicle: str, day: int, value: float | None, *, over: float = 2.0, std: float = 0.01, **fields: Any
) -> FleetFlight:
    """A flight of a table: a parameter with a value, or none that is missing."""
    when = date(2026, 1, 1) + timedelta(days=day)
    effects = ()
    if value is not None:
        parameter = FleetParameter(value, std, value - 1.96 * std, value + 1.96 * std, "N")
        effects = (FleetEffect(DRAG, None, {"size": parameter}, 1.0),)
    defaults: dict[str, Any] = {
        "status": "diagnosed",
        "sha256": f"{vehicle}{day}",
        "vehicle": vehicle,
        "vehicle_file": f"{vehicle}/vehicle.toml",
        "date": f"{when.isoformat()}T00:00:00",
        "date_from": "name",
        "verdict": "effect" if effects else "explained",
        "effects": effects,
        "channels": {"imu": FleetChannel(over, 1.0, 1.0, over, "m/s^2")},
    }
    return FleetFlight(f"{vehicle}/{when}.csv", **(defaults | fields))


def history(vehicle: str, values: Sequence[float], **fields: Any) -> list[FleetFlight]:
    """A flight a week. The channels of each wander a little."""
    overs = 2.0 + 0.05 * np.random.default_rng(1).standard_normal(len(values))
    return [
        flight(vehicle, 7 * i, v, over=float(o), **fields) for i, (v, o) in enumerate(zip(values, overs, strict=True))
    ]


def report(flights: Sequence[FleetFlight]) -> FleetReport:
    return summarise("logs", flights)


def test_a_planted_drift_is_recovered_with_its_interval() -> None:
    random = np.random.default_rng(0)
    days = 7.0 * np.arange(30)
    made = report(history("a", 5.0 + 0.01 * days + 0.1 * random.standard_normal(30)))
    (drift,) = [one for one in made.drifts if "size" in one.quantity]
    assert drift.is_drift
    assert drift.low < 0.01 < drift.high
    assert drift.high - drift.low < 0.003
    assert drift.change == pytest.approx(2.03, rel=0.1)
    assert [one.is_drift for one in made.drifts if one is not drift] == [False]


def test_vehicles_that_stay_the_same_rarely_drift() -> None:
    random = np.random.default_rng(3)
    flights = [f for i in range(100) for f in history(f"v{i}", 5.0 + 0.1 * random.standard_normal(8))]
    assert sum(drift.is_drift for drift in report(flights).drifts) <= 1


def test_a_drift_needs_dates_that_are_known() -> None:
    values = list(np.linspace(1, 2, 10))
    assert not report(history("a", values, date_from="file")).drifts
    assert report(history("a", values, date_from="file")).undated == 10
    assert not report(history("a", values[:4])).drifts
    assert not report(history("a", values, date="2026-01-01T00:00:00")).drifts


def test_a_flight_unlike_the_others_is_an_outlier_of_its_own_vehicle() -> None:
    values = [1.0, 1.02, 0.98, 1.01, 0.99, 1.0, 1.5, 1.01]
    flights = [*history("a", values), *history("b", [1.5] * 8)]
    (outlier,) = report(flights).outliers
    assert (outlier.log, outlier.vehicle, outlier.value) == (flights[6].log, "a", 1.5)
    assert outlier.score > 3.5
    uncertain = [*flights[:6], flight("a", 42, 1.5, std=0.3), *flights[7:]]
    assert not report(uncertain).outliers
    loud = [*flights[:3], flight("a", 21, 1.0, over=4.0), *flights[4:6], *flights[7:]]
    assert [one.quantity for one in report(loud).outliers] == ["accelerometer over its floor"]


def test_verdicts_are_counted_and_copies_are_not() -> None:
    flights = [*history("a", [1.0] * 3), flight("b", 0, None), flight("b", 1, None, sha256="b0")]
    flights.append(FleetFlight("c.csv", "refused", error="no"))
    made = report(flights)
    assert made.verdicts == {"explained": 1, "effect": 3, "refused": 1}
    assert made.copies == {"b/2026-01-02.csv": "b/2026-01-01.csv"}
    assert [(one.label, one.flights) for one in made.vehicles] == [("a", 3), ("b", 1)]
    assert made.vehicles[0].effects == {DRAG: 3}


def test_vehicles_of_one_name_are_told_apart() -> None:
    flights = [
        flight("a", 0, 1.0),
        flight("a", 1, 1.0, vehicle_file="other/vehicle.toml"),
        flight("b", 0, 1.0, airframe="0001"),
        flight("b", 1, 1.0, airframe="0002"),
    ]
    labels = [one.label for one in report(flights).vehicles]
    assert labels == ["a (a/vehicle.toml)", "a (other/vehicle.toml)", "b (0001)", "b (0002)"]


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("2026-03-01/10_15_07.ulg", "2026-03-01T10:15:07"),
        ("20260301-101507.mcap", "2026-03-01T10:15:07"),
        ("a/log_20240613_115633.log", "2024-06-13T11:56:33"),
        ("flight 2026-03-01.csv", "2026-03-01T00:00:00"),
        ("2026-03-01/log3.csv", "2026-03-01T00:00:00"),
        ("2026-13-01.csv", ""),
        ("flight_12026030199.csv", ""),
        ("log_7.csv", ""),
    ],
)
def test_a_date_in_a_name_is_read(name: str, written: str) -> None:
    assert date_in_name(name) == written


def test_a_date_is_a_number_of_days() -> None:
    assert day_of("2026-01-02T12:00:00") - day_of("2026-01-01") == 1.5


def test_the_page_of_a_large_fleet_is_small_and_says_what_the_report_says() -> None:
    flights = [f for i in range(40) for f in history(f"v{i:02d}", list(1.0 + 0.01 * np.arange(25) ** (i == 7)))]
    made = report(flights)
    page = fleet_page(made)
    assert len(page.encode()) < 5_000_000
    assert "1,000 flights of 40 vehicles" in page
    assert page.count("</tr>") > 1000
    drift = next(one for one in made.drifts if one.is_drift)
    assert drift.vehicle == "v07"
    assert f'data-value="{drift.median}"' in page
