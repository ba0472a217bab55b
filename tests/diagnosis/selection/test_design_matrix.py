"""Columns of all candidates at once are those of each alone."""

import numpy as np
import pytest

from diagnosis.data.segment import segments
from diagnosis.models import channels
from diagnosis.selection.candidates import make_candidates, make_instruments, make_predictor
from diagnosis.selection.design_matrix import DesignMatrix
from dynamics.effects import CATALOGUE


@pytest.fixture(scope="module")
def segment(plain_flights, arpl_250g):
    return segments(plain_flights[1], arpl_250g)[0]


def test_slopes_of_all_candidates_at_once_are_those_of_each_alone(segment, arpl_250g):
    candidates = make_candidates(arpl_250g, CATALOGUE, [segment])
    _, together = DesignMatrix(arpl_250g, CATALOGUE, candidates, segment).evaluate(segment)
    instruments = make_instruments(segment, arpl_250g)
    for name in ("inertia", "weak_rotor", "rotor_gyroscopic", "imu_bias", "wind", "translational_lift"):
        candidate = next(c for c in candidates if c.effect.name == name)
        speed = instruments.rotor_speed if candidate.effect.physics is not None else None
        slopes = make_predictor(arpl_250g, CATALOGUE, candidate, segment).slopes(
            segment, candidate.values, rotor_speed=speed, rotor_acceleration=instruments.rotor_acceleration
        )
        alone = channels.predicted(segment, slopes)
        np.testing.assert_allclose(together[:, :, list(candidate.columns)], alone, atol=1e-9 * np.abs(alone).max())


def test_a_fit_of_commands_takes_instruments_whose_thrust_is_slow_too(segment, arpl_250g):
    """A height controller answers the noise of the velocity that is logged."""
    ripple = 1.0 + 0.05 * np.sin(2 * np.pi * 5.0 * np.arange(len(segment)) / segment.rate)[:, None]
    fast, slow = (
        make_instruments(segment, arpl_250g, ripple * segment.rotor_speed, 0.75, slow_thrust=of_fit).rotor_speed ** 2
        @ arpl_250g.rotors.allocation[0]
        for of_fit in (False, True)
    )
    inside = slice(round(segment.rate), -round(segment.rate))
    assert np.std(np.diff(slow)[inside]) < 0.05 * np.std(np.diff(fast)[inside])
    assert np.mean(slow) == pytest.approx(np.mean(fast), rel=0.01)
