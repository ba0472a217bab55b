"""Speeds between readings are interpolated, outputs count behind the motors' lag where no ESC speaks."""

import numpy as np
import pytest

from runtime.control.rotor_speeds import RotorSpeeds


def test_means_are_those_of_lines_between_readings() -> None:
    speeds = RotorSpeeds(lag=0.0)
    for time in (0.0, 0.01, 0.03):
        speeds.add(time, np.array([1000.0 * time, 5.0]), measured=True)
    mean = speeds.mean(0.005, 0.025)
    assert mean is not None
    np.testing.assert_allclose(mean, [15.0, 5.0])
    inside = speeds.mean(0.012, 0.018)
    assert inside is not None
    np.testing.assert_allclose(inside, [15.0, 5.0])


@pytest.mark.parametrize(("start", "stop"), [(-0.01, 0.005), (0.005, 0.02), (0.0, 0.01)])
def test_what_readings_do_not_cover_is_not_known(start: float, stop: float) -> None:
    speeds = RotorSpeeds(lag=0.0)
    assert speeds.mean(start, stop) is None
    speeds.add(0.0, np.array([1.0]), measured=True)
    speeds.add(0.01, np.array([1.0]), measured=True)
    assert (speeds.mean(start, stop) is None) == (start < 0.0 or stop > 0.01)


def test_speeds_across_a_gap_are_not_known() -> None:
    speeds = RotorSpeeds(lag=0.0)
    for time in (0.0, 0.01, 0.2, 0.21):
        speeds.add(time, np.array([1.0]), measured=True)
    assert speeds.mean(0.005, 0.205) is None
    assert speeds.mean(0.2, 0.21) is not None


def test_outputs_lag_and_give_way_to_measured_speeds() -> None:
    speeds = RotorSpeeds(lag=0.05)
    speeds.add(0.0, np.array([100.0]), measured=False)
    for step in range(1, 6):
        speeds.add(0.01 * step, np.array([200.0]), measured=False)
    mean = speeds.mean(0.049, 0.05)
    assert mean is not None
    assert mean[0] == pytest.approx(200.0 - 100.0 * np.exp(-1.0), abs=1.0)
    assert speeds.add(0.06, np.array([150.0]), measured=True)  # another kind
    assert not speeds.add(0.07, np.array([300.0]), measured=False)
    assert speeds.measured
    assert speeds.add(0.7, np.array([300.0]), measured=False)  # the ESCs have fallen silent
    assert not speeds.measured


def test_what_is_no_reading_is_left_out() -> None:
    speeds = RotorSpeeds(lag=0.0)
    speeds.add(0.0, np.array([1.0]), measured=True)
    speeds.add(0.01, np.array([np.nan]), measured=True)
    speeds.add(np.nan, np.array([1.0]), measured=True)
    speeds.add(-1.0, np.array([1.0]), measured=True)
    assert speeds.newest == 0.0
