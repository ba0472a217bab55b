"""Samples that were lost on the way are told from stamps that are late."""

from __future__ import annotations

import numpy as np
import pytest

from flights.quality.channels import lost_samples

TIME = np.arange(0.0, 60.0, 0.01)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.3])
def test_the_share_of_lost_samples_is_found(share: float) -> None:
    remaining = TIME[np.random.default_rng(2).random(len(TIME)) > share]
    assert lost_samples(remaining) == pytest.approx(share, abs=0.02)


def test_late_stamps_are_not_lost_samples() -> None:
    late = np.sort(TIME + np.random.default_rng(3).exponential(0.003, len(TIME)))
    assert lost_samples(late) == 0.0


def test_a_regular_clock_loses_nothing() -> None:
    assert lost_samples(TIME) == 0.0
