"""A table's pose is an estimator's where its velocity holds the accelerometer's noise."""

import dataclasses

import numpy as np
import pytest

from diagnosis.data.pose import pose_source
from dynamics.vehicle import GRAVITY
from flights import Flight, Origin, Provenance

RATE, ROWS = 100.0, 4000


def table(velocity_of, *, seed=0):
    """A flight that swings; its velocity is what velocity_of makes of acceleration as read and true velocity."""
    random = np.random.default_rng(seed)
    time = np.arange(ROWS) / RATE
    swing = np.column_stack([np.sin(time), np.cos(1.3 * time), 0.3 * np.sin(0.7 * time)])
    acceleration = np.gradient(swing, 1 / RATE, axis=0) + 0.15 * random.standard_normal((ROWS, 3))
    velocity = velocity_of(acceleration, swing, random)
    force = acceleration + np.array([0.0, 0.0, GRAVITY])
    columns = {f"specific_force_{axis}": force[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"velocity_{axis}": velocity[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"attitude_{part}": np.full(ROWS, float(part == "w")) for part in "wxyz"}
    return Flight(time, columns, Provenance("flight.csv", "", "flight CSV", "flights.readers.csv"))


def integrated(acceleration, swing, random):
    return swing[0] + np.cumsum(acceleration, axis=0) / RATE


def captured(acceleration, swing, random):
    return swing + 0.003 * random.standard_normal(swing.shape)


def test_a_velocity_with_the_accelerometers_noise_is_an_estimators():
    assert pose_source(table(integrated)) == "estimator"
    assert pose_source(table(captured)) == "unknown"


@pytest.mark.parametrize("declared", ["motion_capture", "estimator"])
def test_what_log_or_user_tell_is_believed(declared):
    for made in (integrated, captured):
        assert pose_source(dataclasses.replace(table(made), metadata={"pose_source": declared})) == declared


def test_what_cannot_be_compared_is_unknown():
    flight = table(integrated)
    without = {name: values for name, values in flight.columns.items() if not name.startswith("specific_force")}
    assert pose_source(dataclasses.replace(flight, values=without)) == "unknown"
    slow = {"velocity": Origin("velocity_x, ..., velocity_z", 20.0, 800)}
    assert pose_source(dataclasses.replace(flight, origins=slow)) == "unknown"
    assert pose_source(flight.rows(0, 500)) == "unknown"
