"""What a rejected test named is named: channel, size, when and in which regime."""

import dataclasses

import numpy as np
import pytest

from diagnosis.leftover import leftover, with_typical_window
from diagnosis.selection.residual_tests import Finding, Rejection, ResidualTests
from tests.diagnosis.synthetic import CHANNELS, hovering


@pytest.fixture(scope="module")
def segments(arpl_250g):
    """Two segments of 20 s, of which the second flies fast in its second half."""
    still = hovering(arpl_250g, mass_ratio=1.0, seed=0, count=2, duration=20.0)
    moving = []
    for segment, fast in zip(still, (0.0, 3.0), strict=True):
        velocity = np.zeros((len(segment), 3))
        velocity[len(segment) // 2 :, 0] = fast
        moving.append(dataclasses.replace(segment, velocity=velocity, lacks=frozenset()))
    return tuple(moving)


def test_a_finding_says_where_and_when_it_is_largest(arpl_250g, segments):
    part = tuple(0.1 + 0.9 * (s.smooth[s.decimated, 3] > 1.5) for s in segments)
    finding = Finding("predictable_from_state", 1, 0.5, 2.5, part)
    tests = ResidualTests(0.0, 0.3, 0.0, findings={finding.test: finding})
    (named,) = leftover([Rejection(finding.test, 0.3, 0.01)], tests, segments, (), arpl_250g)
    assert (named.channel, named.size, named.threshold, named.unit) == ("imu y", 0.3, 0.01, "m/s^2")
    assert all(s.flight == "flight_1" and s.start >= 9.0 and s.stop <= 20.1 for s in named.seconds)
    assert named.seconds[0].over_floor == pytest.approx(1.0 / 0.2)
    assert any(cell.regime == "speed m/s" and cell.low > 1.0 for cell in named.regimes)


def test_a_typical_window_names_the_channel_with_the_greatest_excess(arpl_250g, segments):
    random = np.random.default_rng(0)
    rows = [random.standard_normal((len(s.smooth[s.decimated]), CHANNELS)) for s in segments]
    for y in rows:
        y[:, 7] *= 2.0
    floor = np.ones(CHANNELS)
    floor[9:] = 0.0
    tests = with_typical_window(ResidualTests(0.0, 0.0, 0.0), rows, floor)
    named = tests.findings["typical_window"]
    assert named.channel == 7
    assert named.over_floor == pytest.approx(np.sqrt(3), rel=0.1)
    (named,) = leftover([Rejection("typical_window", 2.0, 1.5)], tests, (), segments, arpl_250g)
    assert named.channel == "angular y"
    assert len(named.seconds) == 3
    elsewhere = with_typical_window(ResidualTests(0.0, 0.0, 0.0), rows, floor, range(7))
    assert elsewhere.over_floor("typical_window") < 0.5
