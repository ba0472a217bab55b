"""The filter's likelihood is that of the Gaussian with the analytic autocovariance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from diagnosis.noise.component import hover
from diagnosis.noise.components import CATALOGUE, gyro
from diagnosis.noise.components.gyro import SENSOR_PRIOR
from diagnosis.noise.composition import Composition
from diagnosis.noise.discretisation import discretise
from diagnosis.noise.linear_model import LinearModel, compose, gauss_markov, read_noise, white
from dynamics.arrays import Floats
from dynamics.vehicle_file import read_vehicle
from tests.diagnosis.noise import gaussian
from tests.diagnosis.noise.kalman_filter import Filtered, filter_rows
from vehicles import FOLDER

VEHICLE = read_vehicle(FOLDER / "px4_sih.toml")
PERIOD, COUNT = 0.02, 40
POSE_RATE = 150.0  # 3 readings a row


def filtered(names: str, values: dict[str, float], readings: dict[str, Floats], period: float = PERIOD) -> Filtered:
    """The readings of some outputs, all others missing, filtered; sensors and those with white noise are means."""
    components = {**CATALOGUE, "gyro": gyro.WHITE}  # whose covariance has a closed form
    composition = Composition(tuple(components[name] for name in names.split()))
    conditions = hover(VEHICLE, period, POSE_RATE, command_rate=250.0)
    model = composition.model(composition.medians(VEHICLE) | values, conditions)
    means = [name for name in model.outputs if name.startswith(("gyro", "accelerometer", "rotor_speed"))]
    count = len(next(iter(readings.values())))
    rows = np.full((count, len(model.outputs)), np.nan)
    for output, column in readings.items():
        rows[:, model.outputs.index(output)] = column
    return filter_rows(discretise(model, period, means), model.start_covariance(), rows)


def with_gaps(values: Floats, seed: int) -> Floats:
    """Some readings missing, and a few rows in a row."""
    gaps = np.random.default_rng(seed).random(values.shape) < 0.2
    gaps[7:11] = True
    return np.where(gaps, np.nan, values)


@pytest.mark.parametrize(("names", "values", "output", "covariance"), [
    (
        "turbulence slow_turbulence",
        {"turbulence.force_xy": 0.3, "turbulence.force_time": 0.05,
         "slow_turbulence.force_xy": 0.2, "slow_turbulence.force_time": 1.5},
        "force_x",
        gaussian.exponential(gaussian.lags(COUNT, PERIOD), 0.3, 0.05)
        + gaussian.exponential(gaussian.lags(COUNT, PERIOD), 0.2, 1.5),
    ),
    (
        "turbulence", {"turbulence.torque_z": 0.01, "turbulence.torque_time": 0.007}, "torque_z",
        gaussian.exponential(gaussian.lags(COUNT, PERIOD), 0.01, 0.007),
    ),
    (
        "smooth_estimator motion_capture",
        {"smooth_estimator.position_std": 0.02, "smooth_estimator.position_time": 0.7,
         "smooth_estimator.smoothing": 0.05, "motion_capture.position": 0.003},
        "position_y",
        gaussian.smooth(gaussian.lags(COUNT, PERIOD), 0.02, 0.7, 0.05) + 0.003**2 / 3 * np.eye(COUNT),
    ),
    (
        "dryden_gust", {"dryden_gust.std": 1.2, "dryden_gust.length": 0.6}, "air_x",
        gaussian.exponential(gaussian.lags(COUNT, PERIOD), 1.2, 0.5),
    ),
    (
        "dryden_gust", {"dryden_gust.std": 1.2, "dryden_gust.length": 0.6}, "air_z",
        gaussian.dryden_across(gaussian.lags(COUNT, PERIOD), 1.2, 0.5),
    ),
    (
        "gyro", {"gyro.density_y": 0.002, "gyro.walk": 0.02}, "gyro_y",
        gaussian.sensor_means(COUNT, PERIOD, 0.002, 0.02, SENSOR_PRIOR),
    ),
    (
        "held_commands", {"held_commands.walk": 30.0}, "rotor_speed_2",
        30.0**2 * PERIOD * 4 * 9 / (6 * 25) * np.eye(COUNT),  # 5 commands a row
    ),
])  # fmt: skip
def test_one_output_has_the_likelihood_of_its_autocovariance(
    names: str, values: dict[str, float], output: str, covariance: Floats
) -> None:
    series = np.linalg.cholesky(covariance) @ np.random.default_rng(1).standard_normal(COUNT)
    for readings in (series, with_gaps(series, 2), 3 * series[::-1]):
        expected = gaussian.log_density(readings, covariance)
        assert filtered(names, values, {output: readings}).log_likelihood == pytest.approx(expected, rel=1e-9)


def test_means_over_rows_have_the_likelihood_of_integrated_processes() -> None:
    model = compose([gauss_markov("x", 0.4, 0.03), gauss_markov("y", 0.2, 0.5), white("y", 0.01)])
    covariance = np.zeros((2 * COUNT, 2 * COUNT))
    covariance[:COUNT, :COUNT] = gaussian.exponential_means(COUNT, PERIOD, 0.4, 0.03)
    covariance[COUNT:, COUNT:] = gaussian.exponential_means(COUNT, PERIOD, 0.2, 0.5) + 1e-4 / PERIOD * np.eye(COUNT)
    readings = with_gaps(np.random.default_rng(3).standard_normal((COUNT, 2)), 4)
    result = filter_rows(discretise(model, PERIOD, {"x", "y"}), model.start_covariance(), readings)
    assert result.log_likelihood == pytest.approx(gaussian.log_density(readings.T.ravel(), covariance), rel=1e-9)


INTEGRATING = {
    "gyro.density_z": 0.004, "gyro.walk": 0.003,
    "integrating_estimator.attitude_std": 0.01, "integrating_estimator.attitude_time": 0.9,
}  # fmt: skip


def estimator_covariance() -> Floats:
    """Of attitude and gyro about body z, one after the other."""
    own, shared = gaussian.decay_with_sensor(COUNT, PERIOD, 0.004, 0.01, 0.9)
    return np.block([[own, shared], [shared.T, gaussian.sensor_means(COUNT, PERIOD, 0.004, 0.003, SENSOR_PRIOR)]])


def test_an_estimator_shares_the_noise_of_the_gyro_that_it_integrates() -> None:
    covariance = estimator_covariance()
    series = (np.linalg.cholesky(covariance) @ np.random.default_rng(5).standard_normal(2 * COUNT)).reshape(2, COUNT)
    names = "integrating_estimator gyro accelerometer"
    for attitude, rate in (series, with_gaps(series.T, 6).T, series[:, ::-1]):
        expected = gaussian.log_density(np.concatenate([attitude, rate]), covariance)
        computed = filtered(names, INTEGRATING, {"attitude_z": attitude, "gyro_z": rate})
        assert computed.log_likelihood == pytest.approx(expected, rel=1e-9)


def test_the_likelihood_says_whether_an_estimator_integrates_the_logged_gyro() -> None:
    covariance, count = estimator_covariance(), 30
    independent = covariance.copy()
    independent[:COUNT, COUNT:] = independent[COUNT:, :COUNT] = 0.0
    values = INTEGRATING | {
        "smooth_estimator.attitude_std": float(np.sqrt(covariance[0, 0])),
        "smooth_estimator.attitude_time": 0.9, "smooth_estimator.smoothing": 1e-4,
    }  # fmt: skip
    random = np.random.default_rng(7)
    for truth, better in ((covariance, 1.0), (independent, -1.0)):
        gain = []
        for _ in range(count):
            attitude, rate = (np.linalg.cholesky(truth) @ random.standard_normal(2 * COUNT)).reshape(2, COUNT)
            rows = {"attitude_z": attitude, "gyro_z": rate}
            structures = [f"{name} gyro accelerometer" for name in ("integrating_estimator", "smooth_estimator")]
            shared, apart = [filtered(names, values, rows).log_likelihood for names in structures]
            gain.append(better * (shared - apart))
        assert np.mean(gain) > 4 * np.std(gain) / np.sqrt(count)


def ljung_box(residuals: Floats, lags: int = 20) -> float:
    """Level at which a series is not white (Ljung and Box, Biometrika 65, 1978)."""
    n = len(residuals)
    correlations = np.array([residuals[k:] @ residuals[:-k] for k in range(1, lags + 1)]) / (residuals @ residuals)
    return float(stats.chi2.sf(n * (n + 2) * np.sum(correlations**2 / (n - np.arange(1, lags + 1))), lags))


def levels(model: LinearModel, covariance: Floats, count: int) -> list[float]:
    """Levels of the innovations of some series that are drawn from a covariance."""
    discrete, start, cholesky = discretise(model, PERIOD), model.start_covariance(), np.linalg.cholesky(covariance)
    result = []
    for seed in range(count):
        series = cholesky @ np.random.default_rng([11, seed]).standard_normal(len(covariance))
        result.append(ljung_box(filter_rows(discrete, start, series[:, None]).whitened[:, 0]))
    return result


def test_innovations_are_white_at_the_level_and_not_with_one_time_scale_of_two() -> None:
    def covariance(rows: int) -> Floats:
        lag = gaussian.lags(rows, PERIOD)
        return gaussian.exponential(lag, 0.3, 0.03) + gaussian.exponential(lag, 0.3, 1.0) + 1e-3 * np.eye(rows)

    noise = read_noise("force_x", 1e-3)
    slow = LinearModel(("s",), ("s",), ("force_x",), -np.eye(1), np.eye(1), np.eye(1), np.full(1, 0.18))
    computed = levels(compose([gauss_markov("force_x", 0.3, 0.03), slow, noise]), covariance(300), 100)
    assert stats.kstest(computed, "uniform").pvalue > 0.001
    assert stats.binomtest(sum(level < 0.05 for level in computed), 100, 0.05).pvalue > 0.001
    single = compose([gauss_markov("force_x", 0.3 * np.sqrt(2), 0.3), noise])
    assert np.mean(np.array(levels(single, covariance(600), 15)) < 0.05) > 0.9
