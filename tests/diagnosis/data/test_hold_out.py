"""What is held out moves as the rest does, and shares no row with it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.data.hold_out import divided, held_out_blocks, missing_motion
from diagnosis.thresholds import DEFAULT
from tests.diagnosis.synthetic import hovering

LIMITS, MIN_DURATION = DEFAULT.dataset, DEFAULT.segment.min_duration


def flying(vehicle, *, seed, duration=60.0, speed, yaw_rate=0.0):
    """A segment with a horizontal speed over time, given at equal intervals, and a yaw rate while it is above 0."""
    (segment,) = hovering(vehicle, mass_ratio=1.0, seed=seed, duration=duration)
    along = np.interp(np.linspace(0, 1, len(segment)), np.linspace(0, 1, len(speed)), speed)
    velocity = np.column_stack([along, 0 * along, 0.1 * along])
    gyro = segment.gyro + np.column_stack([0 * along, 0 * along, yaw_rate * (along > 0)])
    position = np.cumsum(velocity, axis=0) / segment.rate
    return replace(segment, position=position, velocity=velocity, gyro=gyro, lacks=frozenset())


def speed_of(segments):
    return float(np.sqrt(np.mean(np.concatenate([s.velocity[:, 0] for s in segments]) ** 2)))


def test_a_flight_that_ends_in_hover_is_judged_where_it_flies(arpl_250g):
    segment = flying(arpl_250g, seed=0, speed=[0, 4, 0, 4, 0, 4, 0, 0, 0])
    (fitted,), held_out = divided([[segment]], held_out_blocks([[segment]], LIMITS, MIN_DURATION), MIN_DURATION)
    assert speed_of(held_out) == pytest.approx(speed_of(fitted), rel=0.3)
    assert sum(s.duration for s in held_out) == pytest.approx(0.2 * segment.duration, abs=4.0)


def test_held_out_blocks_share_no_row_with_what_is_fitted_and_leave_no_crumbs(arpl_250g):
    segment = flying(arpl_250g, seed=1, speed=[0, 4, 1, 4, 0, 2, 5, 0, 1])
    (fitted,), held_out = divided([[segment]], held_out_blocks([[segment]], LIMITS, MIN_DURATION), MIN_DURATION)
    ends = sorted((round(s.start, 6), round(s.start + s.duration, 6)) for s in (*fitted, *held_out))
    assert all(end == start for (_, end), (start, _) in pairwise(ends))
    assert ends[0][0] == 0.0
    assert ends[-1][1] == pytest.approx(segment.duration)
    assert all(s.duration >= LIMITS.min_part for s in fitted)


def test_motion_that_held_out_flights_lack_is_named(arpl_250g):
    line = flying(arpl_250g, seed=2, duration=12.0, speed=[0, 3, 0])
    spin = flying(arpl_250g, seed=3, duration=12.0, speed=[0, 3, 0], yaw_rate=4.0)
    assert missing_motion([spin, line], [line], LIMITS) == ["yaw rate"]
    assert missing_motion([spin, line], [spin], LIMITS) == []


def test_a_single_log_is_in_the_hashes_of_what_was_fitted(plain_flights, arpl_250g):
    dataset = make_dataset(plain_flights[:1], arpl_250g)
    assert dataset.hashes == {plain_flights[0].provenance.path: plain_flights[0].provenance.sha256}


def test_where_the_last_flight_only_climbs_blocks_of_all_are_held_out(plain_flights, arpl_250g):
    climbing = next(f for f in plain_flights if "flight_3" in f.provenance.path)
    flights = [*(f for f in plain_flights if f is not climbing), climbing]
    dataset = make_dataset(flights, arpl_250g)
    assert any("blocks of all flights" in note for note in dataset.notes)
    assert len({s.flight for s in dataset.fitted}) == len(flights)
    assert len(dataset.hashes) == len(flights)
    by_pattern = make_dataset(flights, arpl_250g, hold_out="flight_3*")
    assert {s.flight for s in by_pattern.held_out} == {"flight_3.csv"}
