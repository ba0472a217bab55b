"""Leftovers are named: channel, size, when and in which regime."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from diagnosis.leftover import leftover
from diagnosis.likelihood.features import Discrepancy, Line, smooth, time_of
from diagnosis.likelihood.flight_rows import make_rows
from diagnosis.likelihood.left_over import Left
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


@pytest.fixture(scope="module")
def left(segments):
    """A force along body y that is ten times as large where the vehicle is fast, by the parts of the flights."""
    parts_of_flights = [
        (segment.between(begin, end), number)
        for number, segment in enumerate(segments)
        for begin, end in pairwise([0, len(segment) // 2, len(segment)])
    ]
    rows = tuple(make_rows(part, number) for part, number in parts_of_flights)
    parts = tuple(0.1 + 0.9 * (one.velocity[:, 0] > 1.5) for one in rows)
    return Left(Discrepancy(Line(0.5, (0, 1)), 1, 0.4), 12.0, 1, rows, parts)


def of_state(left):
    placed = smooth("place", [(rows, None) for rows in left.rows], fineness=1.0, count=4, seed=0)
    assert placed is None  # nothing of the place moves
    moved = smooth("time", [(rows, None) for rows in left.rows], fineness=1.0, count=4, seed=0)
    return dataclasses.replace(left, discrepancy=Discrepancy(moved, 1, 0.4))


def test_it_says_where_and_when_it_is_largest(arpl_250g, segments, left):
    (named,) = leftover([of_state(left)], segments, np.full(CHANNELS, 0.2), arpl_250g)
    assert (named.test, named.channel, named.unit) == ("predictable_from_time", "imu y", "m/s^2")
    assert (named.size, named.threshold, named.frequency) == (12.0, 3.0, None)
    assert named.over_floor == pytest.approx(named.rms / 0.2)
    assert all(s.flight == "flight_1" and s.start >= 9.0 and s.stop <= 20.1 for s in named.seconds)
    assert named.seconds[0].over_floor == pytest.approx(1.0 / 0.2)
    assert any(cell.regime == "speed m/s" and cell.low > 1.0 for cell in named.regimes)


def test_a_line_has_a_frequency_and_a_torque_its_own_channel(arpl_250g, segments, left):
    turning = dataclasses.replace(left, channel=5)
    (named,) = leftover([turning], segments, np.full(CHANNELS, 0.2), arpl_250g)
    assert (named.test, named.channel, named.frequency, named.unit) == ("spectral_line", "angular z", 0.5, "rad/s^2")


def test_without_an_accelerometer_the_pose_shows_a_force(arpl_250g, segments, left):
    blind = [dataclasses.replace(segment, specific_force=None) for segment in segments]
    (named,) = leftover([left], blind, np.full(CHANNELS, 0.2), arpl_250g)
    assert named.channel == "mocap y"


def test_functions_of_time_begin_with_each_flight(left):
    functions = of_state(left).discrepancy.of
    later = dataclasses.replace(left.rows[0].segment, start=left.rows[0].segment.start + 100.0)
    elsewhere = smooth("time", [(make_rows(later, 0), None)], fineness=1.0, count=4, seed=0)
    assert functions.begins[0] == left.rows[0].segment.start
    assert elsewhere.begins[0] == later.start
    assert np.ptp(time_of(left.rows[0])) < 10.0
