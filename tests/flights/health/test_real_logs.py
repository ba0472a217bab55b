"""Real PX4 logs, and real PX4 in its own simulation: what comes first in them, and nothing that they do not hold."""

from __future__ import annotations

from pathlib import Path

import pytest

from flights.health import Health, read_health
from flights.reading import read_log

DATA = Path("tests/data")


def health_of(name: str) -> Health:
    return read_health(read_log(DATA / name))


@pytest.mark.parametrize(
    ("name", "first"),
    [
        ("default_rate_logs/disconnected_battery.ulg.gz", "vibration"),
        ("default_rate_logs/no_satellites.ulg.gz", ""),
        ("default_rate_logs/uavcan.ulg.gz", "vibration"),
        ("pyulog_samples/sample_px4_events.ulg.gz", ""),
        ("pyulog_samples/sample_appended_multiple.ulg.gz", ""),
        ("px4_sih_flights/nothing_1_circle.ulg.gz", ""),
        ("px4_sih_flights/refused_lying_61deg.ulg.gz", "tipped_over"),
    ],
)
def test_what_comes_first(name: str, first: str) -> None:
    health = health_of(name)
    assert health.first == first, health.sentences
    assert all(sentence.endswith(".") for sentence in health.sentences)


def test_a_battery_that_is_not_connected_did_not_brown_out() -> None:
    """Its sensor reads 0.05 V for the whole flight: no statement about its charge is made of it."""
    names = {statement.name for statement in health_of("default_rate_logs/disconnected_battery.ulg.gz").statements}
    assert "battery_not_measured" in names
    assert names.isdisjoint({"battery_low", "voltage_sag", "battery"})


def test_a_receiver_without_a_fix_at_any_time_is_no_loss() -> None:
    statements = health_of("default_rate_logs/no_satellites.ulg.gz").statements
    (gps,) = [statement for statement in statements if "gps" in statement.name]
    assert (gps.name, gps.level) == ("no_gps_fix", "note")
    assert "did not use it" in gps.text


def test_motors_that_all_follow_did_not_fail() -> None:
    """Outputs on an instance that stands at 0 are those of nothing; all four ESCs report speeds until the landing."""
    statements = health_of("default_rate_logs/uavcan.ulg.gz").statements
    assert {statement.name for statement in statements}.isdisjoint({"stopped_rotor", "weak_thrust", "esc_failure"})


def test_events_are_in_the_order_of_time() -> None:
    events = health_of("default_rate_logs/no_satellites.ulg.gz").events
    names = [event.name for event in events]
    assert [event.time for event in events] == sorted(event.time for event in events)
    assert names.index("takeoff") < names.index("landed") < names.index("disarmed")


def test_every_statement_has_evidence_and_a_certainty() -> None:
    for name in ("disconnected_battery", "no_satellites", "uavcan"):
        for statement in health_of(f"default_rate_logs/{name}.ulg.gz").statements:
            assert statement.certainty in ("seen", "likely", "cannot tell")
            assert statement.evidence.channel
            assert statement.evidence.end >= statement.evidence.start
