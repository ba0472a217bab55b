"""Planned faults in flight over the link's bytes: each has its name, no false one, and ends as its case expects."""

from __future__ import annotations

import pytest

from fixtures.fault_flights import fly_case, read_cases

CASES = {case.name: case for case in read_cases()}
FLOWN = (
    "nothing",
    "estimate_moves_1e30",
    "stamps_3s_ahead",
    "estimator_reset_yaw",
    "stall_2s",
    "tipped_over_on_ground",
    "reboot_armed",
)
NIGHTLY = (
    "estimate_reset_1e30",
    "stamps_3s_ahead_short",
    "estimate_drifts_landing",
    "estimate_turned_from_the_start",
    "disk_full",
    "knock_over",
    "reference_leaps_60cm",
)


def test_every_case_can_be_read() -> None:
    assert len(CASES) >= 60


@pytest.mark.parametrize("name", [*FLOWN, *[pytest.param(name, marks=pytest.mark.slow) for name in NIGHTLY]])
def test_a_fault_ends_as_its_case_expects(name: str) -> None:
    flight = fly_case(CASES[name], "nominal", seed=7)
    assert not flight.unexplained, flight


@pytest.mark.parametrize("seed", [71_000, pytest.param(71_001, marks=pytest.mark.slow)])
def test_a_force_that_the_model_follows_is_no_ground_in_the_descent(seed: int) -> None:
    """A model that follows has learned a vertical wind, beside which the thrust seemed too weak."""
    flight = fly_case(CASES["duplication"], "adapting", seed)
    assert not flight.unexplained, flight
    assert "contact_lost" not in flight.events
