"""What changes next to nothing of the motion is a hint, however quiet the sensors; what is left by it is no unknown."""

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.estimation.refusal import Refused, reason_of
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.rotorpy_flights import PATHS, rotorpy_flights

SOME = {n: CATALOGUE[n] for n in ("inertia", "torque_constant", "rotor_drag", "gyro_bias", "imu_bias", "time_delay")}


@pytest.mark.parametrize(("ratio", "named"), [(0.993, False), (1.05, True)])
def test_an_inertia_below_a_percent_is_a_hint_for_the_quietest_sensors(arpl_250g, ratio, named):
    use = EffectUse("inertia", {"ratio_x": ratio, "ratio_y": ratio, "ratio_z": 1.0})
    flights = rotorpy_flights(arpl_250g, [use], seed=5, noise=0.2, paths=[PATHS[0], PATHS[2], PATHS[7]], duration=8.0)
    answer = diagnose_dataset(make_dataset(flights, arpl_250g), arpl_250g, SOME).diagnosis
    assert ("inertia" in {e.name for e in answer.effects}) is named
    if not named:
        assert answer.verdict == "explained"
        assert all(one.reason == "slight" for one in answer.refused if one.name == "inertia")


def test_a_slight_effect_is_a_hint_that_no_flight_is_planned_for():
    slight = Refused("inertia", None, "slight", {"share": 0.004, "required": 0.01}, "angular")
    assert slight.is_hint
    assert not slight.is_open
    assert "0.004" in reason_of(slight)
