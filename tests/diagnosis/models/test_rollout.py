"""Simulated windows: they end where the vehicle did, with what a faulty sensor reads put right."""

import msgspec
import numpy as np
import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.models.open_loop import open_loop_errors
from diagnosis.models.rollout import healthy
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse


@pytest.fixture(scope="module")
def plain(plain_flights, arpl_250g):
    return make_dataset(plain_flights, arpl_250g)


def test_windows_end_where_the_vehicle_did_only_with_the_right_mass(plain, arpl_250g):
    heavier = arpl_250g.with_effects(EffectUse("mass", {"ratio": 1.06}))
    right, wrong = (open_loop_errors(v, CATALOGUE, plain.held_out)[1] for v in (arpl_250g, heavier))
    assert right.horizon == wrong.horizon == 0.5
    assert right.velocity < 0.25 * wrong.velocity


def test_what_a_faulty_sensor_reads_is_put_right_before_simulating(plain, arpl_250g):
    faulty = arpl_250g.with_effects(
        EffectUse("rotor_speed_fault", {"gain": 0.5}, 2),
        EffectUse("gyro_bias", {"x": 0.1, "y": 0.0, "z": 0.0}),
        EffectUse("time_delay", {"delay": 0.02}),
        EffectUse("rotor_drag"),
    )
    rest, (mended,) = healthy(faulty, CATALOGUE, plain.held_out[:1])
    read = plain.held_out[0]
    assert [use.name for use in rest.effects] == ["rotor_drag"]
    assert mended.rotor_speed / read.rotor_speed == pytest.approx(np.tile([1, 1, 2, 1], (len(read), 1)))
    assert mended.gyro - read.gyro == pytest.approx(np.tile([-0.1, 0, 0], (len(read), 1)))
    late = round(0.02 * read.rate)
    assert mended.velocity[:-late] == pytest.approx(read.velocity[late:], abs=1e-9)
    same, untouched = healthy(msgspec.structs.replace(arpl_250g), CATALOGUE, plain.held_out)
    assert same == arpl_250g
    assert untouched == list(plain.held_out)
