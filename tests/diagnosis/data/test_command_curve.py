"""Thrust over command is recovered where it is planted: gain by flight, gain by motor, curve, lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.data.command_curve import fit_command_curve, lagged
from diagnosis.data.dataset import make_dataset
from diagnosis.data.segment import Segment, segments
from diagnosis.selection.visibility import state_dependencies
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError
from dynamics.vehicle import EffectUse, Vehicle
from flights import Flight
from tests.diagnosis.conftest import with_columns

MOTORS = np.array([1.1, 0.95, 1.02, 0.93])
CONSTANT, LINEAR = 0.1, 0.9  # of thrust over a rotor's share of the weight


def signalled(flight: Flight, vehicle: Vehicle, gain: float) -> Flight:
    """The flight with motor signals, whose thrust the vehicle file gives wrongly, instead of its rotor speeds."""
    thrust = (flight["rotor_speed"] / vehicle.hover_speed) ** 2
    commanded = (thrust - CONSTANT) / LINEAR / (gain * MOTORS)
    signals = vehicle.hover_speed * np.sqrt(np.maximum(commanded, 0.0)) / vehicle.rotors.speed_max
    columns = {f"rotor_speed_{i}": None for i in range(4)}
    return with_columns(flight, {**columns, **{f"rotor_command_{i}": signals[:, i] for i in range(4)}})


@pytest.fixture(scope="module")
def commanded(plain_flights: list[Flight], arpl_250g: Vehicle) -> list[Segment]:
    flights = [signalled(f, arpl_250g, 1.3 if i % 2 else 0.8) for i, f in enumerate(plain_flights)]
    return [s for i, f in enumerate(flights) for s in segments(named(f, i), arpl_250g)]


def named(flight: Flight, number: int) -> Flight:
    return replace(flight, provenance=replace(flight.provenance, path=f"flight_{number}"))


def test_gains_and_curve_are_recovered_and_give_the_rotors_speeds_back(
    commanded: list[Segment], plain_flights: list[Flight], arpl_250g: Vehicle
) -> None:
    curve = fit_command_curve(commanded, (), arpl_250g)
    means = [curve.gains[f"flight_{i}"].mean for i in range(6)]
    assert np.mean(means[1::2]) / np.mean(means[::2]) == pytest.approx(1.3 / 0.8, rel=0.03)
    motors = np.mean([gain.motors for gain in curve.gains.values()], axis=0)
    np.testing.assert_allclose(motors, MOTORS, atol=0.03)
    assert curve.lag <= 0.01  # the measured speeds stand for the commands
    assert curve.explained > 0.95
    for segment in commanded:
        plain = segments(plain_flights[int(segment.flight[-1])], arpl_250g)[0]
        speed = curve.applied(segment).rotor_speed
        assert np.sqrt(np.mean((speed / plain.rotor_speed - 1) ** 2)) < 0.03


def with_drag(segment: Segment, drag: float) -> Segment:
    """The segment with a drag along the body's axes in what the accelerometer reads. drag: over mass, 1/s."""
    assert segment.specific_force is not None
    velocity = np.einsum("nji,nj->ni", segment.to_world, segment.velocity)
    return replace(segment, specific_force=segment.specific_force - drag * velocity)


@pytest.mark.parametrize("in_file", [False, True])
def test_drag_does_not_count_as_missing_thrust(commanded: list[Segment], arpl_250g: Vehicle, in_file: bool) -> None:
    """In tilted flight drag points down the body's axis."""
    drag = 0.8
    plain = fit_command_curve(commanded, (), arpl_250g).gains
    use = EffectUse("linear_drag", {"coefficient": drag * arpl_250g.body.mass})
    vehicle = arpl_250g.with_effects(use) if in_file else arpl_250g
    gains = fit_command_curve([with_drag(s, drag) for s in commanded], (), vehicle).gains
    for name, gain in plain.items():
        assert gains[name].mean == pytest.approx(gain.mean, rel=0.01)


def test_a_mass_in_the_vehicle_file_is_carried_by_the_gain(commanded: list[Segment], arpl_250g: Vehicle) -> None:
    heavier = arpl_250g.with_effects(EffectUse("mass", {"ratio": 1.25}))
    plain, curve = (fit_command_curve(commanded, (), vehicle) for vehicle in (arpl_250g, heavier))
    for segment in commanded:
        assert curve.gains[segment.flight].mean == pytest.approx(1.25 * plain.gains[segment.flight].mean, rel=0.005)
        light, heavy = (of.applied(segment).rotor_speed for of in (plain, curve))
        np.testing.assert_allclose(heavy**2, 1.25 * light**2, rtol=0.03)


def test_a_held_out_flight_gets_its_own_gain(commanded: list[Segment], arpl_250g: Vehicle) -> None:
    curve = fit_command_curve(commanded[:-1], commanded[-1:], arpl_250g)
    assert set(curve.gains) == {f"flight_{i}" for i in range(6)}


def test_a_steady_turn_is_no_difference_between_the_motors_of_a_flight(
    commanded: list[Segment], arpl_250g: Vehicle
) -> None:
    """A damping brakes it, which these flights do not have and the file has."""
    damped = arpl_250g.with_effects(EffectUse("rotational_damping", {"coefficient": 1e-3}))
    turn = np.array([0.0, 0.0, 1.0])  # rad/s
    turning = [replace(s, gyro=s.body_rate + turn * (s.flight == "flight_0")) for s in commanded]
    gains = fit_command_curve(turning, (), damped).gains.values()
    assert np.ptp([np.dot(np.sign(arpl_250g.rotors.allocation[3]), gain.motors) for gain in gains]) < 0.01


def test_a_gain_that_no_command_has_is_the_vehicle_files_mistake(
    plain_flights: list[Flight], arpl_250g: Vehicle
) -> None:
    part = segments(signalled(plain_flights[4], arpl_250g, 2.5), arpl_250g)
    with pytest.raises(DataError, match="Check mass, thrust_constant, speed_max and thrust_curve"):
        fit_command_curve(part, (), arpl_250g)


def test_measured_speeds_are_left_alone(plain_flights: list[Flight], arpl_250g: Vehicle) -> None:
    dataset = make_dataset(plain_flights, arpl_250g)
    np.testing.assert_array_equal(dataset.fitted[0].rotor_speed, segments(plain_flights[0], arpl_250g)[0].rotor_speed)
    assert not any("times the thrust" in note for note in dataset.notes)


def test_a_lag_reaches_63_percent_after_its_time() -> None:
    step = np.concatenate([np.zeros((1, 1)), np.ones((200, 1))])
    assert lagged(step, 1000.0, 0.05)[50, 0] == pytest.approx(1 - np.exp(-1), abs=0.01)
    np.testing.assert_array_equal(lagged(step, 1000.0, 0.0), step)


@pytest.mark.parametrize(
    ("name", "needed"),
    [
        ("motor_lag", set()),
        ("inertia", set()),
        ("weak_rotor", set()),
        ("imu_bias", set()),
        ("linear_drag", {"velocity", "attitude"}),
        ("ground_effect", {"position", "attitude"}),
        ("time_delay", {"attitude"}),
        ("gyro_bias", {"attitude"}),
    ],
)
def test_what_an_effect_depends_on_follows_from_its_expressions(
    arpl_250g: Vehicle, name: str, needed: set[str]
) -> None:
    assert state_dependencies(CATALOGUE[name], arpl_250g, CATALOGUE) == needed
