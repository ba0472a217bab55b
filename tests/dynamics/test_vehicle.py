"""The vehicle: the paper's numbers, and vehicles that cannot exist."""

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics.errors import RequestError
from dynamics.vehicle import GRAVITY, Body, Limits, Rotors, Vehicle

RADIUS_PER_ARM = 0.45


def rotors(positions, spin, **overrides):
    """Rotors of unit thrust constant."""
    constants = {"thrust_constant": 1.0, "torque_constant": 0.1, "speed_max": 10.0}
    return Rotors(tuple(map(tuple, positions)), tuple(spin), **{**constants, **overrides})


def ring(count, radius=0.2):
    """Rotor positions on a circle."""
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)]).tolist()


def test_the_papers_vehicle_hovers_at_11831_rpm(arpl_250g):
    assert arpl_250g.hover_speed * 60 / (2 * np.pi) == pytest.approx(11_831, rel=1e-3)


def test_the_papers_vehicle_lifts_1_97_times_its_weight(arpl_250g):
    assert arpl_250g.rotors.thrust_max / arpl_250g.weight == pytest.approx(1.97, abs=0.01)
    assert arpl_250g.rotors.speed_max * 60 / (2 * np.pi) == pytest.approx(16_628, rel=1e-3)


def test_allocation_of_the_papers_quadrotor_is_its_equation_2(arpl_250g):
    arm, k_f, k_tau = 0.076, arpl_250g.rotors.thrust_constant, arpl_250g.rotors.torque_constant
    lever = k_f * arm
    equation_2 = [
        [k_f, k_f, k_f, k_f],
        [lever, lever, -lever, -lever],
        [-lever, lever, lever, -lever],
        [k_tau, -k_tau, k_tau, -k_tau],
    ]
    assert_allclose(arpl_250g.rotors.allocation, equation_2, rtol=1e-12)


@pytest.mark.parametrize("count", [4, 6, 8])
def test_allocation_is_lever_times_thrust_for_any_number_of_rotors(count):
    layout = rotors(ring(count), [1, -1] * (count // 2))
    squared = np.random.default_rng(count).uniform(1, 4, count)
    force = [np.array([0, 0, s]) for s in squared]
    torque = sum(np.cross(p, f) for p, f in zip(layout.position, force, strict=True))
    torque[2] += sum(0.1 * sign * s for sign, s in zip(layout.spin, squared, strict=True))
    assert_allclose(layout.allocation @ squared, [squared.sum(), *torque], atol=1e-12)


def test_an_odd_number_of_rotors_is_allowed_when_it_can_yaw():
    five = rotors(ring(5), [1, -1, 1, -1, 1])
    assert np.linalg.matrix_rank(five.allocation) == 4


@pytest.mark.parametrize("inertia", [(1.0, 1.0, 2.1), (1.0, 0.2, 0.2), (1e-3, 3e-3, 1e-3)])
def test_an_inertia_that_no_body_has_is_refused(inertia):
    with pytest.raises(RequestError, match=r"impossible inertia .* sum of the other two"):
        Body(1.0, inertia)


def test_a_flat_plate_is_the_limit_of_what_inertia_can_be():
    assert Body(1.0, (1.0, 1.0, 2.0)).inertia == (1.0, 1.0, 2.0)


@pytest.mark.parametrize(
    ("spin", "message"),
    [
        ([1, 1, 1, 1], r"sums to 4.*must cancel"),
        ([1, -1, 1, 1], r"sums to 2.*Half of the rotors must turn each way"),
        ([1, 1, -1, -1], r"cannot command thrust, roll, pitch and yaw independently"),
        ([1, -1, 1], r"4 rotor positions but 3 spin signs"),
        ([1, -1, 2, -2], r"each must be 1 or -1"),
    ],
)
def test_four_rotors_with_wrong_spins_are_refused(spin, message):
    with pytest.raises(RequestError, match=message):
        rotors(ring(4), spin)


@pytest.mark.parametrize("count", [0, 2])
def test_too_few_rotors_are_refused(count):
    with pytest.raises(RequestError, match=r"cannot command thrust, roll, pitch and yaw"):
        rotors(ring(count), [1, -1] * (count // 2))


def test_rotors_in_a_line_are_refused_even_without_reaction_torque():
    line = [[x, 0.0, 0.0] for x in (-0.3, -0.1, 0.1, 0.3)]
    with pytest.raises(RequestError, match="cannot command"):
        rotors(line, [1, -1, -1, 1], torque_constant=0.0)


def test_an_empty_speed_range_is_refused():
    with pytest.raises(RequestError, match=r"speed_min 10\.0 is not below speed_max 10\.0"):
        rotors(ring(4), [1, -1, 1, -1], speed_min=10.0)


def test_a_vehicle_that_cannot_lift_itself_is_refused_with_the_units_to_check(arpl_250g):
    with pytest.raises(RequestError, match=r"rad/s, not rpm"):
        msgspec.structs.replace(arpl_250g, body=Body(25.0, arpl_250g.body.inertia))


@pytest.mark.parametrize("limits", [{"thrust": (3.0, 2.0)}, {"box": ((0, 0, 0), (1, 1, 0))}])
def test_empty_limits_are_refused(limits):
    with pytest.raises(RequestError, match="is empty"):
        Limits(**limits)


def test_thrust_limits_are_the_files_or_what_the_rotors_can_do(arpl_250g):
    assert arpl_250g.thrust_limits == (0.0, arpl_250g.rotors.thrust_max)
    limited = msgspec.structs.replace(arpl_250g, limits=Limits(thrust=(0.5, 4.0)))
    assert limited.thrust_limits == (0.5, 4.0)


def test_disc_radius_is_the_files_or_follows_from_the_spacing():
    assert rotors(ring(4), [1, -1, 1, -1], radius=0.07).disc_radius == 0.07
    spacing = 0.2 * np.sqrt(2)
    assert rotors(ring(4), [1, -1, 1, -1]).disc_radius == pytest.approx(RADIUS_PER_ARM * spacing)


def test_hover_speed_carries_the_weight(arpl_250g):
    assert isinstance(arpl_250g, Vehicle)
    lift = arpl_250g.rotors.allocation[0] @ np.full(4, arpl_250g.hover_speed**2)
    assert lift == pytest.approx(arpl_250g.body.mass * GRAVITY)
