"""Noise in the columns shrinks coefficients; the correction takes most of that back."""

import dataclasses

import numpy as np
import pytest

from diagnosis.selection.errors_in_variables import (
    design_errors,
    inertial_levels,
    noisier_segments,
    white_level,
)
from diagnosis.thresholds import DEFAULT
from tests.diagnosis.synthetic import CHANNELS, hovering, white


class OneColumn:
    """A design with the measured force along z as its column, and half of the true one as its residual."""

    def __init__(self, truth):
        self.truth = truth

    def evaluate(self, segment):
        rows = np.zeros((len(segment), CHANNELS))
        columns = np.zeros((len(segment), CHANNELS, 1))
        rows[:, 0] = 0.5 * self.truth
        columns[:, 0, 0] = segment.specific_force[:, 2] - segment.specific_force[:, 2].mean()
        return rows, columns


def test_the_level_of_white_noise_is_estimated_from_smooth_signals():
    random = np.random.default_rng(0)
    time = np.arange(5000) / 100
    smooth = np.column_stack([np.sin(time), np.cos(0.7 * time), time])
    levels = np.array([0.01, 0.03, 0.1])
    assert white_level(smooth + levels * random.standard_normal(smooth.shape)) == pytest.approx(levels, rel=0.05)


@pytest.mark.parametrize("rate", [25.0, 100.0, 400.0])
def test_the_level_of_an_inertial_sensors_noise_is_found_beside_motion(rate, arpl_250g):
    levels = np.array([0.01, 0.03, 0.1])
    time = np.arange(round(100 * rate)) / rate
    motion = np.column_stack([np.sin(time), np.cos(0.7 * time), np.sin(3 * time)])
    gyro = motion + levels * np.random.default_rng(0).standard_normal(motion.shape)
    assert inertial_levels([measuring(arpl_250g, gyro, rate)]).gyro == pytest.approx(levels, rel=0.15)


def test_an_autopilots_means_of_two_hide_their_noise_from_differences_only(arpl_250g):
    """As PX4 logs them: of their own size, but twice as dense below the cutoff as white noise of it."""
    white = np.random.default_rng(0).standard_normal((20001, 3))
    means = 0.1 * (white[1:] + white[:-1]) / np.sqrt(2)
    assert np.all(white_level(means) < 0.06)
    assert inertial_levels([measuring(arpl_250g, means, 250.0)]).gyro == pytest.approx(0.1 * np.sqrt(2), rel=0.1)


def measuring(vehicle, gyro, rate):
    """A segment at rate Hz with (n, 3) a gyro's values."""
    (segment,) = hovering(vehicle, mass_ratio=1.0, seed=1)
    return dataclasses.replace(segment, gyro=gyro, rate=rate)


def normal_equations(noise, columns, rows):
    """(k, k) and (k,) of whitened columns (m, 12, k) and rows (m, 12)."""
    white = noise.whiten(columns)
    flat = white.reshape(-1, white.shape[2])
    return flat.T @ flat, flat.T @ noise.whiten(rows).ravel()


def test_the_bias_of_a_noisy_column_is_estimated_and_removed(arpl_250g):
    (segment,) = hovering(arpl_250g, mass_ratio=1.0, seed=1, duration=200.0)
    smooth = 0.6 * np.sin(2 * np.pi * 0.3 * np.arange(len(segment)) / segment.rate)
    random = np.random.default_rng(2)
    force = np.column_stack([smooth, smooth, smooth]) + 0.3 * random.standard_normal((len(segment), 3))
    noisy = dataclasses.replace(segment, specific_force=force)
    design = OneColumn(smooth)
    rows, columns = design.evaluate(noisy)
    noise = white()
    gram, product = normal_equations(noise, columns, rows)
    ((row_errors, column_errors),) = design_errors(noisier_segments([noisy]), design, [rows], [columns])
    gram_bias, product_bias = normal_equations(noise, column_errors, row_errors)
    plain, corrected = product[0] / gram[0, 0], (product - product_bias)[0] / (gram - gram_bias)[0, 0]
    assert plain < 0.37
    assert corrected == pytest.approx(0.5, rel=0.03)


def test_perturbing_adds_the_sensors_noise_and_nothing_else(arpl_250g):
    (segment,) = hovering(arpl_250g, mass_ratio=1.0, seed=1)
    (noisier,) = noisier_segments([segment])
    added = noisier.specific_force - segment.specific_force
    assert np.std(added) == pytest.approx(0.1, rel=0.2)
    np.testing.assert_allclose(np.linalg.norm(noisier.attitude, axis=1), 1.0)
    assert noisier.flight == segment.flight
    commanded = dataclasses.replace(segment, rotor_source="command")
    np.testing.assert_array_equal(noisier_segments([commanded])[0].rotor_speed, segment.rotor_speed)


def test_an_estimators_velocity_errs_slowly_and_motion_captures_does_not(arpl_250g):
    (segment,) = hovering(arpl_250g, mass_ratio=1.0, seed=1, duration=600.0)
    limits = DEFAULT.pose
    for source, level in (
        ("motion_capture", 0.0),
        ("unknown", 0.0),
        ("estimator", np.sqrt(limits.certain) * limits.velocity_error),
    ):
        posed = dataclasses.replace(segment, pose_source=source)
        error = noisier_segments([posed])[0].velocity - segment.velocity
        slow = error[: len(error) // 20 * 20].reshape(-1, 20, 3).mean(axis=1)
        assert np.std(slow) == pytest.approx(level, rel=0.15, abs=0.01)
    later = round(limits.velocity_time * segment.rate)
    assert np.mean(error[later:] * error[:-later]) / np.var(error) == pytest.approx(np.exp(-1), abs=0.12)
