"""A running mean follows a step with its time constant and weights samples by how long they held."""

from __future__ import annotations

import numpy as np
import pytest

from runtime.running_mean import RunningMean


def test_a_step_is_followed_to_63_per_cent_after_the_averaging_time() -> None:
    mean = RunningMean(0.5, 0.0)
    for _ in range(500):
        mean.add(2.0, 0.001)
    assert mean.value == pytest.approx(2.0 * (1 - np.exp(-1)), rel=1e-3)


def test_a_sample_that_held_longer_than_the_averaging_time_replaces_the_mean() -> None:
    mean = RunningMean(0.5, np.zeros(3))
    mean.add(np.array([1.0, 2.0, 3.0]), 2.0)
    assert mean.value == pytest.approx([1.0, 2.0, 3.0])


def test_a_sample_that_held_for_no_time_changes_nothing() -> None:
    mean = RunningMean(0.5, 1.0)
    mean.add(100.0, 0.0)
    assert mean.value == 1.0
