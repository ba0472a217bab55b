"""RotorPy shares no line with our dynamics: forces must agree, and what is hidden in its flights must be named."""

import numpy as np
import pytest
from rotorpy.vehicles.multirotor import Multirotor

from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.model import build_model
from dynamics.vehicle import EffectUse
from fixtures.rotorpy_flights import (
    MADE,
    NOT_MADE,
    PATHS,
    PLACED,
    WINDS,
    rotorpy_flights,
    rotorpy_parameters,
    with_effects,
)
from fixtures.rotorpy_sensors import READ_HERE

SOME = {n: CATALOGUE[n] for n in ("rotor_drag", "mass", "thrust_constant", "gyro_bias", "imu_bias", "time_delay")}


def test_every_effect_of_the_catalogue_is_made_or_listed_as_not_made():
    assert sorted([*MADE, *WINDS, *READ_HERE, *PLACED, *NOT_MADE]) == sorted(CATALOGUE)


@pytest.mark.parametrize("name", [name for name in MADE if name != "motor_lag"])
def test_rotorpy_computes_the_same_accelerations_as_our_model(arpl_250g, name):
    random = np.random.default_rng(7)
    use = EffectUse(name, CATALOGUE[name].defaults(arpl_250g))
    theirs = Multirotor(with_effects(rotorpy_parameters(arpl_250g), [use]))
    plain = build_model(arpl_250g, effects=[])
    model = build_model(arpl_250g, effects=[use])
    shows = 0.0
    for _ in range(5):
        velocity, rate = 3 * random.standard_normal(3), 2 * random.standard_normal(3)
        speed = arpl_250g.hover_speed * random.uniform(0.8, 1.2, 4)
        force, moment = theirs.compute_body_wrench(rate, speed, velocity)
        angular = theirs.inv_inertia @ (moment - np.cross(rate, theirs.inertia @ rate))
        state = np.concatenate([np.zeros(3), velocity, [1, 0, 0, 0], rate])
        ours, without = (m.observe(state, speed, m.parameter_values, [0.0, 1.0]) for m in (model, plain))
        assert np.array(ours[0]).ravel() == pytest.approx(force / theirs.mass, rel=1e-9, abs=1e-9)
        assert np.array(ours[1]).ravel() == pytest.approx(angular, rel=1e-9, abs=1e-9)
        shows += float(sum(np.linalg.norm(np.array(a - b)) for a, b in zip(ours[:2], without[:2], strict=True)))
    assert shows > 0.01


def test_a_drag_hidden_in_rotorpy_flights_is_named_with_its_value(arpl_250g):
    use = EffectUse("rotor_drag", {"coefficient": 1.5e-5})
    paths = [PATHS[0], PATHS[1], PATHS[7]]
    flights = rotorpy_flights(arpl_250g, [use], seed=1, paths=paths, duration=8.0)
    details = diagnose_dataset(make_dataset(flights, arpl_250g), arpl_250g, SOME)
    (named,) = details.diagnosis.effects
    estimate = named.parameters["coefficient"]
    assert named.name == "rotor_drag"
    assert estimate.value == pytest.approx(1.5e-5, rel=0.01)
    assert abs(estimate.value - 1.5e-5) < 4 * estimate.std
    assert details.chi_square_after < 1.3 < 5 < details.chi_square_before


def test_flights_are_the_same_for_the_same_seed_and_differ_for_another(arpl_250g):
    first, again, other = (
        rotorpy_flights(arpl_250g, seed=seed, paths=PATHS[:1], duration=1.0)[0]["specific_force"] for seed in (3, 3, 4)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_what_rotorpy_cannot_make_is_refused(arpl_250g):
    with pytest.raises(ValueError, match="cannot make slung_load"):
        rotorpy_flights(arpl_250g, [EffectUse("slung_load", {"mass": 0.02, "length": 0.5})], seed=0)
    with pytest.raises(ValueError, match="through drag"):
        rotorpy_flights(arpl_250g, [EffectUse("wind", {"x": 3.0})], seed=0)
