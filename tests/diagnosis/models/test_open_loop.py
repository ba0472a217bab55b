"""Open-loop errors are of what was logged."""

import msgspec
import numpy as np
import pytest

from diagnosis.data.segment import segments
from diagnosis.estimation.paired_errors import ModelErrors, open_loop_changes
from diagnosis.models.open_loop import open_loop_errors, open_loop_windows
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
    compared = open_loop_changes(errors, errors, 0.5, DEFAULT.relevance)
    assert {quantity for _, quantity in compared} == {"velocity", "attitude", "rate"}
