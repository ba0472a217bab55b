"""An effect is accepted where held-out flights agree, and refused where they do not."""

import numpy as np
import pytest

from diagnosis.estimation.evaluation import reduced_chi_square
from diagnosis.estimation.paired_errors import ModelErrors, channel_changes
from diagnosis.thresholds import DEFAULT
from tests.diagnosis.synthetic import CHANNELS

LIMITS = DEFAULT.relevance


def noise_rows(seed, count=2):
    random = np.random.default_rng(seed)
    return [random.standard_normal((400, CHANNELS)) for _ in range(count)]


def compared_changes(before, after, floor=None):
    level = np.ones(CHANNELS) if floor is None else floor
    return channel_changes(ModelErrors(before), ModelErrors(after), level, 25.0, LIMITS)


def worse(before, after):
    by_kind = compared_changes(before, after)
    return {kind for kind, change in by_kind.items() if change.is_worse()}


def test_an_error_that_rises_in_one_kind_of_channel_is_no_gain_in_another():
    before = noise_rows(0)
    after = [y * np.repeat([0.5, 1.0, 1.0, 1.0], 3) for y in before]
    after = [y + np.repeat([0.0, 0.5, 0.0, 0.0], 3) for y in after]
    assert worse(before, after) == {"mocap"}
    assert worse(after, before) == {"imu"}


def test_a_change_by_chance_is_none():
    random = np.random.default_rng(1)
    before = noise_rows(0)
    after = [y + 0.01 * random.standard_normal(y.shape) for y in before]
    assert worse(before, after) == set()


def test_one_second_of_chaos_is_chance():
    before, after = noise_rows(0), noise_rows(0)
    after[0][:25] *= 12.0
    assert worse(before, after) == set()


def test_an_effect_on_one_axis_counts_as_much_as_one_on_all():
    floor = np.ones(CHANNELS)
    floor[6:9] = [10.0, 10.0, 1.0]
    after = [y * floor for y in noise_rows(0)]
    wave = 2.0 * np.sin(np.arange(400) / 20)[:, None] * floor
    about_z = wave * (np.arange(CHANNELS) == 8)
    one, every = (compared_changes([y + more for y in after], after, floor)["angular"] for more in (about_z, wave))
    assert 3 * one.rise == pytest.approx(every.rise, rel=0.2)
    assert one.rise < -LIMITS.max_rise / 3
    assert one.before == pytest.approx(np.sqrt(np.mean(np.sum((after[0] + about_z)[:, 6:9] ** 2, axis=1))), rel=0.05)


def test_what_errors_of_measured_states_make_of_a_model_is_no_error_of_the_model():
    """A model with the drag that is there is right, and feels an error of velocity that one without it does not."""
    random, drag = np.random.default_rng(3), 0.5
    velocity, error, drawn = (smooth(random, size) for size in (1.0, 1.5, 1.5))
    without = [y - drag * velocity for y in noise_rows(0)]
    right = [y + drag * error for y in noise_rows(0)]  # measured velocities are the true ones and the error
    assert "imu" in worse(without, right)
    of_inputs = [[drag * drawn] * 2]
    before, after = ModelErrors(without, [[0 * drawn] * 2]), ModelErrors(right, of_inputs)
    compared = channel_changes(before, after, np.ones(CHANNELS), 25.0, LIMITS)
    assert not any(change.is_worse() for change in compared.values())
    fallen = -np.mean(compared["imu"].by_axis)  # the mean square of what the drag pushes, of unit velocity
    assert fallen == pytest.approx(drag**2, abs=0.15)


def smooth(random, size):
    """(400, 12) slow motion that the accelerometer feels, m/s^2 in each axis."""
    angle = np.arange(400)[:, None] / random.uniform(8, 20, CHANNELS) + random.uniform(0, 6, CHANNELS)
    return size * np.sqrt(2) * np.sin(angle) * np.repeat([1.0, 0.0, 0.0, 0.0], 3)


def test_what_else_is_missing_does_not_hide_a_change():
    gust = [3 * np.sin(np.arange(400) / 30)[:, None] for _ in range(2)]
    before = [y + 0.5 * np.cos(np.arange(400))[:, None] for y in noise_rows(0)]
    clear, hidden = (
        compared_changes(
            [b + g for b, g in zip(before, more, strict=True)],
            [y + g for y, g in zip(noise_rows(0), more, strict=True)],
        )["imu"]
        for more in ([0.0, 0.0], gust)
    )
    assert hidden.rise == pytest.approx(clear.rise, rel=0.15)


def test_noise_alone_has_a_reduced_chi_square_of_one():
    rows = noise_rows(3, count=10)
    assert reduced_chi_square(rows, np.ones(CHANNELS)) == pytest.approx(1.0, abs=0.03)
