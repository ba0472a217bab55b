"""An effect that a log cannot show is no candidate: scale of the inertial sensors needs a pose of another source."""

from dataclasses import replace

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.selection.visibility import can_show
from dynamics.effects import CATALOGUE
from fixtures.compiled_flights import compiled_flights


@pytest.fixture(scope="module")
def segment(arpl_250g):
    manoeuvres = ("line:laps=3,ramp=1", "Lemniscate:laps=4,ramp=1.5,speed=0.9")
    flights = compiled_flights(arpl_250g, catalogue=CATALOGUE, seed=2, manoeuvres=manoeuvres)
    return make_dataset(flights, arpl_250g).everything[0]


@pytest.mark.parametrize("name", ["gyro_scale", "imu_scale"])
def test_a_scale_shows_against_a_pose_that_is_not_made_of_the_sensor(arpl_250g, segment, name):
    def shown(some):
        return can_show(CATALOGUE[name], [some], arpl_250g, CATALOGUE)

    assert shown(segment)
    assert not shown(replace(segment, pose_source="estimator"))
    assert not shown(replace(segment, lacks=frozenset({"position", "velocity", "attitude"})))


def test_a_turned_accelerometer_shows_without_a_pose(arpl_250g, segment):
    bare = replace(segment, lacks=frozenset({"position", "velocity", "attitude"}))
    assert can_show(CATALOGUE["imu_misalignment"], [bare], arpl_250g, CATALOGUE)


@pytest.mark.parametrize(("name", "shown"), [("gyro_scale", False), ("gyro_bias", False), ("imu_bias", True)])
def test_a_gyro_that_was_not_logged_has_no_fault(arpl_250g, segment, name, shown):
    """A log without rates hid an inertia and was told of a gyro's scale, by all resamples."""
    assert can_show(CATALOGUE[name], [replace(segment, gyro=None)], arpl_250g, CATALOGUE) == shown
    assert can_show(CATALOGUE[name], [segment], arpl_250g, CATALOGUE)
