"""A velocity that is not the derivative of the position, and a range that clips, are refused."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import make_dataset
from diagnosis.data.segment import segments
from diagnosis.data.sensor_checks import require_range, require_velocity
from diagnosis.thresholds import DEFAULT
from dynamics.errors import DataError
from tests.diagnosis.conftest import with_columns

LIMITS = DEFAULT.data_checks


def flown(flights, vehicle):
    return make_dataset(flights, vehicle).everything


def clipped(flights, quantity, share):
    """The flights with a quantity's range ending at a quantile."""

    def change(flight):
        names = [n for n in flight.columns if n.rpartition("_")[0] == quantity]
        limit = np.quantile(np.abs(np.column_stack([flight[n] for n in names])), share)
        return with_columns(flight, {n: np.clip(flight[n], -limit, limit) for n in names})

    return [change(flight) for flight in flights]


def test_sound_flights_pass(plain_flights, arpl_250g):
    require_velocity(flown(plain_flights, arpl_250g), LIMITS)
    require_range(flown(plain_flights, arpl_250g), LIMITS)


@pytest.mark.parametrize("factor", [-0.5, 0.0, 0.5, 2.0])
def test_a_velocity_that_is_not_the_positions_change_is_refused(plain_flights, arpl_250g, factor):
    changed = [with_columns(f, {f"velocity_{a}": factor * f[f"velocity_{a}"] for a in "xyz"}) for f in plain_flights]
    parts = [part for flight in changed for part in segments(flight, arpl_250g)]
    with pytest.raises(DataError, match=r"velocity and the change of position differ by"):
        require_velocity(parts, LIMITS)


def test_a_gyro_whose_range_clips_is_refused(plain_flights, arpl_250g):
    with pytest.raises(DataError, match="the gyro stands at the end of its range"):
        require_answerable(flown(clipped(plain_flights, "rate", 0.7), arpl_250g), arpl_250g)


def test_rotors_may_fly_at_their_limit_for_a_while(plain_flights, arpl_250g):
    require_range(flown(clipped(plain_flights, "rotor_speed", 0.9), arpl_250g), LIMITS)
    with pytest.raises(DataError, match="the rotor speed stands at"):
        require_range(flown(clipped(plain_flights, "rotor_speed", 0.3), arpl_250g), LIMITS)


def test_commands_that_stand_at_their_limit_for_most_of_a_flight_are_refused(plain_flights, arpl_250g):
    renamed = {f"rotor_speed_{i}": f"rotor_speed_command_{i}" for i in range(4)}
    commanded = [with_columns(f, {n: f[o] for o, n in renamed.items()} | dict.fromkeys(renamed)) for f in plain_flights]
    require_range(flown(clipped(commanded, "rotor_speed_command", 0.9), arpl_250g), LIMITS)
    with pytest.raises(DataError, match="the command of the rotors stands at"):
        require_range(flown(clipped(commanded, "rotor_speed_command", 0.3), arpl_250g), LIMITS)


def test_estimators_may_err_and_nothing_is_judged_without_a_position(plain_flights, arpl_250g):
    random = np.random.default_rng(0)
    errors = [with_columns(f, {"velocity_x": f["velocity_x"] + 0.3 * random.standard_normal()}) for f in plain_flights]
    require_velocity(flown(errors, arpl_250g), LIMITS)
    large = [with_columns(f, {"velocity_x": f["velocity_x"] + 0.75}) for f in plain_flights[:1]]
    with pytest.raises(DataError, match=r"differ by 0.75 m/s"):
        require_velocity(flown(large, arpl_250g), LIMITS)
    require_velocity([replace(part, pose_source="estimator") for part in flown(large, arpl_250g)], LIMITS)
    bare = [with_columns(f, {f"position_{axis}": None for axis in "xyz"}) for f in plain_flights]
    require_velocity(flown(bare, arpl_250g), LIMITS)
