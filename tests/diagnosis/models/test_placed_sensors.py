"""Open loop starts at the centre of mass, wherever the sensors are."""

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.models.open_loop import open_loop_errors
from diagnosis.models.rollout import healthy
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.compiled_flights import compiled_flights

PLACED = (
    EffectUse("pose_lever_arm", {"x": 0.05, "y": 0.0, "z": 0.1}),
    EffectUse("imu_misalignment", {"x": 0.05, "y": 0.0, "z": 0.1, "gyro_turns": 1.0}),
    EffectUse("attitude_delay", {"delay": 0.03}),
)


@pytest.fixture(scope="module")
def flown(arpl_250g):
    def segments(*effects):
        flights = compiled_flights(arpl_250g, effects, catalogue=CATALOGUE, seed=2, manoeuvres=MANOEUVRES)
        return make_dataset(flights, arpl_250g).everything

    return segments(), segments(*PLACED)


MANOEUVRES = ("Lemniscate:laps=4,ramp=1.5,speed=0.9", "line:laps=3,ramp=1")


def test_sensors_that_the_file_places_leave_open_loop_as_it_was(arpl_250g, flown):
    plain, placed = flown
    expected = open_loop_errors(arpl_250g, CATALOGUE, plain)
    with_places = open_loop_errors(arpl_250g.with_effects(*PLACED), CATALOGUE, placed)
    without_places = open_loop_errors(arpl_250g, CATALOGUE, placed)
    for right, named, wrong in zip(expected, with_places, without_places, strict=True):
        assert named.velocity < 1.5 * right.velocity
        assert named.rate < 1.5 * right.rate
        assert wrong.velocity > 1.5 * right.velocity


def test_a_centre_of_mass_keeps_its_moment_where_sensors_are_put_right(arpl_250g, flown):
    vehicle = arpl_250g.with_effects(EffectUse("centre_of_mass", {"x": 0.01, "y": 0.0, "z": 0.0}), *PLACED)
    rest, (segment, *_) = healthy(vehicle, CATALOGUE, flown[0])
    assert [use.name for use in rest.effects] == ["centre_of_mass"]
    assert segment.position.shape == flown[0][0].position.shape
