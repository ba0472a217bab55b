"""Rotor speeds between rows: a rotor that settles behind a held command is recognised, smooth speeds stay smooth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import alula
from diagnosis.data.filters import difference, mean_of_held, simpson
from diagnosis.data.rotor_hold import _Delay, _is_late, _Rows
from diagnosis.thresholds import DEFAULT

LIMITS = DEFAULT.rotor_hold
ROTORPY = Path(__file__).parents[2] / "data" / "rotorpy_100hz"


@pytest.mark.parametrize("lag_in_periods", [0.2, 0.5, 2.0])
def test_mean_of_a_rotor_that_settles_behind_a_held_command_gives_the_exact_change(lag_in_periods):
    command = np.random.default_rng(0).standard_normal((200, 1)).cumsum(axis=0)
    decay = np.exp(-1 / lag_in_periods)
    speed, angle = np.zeros((201, 1)), np.zeros((201, 1))
    for k in range(200):  # the exact solution of s' = (u - s) / tau, and its integral, over a period of 1
        speed[k + 1] = command[k] + (speed[k] - command[k]) * decay
        angle[k + 1] = angle[k] + command[k] + (speed[k] - command[k]) * lag_in_periods * (1 - decay)
    settled = lag_in_periods * (1 - decay)
    share = (1 - settled) / (1 - decay)
    inner = slice(1, -1)
    read = simpson(mean_of_held(speed, share))
    assert read[inner] == pytest.approx(difference(angle, 1.0)[inner], abs=1e-9)
    assert np.abs(simpson(speed) - difference(angle, 1.0))[inner].max() > 1e-3 * np.abs(speed).max()


def made(late: float, noise: float, seed: int) -> list[_Rows]:
    random = np.random.default_rng(seed)
    parts = []
    for _ in range(4):
        time = np.arange(300) / 25
        forcing = sum(np.sin(2 * np.pi * f * time + random.uniform(0, 6)) for f in (0.3, 0.7, 1.2))
        change = np.gradient(forcing)
        y = forcing + late * change + noise * random.standard_normal(300)
        columns = np.column_stack([forcing, change])
        parts.append(_Rows(y, columns, np.zeros((300, 0)), columns))
    return parts


@pytest.mark.parametrize("seed", range(5))
def test_a_delay_is_found_with_its_deviation_and_none_where_there_is_none(seed):
    there, none = (_Delay.of(made(late, 0.02, seed), LIMITS) for late in (0.15, 0.0))
    assert there is not None
    assert none is not None
    assert abs(there.rows - 0.15) < 4 * there.std
    assert there.deviations > LIMITS.deviations
    assert none.deviations < LIMITS.deviations


def test_speeds_that_are_late_in_thrust_too_have_a_late_clock():
    rotation = _Delay.of(made(0.4, 0.02, 1), LIMITS)
    thrust = _Delay.of(made(0.4, 0.02, 2), LIMITS)
    instant = _Delay.of(made(0.0, 0.02, 3), LIMITS)
    assert rotation is not None
    assert thrust is not None
    assert instant is not None
    assert _is_late(rotation, thrust, LIMITS)
    assert not _is_late(rotation, instant, LIMITS)
    vague = replace(thrust, rows=0.3, std=2.0)
    assert not _is_late(rotation, vague, LIMITS)


def test_a_controller_as_fast_as_the_log_is_no_moment_of_the_rotors():
    """Flights of another simulator that hide nothing: a gyroscopic moment and a damping were named, 95 % sure."""
    diagnosis = alula.diagnose(sorted(map(str, ROTORPY.glob("*.csv.gz"))), str(ROTORPY / "vehicle.toml"))
    assert diagnosis.report.effects == ()
    assert diagnosis.report.verdict == "explained"
