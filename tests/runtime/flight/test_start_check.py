"""A reference is flown only from a place from which it leads neither into the ground nor far away."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.arrays import Floats
from dynamics.state import POSITION, RIGID_BODY_STATES
from runtime.flight.start_check import MAX_DISTANCE, MIN_CLEARANCE, start_refusal


class Line:
    """A motion along a straight line, at a constant velocity."""

    def __init__(
        self, start: tuple[float, float, float], velocity: tuple[float, float, float], duration: float
    ) -> None:
        self.start, self.velocity, self.duration = np.array(start), np.array(velocity), duration

    def states(self, times: Floats) -> Floats:
        states = np.zeros((times.size, RIGID_BODY_STATES))
        states[:, POSITION] = self.start + np.outer(times, self.velocity)
        return states

    def inputs(self, times: Floats) -> Floats:
        return np.zeros((times.size, 4))


def test_a_reference_above_the_vehicle_is_accepted() -> None:
    assert start_refusal(Line((1.0, 0.0, 1.5), (0.5, 0.0, 0.0), 4.0), np.zeros(3), on_ground=True) == ""


@pytest.mark.parametrize(("excess", "refused"), [(-0.1, False), (0.1, True)])
def test_a_start_is_refused_from_the_greatest_distance_on(excess: float, refused: bool) -> None:
    motion = Line((MAX_DISTANCE + excess, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)
    refusal = start_refusal(motion, np.zeros(3), on_ground=False)
    assert bool(refusal) == refused
    assert refused == ("0.0, 0.0, 0.0 m (east, north, up)" in refusal)


@pytest.mark.parametrize(("lowest", "refused"), [(MIN_CLEARANCE + 0.02, False), (MIN_CLEARANCE - 0.02, True)])
def test_a_reference_has_to_clear_the_ground_under_a_standing_vehicle(lowest: float, refused: bool) -> None:
    ground = np.array([0.0, 0.0, 7.0])
    motion = Line((0.0, 0.0, 8.0), (0.0, 0.0, (lowest - 1.0) / 2.0), 2.01)
    assert bool(start_refusal(motion, ground, on_ground=True)) == refused
    assert start_refusal(motion, ground, on_ground=False) == ""


def test_an_endless_reference_is_checked_in_finite_time() -> None:
    assert "comes down to" in start_refusal(
        Line((0.0, 0.0, 1.0), (0.0, 0.0, -0.01), np.inf), np.zeros(3), on_ground=True
    )


def test_a_reference_that_counts_from_the_vehicle_clears_the_ground_wherever_the_estimate_puts_it() -> None:
    motion = Line((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 2.0)
    for height in (-0.7, 1.09):
        assert start_refusal(motion, np.array([0.0, 0.0, height]), on_ground=True, from_here=True) == ""
    assert "--origin takeoff" in start_refusal(motion, np.array([0.0, 0.0, 1.09]), on_ground=True)


def test_the_allowed_box_is_checked_from_where_the_vehicle_stands() -> None:
    motion, box = Line((0.0, 0.0, 1.0), (0.5, 0.0, 0.0), 2.0), ((-2.0, -2.0, 0.0), (2.0, 2.0, 3.0))
    assert start_refusal(motion, np.zeros(3), on_ground=True, from_here=True, box=box) == ""
    refusal = start_refusal(motion, np.array([1.5, 0.0, 0.0]), on_ground=True, from_here=True, box=box)
    assert "1.50 to 2.49 m in x" in refusal
