"""A column that stands still is no measurement, unless the others of its quantity leave it no choice."""

from collections.abc import Mapping

import numpy as np

from dynamics.arrays import Floats
from flights.flight import Flight
from flights.log import Origin, Provenance
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


def counted(seed: int) -> dict[str, Floats]:
    """6 s at 100 Hz of four rotors' speeds in steps of 3 rad/s, which repeat a few times, and of a noisy gyro."""
    random, time = np.random.default_rng(seed), np.arange(600) / 100.0
    speeds = 900 + 80 * np.sin(2 * time[:, None] + np.arange(4)) + random.normal(0.0, 3.0, (600, 4))
    columns = {f"rotor_speed_{i}": 3.0 * np.round(speeds[:, i] / 3.0) for i in range(4)}
    return columns | {f"rate_{axis}": random.normal(0.0, 0.1, 600) for axis in "xyz"}


def flown(columns: Mapping[str, Floats], origins: Mapping[str, Origin] | None = None) -> Flight:
    return Flight(np.arange(600) / 100.0, columns, Provenance("a.csv", "", "csv", ""), origins or {})


def test_a_rotor_speed_may_not_stand_for_half_a_second_that_otherwise_changes_every_row():
    columns = counted(0)
    assert frozen_rows(flown(columns)) == {}
    columns["rotor_speed_1"][300:350] = columns["rotor_speed_1"][300]
    ((name, rows),) = frozen_rows(flown(columns)).items()
    assert name == "rotor_speed_1"
    assert np.array_equal(np.flatnonzero(rows), np.arange(300, 350))


def test_a_commanded_speed_may_not_either():
    columns = {name.replace("speed", "speed_command"): values for name, values in counted(0).items()}
    columns["rotor_speed_command_1"][300:350] = columns["rotor_speed_command_1"][300]
    assert list(frozen_rows(flown(columns))) == ["rotor_speed_command_1"]


def test_a_pose_that_stands_still_as_a_whole_while_the_gyro_does_not_is_frozen():
    columns = counted(1)
    time = np.arange(600) / 100.0
    columns |= {f"position_{axis}": np.sin(time + k) for k, axis in enumerate("xyz")}
    for axis in "xyz":
        columns[f"position_{axis}"][200:240] = columns[f"position_{axis}"][200]
    assert set(frozen_rows(flown(columns))) == {"position_x", "position_y", "position_z"}


def test_a_rotor_at_the_end_of_its_range_is_none_that_froze():
    columns = counted(2)
    columns["rotor_speed_2"][300:350] = columns["rotor_speed_2"].max()
    columns["rotor_speed_3"][300:350] = columns["rotor_speed_3"].min()
    assert frozen_rows(flown(columns)) == {}


def test_a_speed_that_is_logged_slowly_is_none_that_froze():
    columns = counted(3)
    columns["rotor_speed_0"] = np.repeat(columns["rotor_speed_0"][::30], 30)
    assert frozen_rows(flown(columns)) == {}
    steps = np.interp(np.arange(600), np.arange(0, 601, 30), [5.0, 5.0, *range(6, 25)])
    assert frozen_rows(flown(columns | {"rotor_speed_0": steps}, {"rotor_speed": Origin("esc", 3.3, 20)})) == {}


def test_a_column_that_rests_now_and_then_may_rest_for_longer():
    columns = counted(4)
    for start, stop in ((100, 112), (200, 220), (300, 350)):
        columns["rotor_speed_1"][start:stop] = columns["rotor_speed_1"][start]
    assert frozen_rows(flown(columns)) == {}
