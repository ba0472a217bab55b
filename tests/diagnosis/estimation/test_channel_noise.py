"""The floor of a channel is the error that a right model has there, by the likelihood's noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest

from diagnosis.by_likelihood import noise_of
from diagnosis.data.dataset import Dataset, make_dataset, read_dataset
from diagnosis.estimation.channel_noise import ChannelNoise, channel_density
from diagnosis.estimation.evaluation import residuals_in
from diagnosis.models import channels
from dynamics.effects import CATALOGUE
from fixtures.outside_cases import Campaign, captured_flights, flown, vehicle_of
from fixtures.outside_sensors import Recorder
from fixtures.real_flights import DATA, px4_sih


@cache
def of_another_simulator() -> tuple[ChannelNoise, Dataset]:
    """Flights of an outside vehicle that hide nothing."""
    campaign = Campaign({}, {}, Recorder(100.0, noise=1.0), lag_declared=False, fast=False, flights=6, seed=8)
    (truths,) = flown([campaign])
    vehicle = vehicle_of(campaign)
    dataset = make_dataset(captured_flights(campaign, truths), vehicle)
    return noise_of(dataset, vehicle, CATALOGUE), dataset


@cache
def of_px4() -> tuple[ChannelNoise, Dataset]:
    """Flights of PX4's firmware with its true file."""
    logs = [
        DATA / "px4_sih_flights" / f"nothing_{name}.ulg.gz" for name in ("1_circle", "2_line", "3_warped_ellipse_2")
    ]
    dataset = read_dataset(logs, px4_sih())
    return noise_of(dataset, px4_sih(), CATALOGUE), dataset


def rms(noise: ChannelNoise, dataset: Dataset) -> np.ndarray:
    """(12,) of the residuals of all flights."""
    return np.sqrt(np.mean(np.vstack(residuals_in(noise, noise.vehicle, dataset.everything)) ** 2, axis=0))


def test_it_is_what_a_right_model_leaves_of_flights_of_another_simulator():
    noise, dataset = of_another_simulator()
    np.testing.assert_allclose(noise.floor, rms(noise, dataset), rtol=0.25)


def test_an_estimators_drift_is_in_it_where_a_slow_force_counts():
    noise, dataset = of_px4()
    measured = rms(noise, dataset)[channels.MOTION]
    ratio = replace(noise, slow=True).floor[channels.MOTION] / measured
    assert ratio.min() > 0.6
    assert ratio.max() < 1.6


def test_it_does_not_grow_with_what_the_model_lacks():
    """By the residuals alone the floor of a wrong inertia would be that of its error."""
    noise, dataset = of_another_simulator()
    own = noise.vehicle.body
    body = msgspec.structs.replace(own, inertia=tuple(0.6 * x for x in own.inertia))
    wrong = noise_of(dataset, msgspec.structs.replace(noise.vehicle, body=body), CATALOGUE)
    error = rms(wrong, dataset)
    turning = channels.ANGULAR_ACCELERATION
    assert (error[turning] / noise.floor[turning]).max() > 2
    np.testing.assert_allclose(wrong.floor[turning], noise.floor[turning], rtol=0.3)


def test_the_sensors_part_is_the_floor_without_the_rotors_turbulence():
    noise, _ = of_another_simulator()
    assert (noise.sensors <= noise.floor).all()
    turning = channels.ANGULAR_ACCELERATION
    assert noise.sensors[turning].max() < 0.5 * noise.floor[turning].max()


def test_white_noise_of_a_gyro_is_differentiated_in_the_angular_acceleration():
    noise, _ = of_another_simulator()
    frequency, plant, fit = np.array([3.0]), noise.problems[0].plant(), noise.fits[0]
    alone = tuple(name for name in (c.name for c in fit.composition.components) if name != "gyro")
    level = replace(fit, values={**fit.values, "gyro.filter_time": 1e-9, "gyro.walk": 1e-9})
    density = channel_density(plant, level, frequency, alone)[channels.ANGULAR_ACCELERATION, 0]
    expected = [(2 * np.pi * 3.0 * fit.values[f"gyro.density_{axis}"]) ** 2 for axis in "xyz"]
    assert density == pytest.approx(expected, rel=0.02)


def test_absent_channels_have_no_floor():
    noise, dataset = of_another_simulator()
    blind = replace(dataset, fitted=tuple(replace(s, specific_force=None) for s in dataset.fitted))
    without = noise_of(blind, noise.vehicle, CATALOGUE)
    assert (without.floor[channels.SPECIFIC_FORCE] == 0).all()
    assert (without.floor[channels.POSE_ACCELERATION] > 0).all()
