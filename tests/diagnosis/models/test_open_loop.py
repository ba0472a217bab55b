"""Open-loop errors are of what was logged."""

import msgspec
import numpy as np
import pytest

from diagnosis.data.segment import segments
from diagnosis.estimation.paired_errors import ModelErrors, open_loop_changes, open_loop_total
from diagnosis.models.open_loop import motion_over_horizons, open_loop_errors, open_loop_windows
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from tests.diagnosis.conftest import with_columns


@pytest.fixture(scope="module")
def without_position(plain_flights, arpl_250g):
    missing = {f"position_{axis}": None for axis in "xyz"}
    return segments(with_columns(plain_flights[4], missing), arpl_250g)


def test_a_position_that_was_not_logged_has_no_error(without_position, arpl_250g):
    errors = open_loop_errors(arpl_250g, CATALOGUE, without_position)
    assert all(np.isnan(error.position) for error in errors)
    assert all(0 < error.velocity < 1 for error in errors)
    assert errors[0].figures[0] == "-"
    assert msgspec.json.decode(msgspec.json.encode(errors[0]))["position"] is None


def test_nothing_is_judged_by_a_position_that_was_not_logged(without_position, arpl_250g):
    windows = open_loop_windows(arpl_250g, CATALOGUE, without_position)
    errors = {horizon: ModelErrors(parts) for horizon, parts in windows.items()}
    moved = motion_over_horizons(without_position)
    compared = open_loop_changes(errors, errors, moved, 0.5, DEFAULT.relevance)
    assert set(compared) == {"velocity", "attitude", "rate"}
    assert compared["velocity"].motion > 10 * compared["velocity"].before


def attitudes(*levels, seed=0, count=80):
    """Errors of the attitude of these sizes, rad, after 0.1, 0.5 and 1 s, the same but for their size at any levels."""
    random = np.random.default_rng(seed)
    rows = {horizon: np.zeros((count, 12)) for horizon in (0.1, 0.5, 1.0)}
    for errors, level in zip(rows.values(), levels, strict=True):
        drawn = random.standard_normal((count, 3))
        errors[:, 6:9] = level * drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    return {horizon: ModelErrors([errors]) for horizon, errors in rows.items()}


@pytest.mark.parametrize(
    ("after", "worse"),
    [
        ((0.00621, 0.032, 0.066), False),  # 0.02 degrees after 0.1 s, and nothing later, beyond any chance
        ((0.00621, 0.028, 0.058), False),
        ((0.00583, 0.034, 0.080), True),
        ((0.0900, 0.032, 0.066), True),
    ],
)
def test_a_rise_of_an_error_counts_in_units_of_the_motion(after, worse):
    """Of a vehicle whose attitude changes by 3 degrees in 0.1 s and by 23 in a second."""
    moved = {horizon: np.full(4, size) for horizon, size in ((0.1, 0.05), (0.5, 0.25), (1.0, 0.4))}
    change = open_loop_changes(attitudes(0.00583, 0.032, 0.066), attitudes(*after), moved, 0.25, DEFAULT.relevance)
    assert abs(change["attitude"].deviations) > 2.0
    assert change["attitude"].is_worse() == worse


def test_all_errors_together_are_better_or_not():
    before, better = attitudes(0.006, 0.03, 0.06), attitudes(0.006, 0.029, 0.057)
    chance = attitudes(0.006, 0.03, 0.06, seed=1)
    fall, none = (
        open_loop_total(before, after, ["attitude"], 0.25, DEFAULT.relevance).deviations for after in (better, chance)
    )
    assert fall < -2.0
    assert abs(none) < 2.0
