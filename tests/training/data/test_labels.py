"""Labels look ahead, inputs never do; both are what the paper and the increment say they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynamics.errors import DataError
from dynamics.state import ATTITUDE
from flights import Flight
from tests.support.simulated_flight import flown, table
from training.data import labels
from training.data.kalman import ukf_acceleration


@pytest.fixture(scope="module")
def flight() -> Flight:
    return table(flown().log).rows(0, 1500)


@pytest.fixture(scope="module")
def truth() -> Flight:
    return table(flown().truth).rows(0, 1500)


def test_the_increment_label_is_the_true_mean_acceleration_of_the_next_10_ms(flight: Flight, truth: Flight) -> None:
    true = np.diff(np.hstack([truth["velocity"], truth["rate"]]), axis=0) / 0.01
    error = (labels.increment_label(flight)[:-1] - true)[50:-50]
    assert np.isnan(labels.increment_label(flight)[-1]).all()
    linear, angular = (np.sqrt(np.mean(part**2)) for part in (error[:, :3], error[:, 3:]))
    assert linear < 0.5  # of 5 m/s^2 that are flown
    assert angular < 2.0  # of 10 rad/s^2


@pytest.mark.parametrize("horizon", [0.01, 0.015, 0.03])
def test_the_mean_increment_of_a_line_is_its_slope_for_any_horizon(horizon: float) -> None:
    line = np.outer(np.arange(100) / 100.0, [1.0, -2.0])
    increment = labels.mean_increment(line, 100.0, horizon)
    finite = np.isfinite(increment).all(axis=1)
    assert np.allclose(increment[finite], [1.0, -2.0])
    assert np.count_nonzero(~finite) == int(np.ceil(horizon * 100 - 1e-9))


def test_the_papers_label_is_nearer_to_the_truth_with_a_smoother_than_with_its_ukf(
    flight: Flight, truth: Flight
) -> None:
    true = np.gradient(truth["velocity"], 0.01, axis=0)[50:-50]
    smoothed = labels.paper_label(flight)[50:-50, :3]
    filtered = labels.paper_label(flight, differentiate=ukf_acceleration)[50:-50, :3]
    assert np.std(smoothed - true) < 0.5 * np.std(filtered - true)


def test_no_input_of_a_sample_depends_on_later_rows(flight: Flight) -> None:
    cut = flight.rows(0, 700)
    full, part = labels.samples(flight), labels.samples(cut)
    assert np.array_equal(full.state[:700], part.state)
    assert np.array_equal(full.rotor_speed[:700], part.rotor_speed)
    assert full.state.shape[1] == 13
    assert full.label.shape[1] == 6


def test_the_papers_own_table_is_filtered_both_ways(flight: Flight) -> None:
    full, part = labels.paper_table(flight), labels.paper_table(flight.rows(0, 700))
    assert not np.allclose(full.state[690], part.state[690], atol=1e-6)  # it knows the future, as the paper's does
    assert np.allclose(np.linalg.norm(full.state[:, ATTITUDE], axis=1), 1.0)
    rough = np.diff(labels.samples(flight).rotor_speed, n=3, axis=0)
    assert np.std(np.diff(full.rotor_speed, n=3, axis=0)[100:-100]) < 0.2 * np.std(rough)


def test_a_flight_without_rotor_speeds_is_named(flight: Flight) -> None:
    columns = {name: values for name, values in flight.columns.items() if not name.startswith("rotor_speed")}
    with pytest.raises(DataError, match="has no rotor_speed"):
        labels.samples(replace(flight, values=columns))
