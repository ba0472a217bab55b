"""What changes next to nothing of the motion is not named, however quiet the sensors; what it leaves is no unknown."""

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.rotorpy_flights import PATHS, rotorpy_flights

SOME = {n: CATALOGUE[n] for n in ("inertia", "torque_constant", "rotor_drag", "gyro_bias", "imu_bias", "time_delay")}


@pytest.mark.parametrize(("ratio", "named"), [(0.993, False), (1.05, True)])
def test_an_inertia_below_a_percent_is_not_named_for_the_quietest_sensors(arpl_250g, ratio, named):
    use = EffectUse("inertia", {"ratio_x": ratio, "ratio_y": ratio, "ratio_z": 1.0})
    flights = rotorpy_flights(arpl_250g, [use], seed=5, noise=0.2, paths=[PATHS[0], PATHS[2], PATHS[7]], duration=8.0)
    answer = diagnose_dataset(make_dataset(flights, arpl_250g), arpl_250g, SOME).diagnosis
    assert ("inertia" in {e.name for e in answer.effects}) is named
    if not named:
        assert answer.verdict == "explained"
