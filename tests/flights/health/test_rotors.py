"""Patterns of the rotors' commands in hover: which rotor, which side, and where hover alone does not decide."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.arrays import Floats
from flights.health.record import AutopilotSeries, Record, build_record
from flights.health.rotors import balance_statements, stopped_statement
from flights.log import Log, Provenance, Stream

PX4 = {"CA_ROTOR_COUNT": 4.0, "MAV_TYPE": 2.0}
PLACES = ((0.2, 0.2, 0.05), (-0.2, -0.2, 0.05), (0.2, -0.2, -0.05), (-0.2, 0.2, -0.05))  # forward, right, turn
PARAMETERS = PX4 | {
    f"CA_ROTOR{motor}_{name}": value
    for motor, place in enumerate(PLACES)
    for name, value in zip(("PX", "PY", "KM"), place, strict=True)
}
CORNERS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])  # x and y of our rotors
SPIN = np.array([1, -1, 1, -1])
RATE = 10.0


def hover(command: Floats, rate: Floats | None = None, attitude: Floats | None = None) -> Record:
    """The record of a hover at 10 Hz. command: (n, 4)."""
    time = np.arange(len(command)) / RATE
    level = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))
    streams = (
        Stream("rotor_command", time, command, "actuator_motors"),
        Stream("attitude", time, level if attitude is None else attitude, "vehicle_attitude"),
        Stream("attitude_setpoint", time, level, "vehicle_attitude_setpoint"),
        Stream("rate", time, np.zeros((len(time), 3)) if rate is None else rate, "vehicle_angular_velocity"),
    )
    provenance = Provenance("hover.ulg", "", "PX4 ULog", "flights.readers.ulog")
    return build_record(Log(streams, provenance, parameters=PARAMETERS), AutopilotSeries())


def noisy(pattern: Floats, seed: int, seconds: float = 20.0) -> Floats:
    """Commands about 0.5 with a pattern over their mean, and noise of 1 %."""
    random = np.random.default_rng(seed)
    count = int(seconds * RATE)
    return np.asarray(0.5 * (1 + pattern + 0.01 * random.standard_normal((count, 4))))


@pytest.mark.parametrize("rotor", range(4))
def test_a_rotor_that_alone_works_harder_is_named(rotor: int) -> None:
    pattern = 0.3 * (np.eye(4)[rotor] - 0.25)
    (statement,) = balance_statements(hover(noisy(pattern, rotor)))
    assert (statement.name, statement.certainty, statement.rotor) == ("weak_thrust", "likely", rotor)
    assert ("front" in statement.text) == (CORNERS[rotor, 0] > 0)
    assert ("left" in statement.text) == (CORNERS[rotor, 1] > 0)


@pytest.mark.parametrize(("axis", "sign", "side"), [(0, 1, "front"), (0, -1, "back"), (1, 1, "left"), (1, -1, "right")])
def test_a_side_that_carries_more_is_the_centre_of_mass(axis: int, sign: int, side: str) -> None:
    (statement,) = balance_statements(hover(noisy(0.2 * sign * CORNERS[:, axis], axis)))
    assert (statement.name, statement.rotor) == ("off_centre", None)
    assert f"the {side} carries more" in statement.text


@pytest.mark.parametrize("rotor", range(4))
def test_a_corner_without_the_yaw_of_a_single_rotor_is_left_open(rotor: int) -> None:
    """A centre of mass towards a rotor and a propeller that lost thrust alone look the same in hover."""
    pattern = 0.1 * (CORNERS @ CORNERS[rotor])
    (statement,) = balance_statements(hover(noisy(pattern, rotor)))
    assert (statement.certainty, statement.rotor) == ("cannot tell", rotor)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_pair_that_works_harder_is_named_by_its_turn(sign: int) -> None:
    """A rotor that turns clockwise pushes the body counter-clockwise, about body z upwards."""
    (statement,) = balance_statements(hover(noisy(0.2 * sign * SPIN, sign + 1)))
    assert statement.name == "yaw_imbalance"
    assert f"the {'clockwise' if sign > 0 else 'counter-clockwise'} pair" in statement.text


@pytest.mark.parametrize("seed", range(20))
def test_small_differences_are_no_defect(seed: int) -> None:
    pattern = np.random.default_rng(seed).uniform(-0.08, 0.08, 4)
    (statement,) = balance_statements(hover(noisy(pattern - pattern.mean(), seed)))
    assert (statement.name, statement.level) == ("balance", "note")


@pytest.mark.parametrize("rotor", range(4))
def test_a_rotor_that_changes_in_flight_is_named_with_its_time(rotor: int) -> None:
    command = noisy(np.zeros(4), rotor, 40.0)
    command[220:] += 0.5 * 0.2 * np.eye(4)[rotor]
    (statement,) = balance_statements(hover(command))
    assert (statement.name, statement.rotor) == ("weak_thrust", rotor)
    assert statement.start == pytest.approx(22.0, abs=0.5)


@pytest.mark.parametrize("rotor", range(4))
@pytest.mark.parametrize("falls", [True, False])
def test_a_rotor_stopped_only_where_the_vehicle_falls_towards_it(rotor: int, falls: bool) -> None:
    """At its limit and yet falling: it thrusts no more. Falling the other way, the command follows something else."""
    command = noisy(np.zeros(4), rotor)
    command[100:115] = 0.5
    command[100:115, rotor], command[100:115, (rotor + 2) % 4] = 1.0, 0.1
    x, y = CORNERS[rotor] * (1 if falls else -1)
    rate, attitude = np.zeros((200, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (200, 1))
    rate[100:115] = (-2.0 * y, 2.0 * x, 0.0)
    attitude[104:115] = (np.cos(0.6), -np.sin(0.6) * y / np.sqrt(2), np.sin(0.6) * x / np.sqrt(2), 0.0)
    statement = stopped_statement(hover(command, rate, attitude))
    assert (statement is not None) == falls
    if statement is not None:
        assert (statement.rotor, statement.certainty) == (rotor, "likely")
        assert statement.start == pytest.approx(10.0, abs=0.2)


def test_commands_that_stand_still_are_no_commands() -> None:
    assert list(balance_statements(hover(np.zeros((200, 4))))) == []
