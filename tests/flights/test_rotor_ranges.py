"""The range of motor commands is what parameters state where the numbers agree, else what numbers and thrust tell."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics.arrays import Floats
from flights.rotor_ranges import ALL_KINDS, PX4_KINDS, CommandRange, Thrust, infer_range

RATE = 100.0
RANGES = {
    "levels": (0.0, 1.0),
    "oneshot": (125.0, 250.0),
    "pulses": (1000.0, 2000.0),
    "px4 dshot": (0.0, 1999.0),
    "uavcan": (0.0, 8191.0),
}


def _flight(power: float, hover: float, seed: int, *, ground: float = 0.0) -> tuple[Floats, Floats, Thrust]:
    """Time, commands (n, 4) of 0 to 1 and the specific force that they make, after some seconds on the ground."""
    random = np.random.default_rng(seed)
    time = np.arange(round((30.0 + ground) * RATE)) / RATE
    swing = np.cumsum(random.standard_normal((len(time), 5)), axis=0)
    smooth = np.stack([np.convolve(column, np.hanning(60) / 30.0, "same") for column in swing.T], axis=1)
    smooth = (smooth - smooth.mean(axis=0)) / smooth.std(axis=0)
    force = 9.81 * np.exp(0.22 * np.clip(smooth[:, 4], -2, 2))
    command = hover * (force / 9.81)[:, None] ** (1 / power) * np.exp(0.04 * np.clip(smooth[:, :4], -2, 2))
    command = np.clip(command, 0.0, 1.0)
    standing = time < ground
    command[standing] = 0.06
    force = np.where(standing, 9.81, force) + 0.2 * random.standard_normal(len(time))
    return time, command, Thrust(time, force)


@pytest.mark.parametrize("ground", [0.0, 20.0])
@pytest.mark.parametrize("power", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("name", RANGES)
def test_numbers_and_thrust_tell_the_range(name: str, power: float, ground: float) -> None:
    low, high = RANGES[name]
    for seed in range(5):
        hover = 0.35 + 0.06 * seed
        time, command, thrust = _flight(power, hover, seed, ground=ground)
        kinds = ALL_KINDS if name == "oneshot" else PX4_KINDS
        ranged = infer_range(time, low + (high - low) * command, (), kinds, thrust)
        assert ranged is not None
        assert_allclose(ranged.scaled(low + (high - low) * command), command, atol=0.03, err_msg=str(ranged))


def test_a_range_that_parameters_state_is_taken_where_nothing_contradicts_it() -> None:
    time, command, thrust = _flight(2.0, 0.5, 1)
    stated = CommandRange.of("pulses", 1100.0, 1900.0, 4, "PWM_MAIN_MINn and PWM_MAIN_MAXn")
    ranged = infer_range(time, 1100.0 + 800.0 * command, (stated,), PX4_KINDS, thrust)
    assert ranged is stated


def test_a_stated_range_that_the_numbers_leave_is_not_taken() -> None:
    time, command, _ = _flight(2.0, 0.5, 1)
    stated = CommandRange.of("pulses", 1000.0, 2000.0, 4, "MOT_PWM_MIN and MAX")
    ranged = infer_range(time, 8191.0 * command, (stated,), ALL_KINDS)
    assert ranged is not None
    assert ranged.high[0] == 8191.0


def test_the_other_range_is_named_where_nothing_tells_them_apart() -> None:
    """Pulses above 1000 and no thrust: DShot would hold them as well."""
    time, command, _ = _flight(2.0, 0.5, 1)
    ranged = infer_range(time, 1000.0 + 1000.0 * command, (), PX4_KINDS)
    assert ranged is not None
    assert "DShot commands from 0 to 1999 would fit as well" in str(ranged)


def test_numbers_in_no_known_range_have_none() -> None:
    time, command, _ = _flight(2.0, 0.5, 1)
    assert infer_range(time, 1e5 * command, (), ALL_KINDS) is None
