"""A damaged propeller is told from a speed sensor's fault where they differ, and declared where they do not."""

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.compiled_flights import compiled_flights

NAMES = ("weak_rotor", "rotor_speed_fault", "rotor_cant", "centre_of_mass", "imu_bias", "gyro_bias", "time_delay")
SOME = {name: CATALOGUE[name] for name in NAMES}
MANOEUVRES = ("line:laps=3,ramp=1", "bob:laps=4,ramp=1,height=0.25", "Lemniscate:laps=4,ramp=1.5,speed=0.9") * 2


def diagnosed(vehicle, use):
    flights = compiled_flights(vehicle, [use], catalogue=CATALOGUE, seed=3, manoeuvres=MANOEUVRES)
    return diagnose_dataset(make_dataset(flights, vehicle), vehicle, SOME).diagnosis


def test_a_propeller_that_lost_thrust_and_torque_alike_is_not_taken_for_a_sensor(arpl_250g):
    diagnosis = diagnosed(arpl_250g, EffectUse("weak_rotor", {"loss": 0.05, "torque_loss": 0.05}, 2))
    assert diagnosis.verdict == "ambiguous"
    first = diagnosis.effects[0]
    assert {first.name, *first.ambiguous_with} == {"weak_rotor", "rotor_speed_fault"}
    assert first.rotor == 2


@pytest.mark.parametrize("torque_loss", [0.0, 0.08])
def test_a_propeller_that_lost_them_in_other_shares_is_a_propeller(arpl_250g, torque_loss):
    diagnosis = diagnosed(arpl_250g, EffectUse("weak_rotor", {"loss": 0.05, "torque_loss": torque_loss}, 2))
    assert [(effect.name, effect.rotor) for effect in diagnosis.effects] == [("weak_rotor", 2)]
    (effect,) = diagnosis.effects
    assert not effect.ambiguous_with
    assert effect.parameters["loss"].value == pytest.approx(0.05, abs=0.002)
    assert effect.parameters["torque_loss"].value == pytest.approx(torque_loss, abs=0.002)
