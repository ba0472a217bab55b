import numpy as np
import pytest

from sitl_mock.vehicle.clock import UnevenTime, VehicleClock


def test_a_simulations_stamps_count_in_its_steps() -> None:
    clock = VehicleClock(tick=0.004)
    stamps = [clock.at(0.001 * i) for i in range(400)]
    assert set(np.round(np.diff(stamps), 9)) == {0.0, 0.004}
    assert clock.at(0.4) == pytest.approx(3.4)


def test_simulated_time_steps_several_times_a_minute_in_both_directions() -> None:
    uneven = UnevenTime(seed=5)
    steps = [step for step in (uneven.step(0.01 * i) for i in range(60_000)) if step]  # 10 minutes
    assert 20 <= len(steps) <= 60
    assert all(0.005 <= abs(step) <= 0.018 for step in steps)
    assert min(steps) < 0.0 < max(steps)
