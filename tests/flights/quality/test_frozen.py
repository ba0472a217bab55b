"""A column that stands still is no measurement, unless the others of its quantity leave it no choice."""

import numpy as np

from flights.flight import Flight
from flights.log import Provenance
from flights.quality.frozen import frozen_rows


def test_the_real_part_of_small_rotations_may_stand_still():
    time = np.arange(500) / 100.0
    small = np.round(0.008 * np.sin(3 * time), 4)
    columns = {"attitude_w": np.ones(500), "attitude_x": small, "attitude_y": small, "attitude_z": np.zeros(500)}
    flight = Flight(time, columns, Provenance("a.csv", "", "csv", ""))
    assert frozen_rows(flight) == {}


def test_the_real_part_of_large_rotations_may_not():
    time = np.arange(500) / 100.0
    large = 0.3 * np.sin(3 * time)
    columns = {"attitude_w": np.full(500, 0.95), "attitude_x": large, "attitude_y": 0 * time, "attitude_z": 0 * time}
    flight = Flight(time, columns, Provenance("a.csv", "", "csv", ""))
    assert frozen_rows(flight)["attitude_w"].all()
