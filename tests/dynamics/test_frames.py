"""Frames: NED and FRD into ENU and FLU, where a wrong sign flies into the ground."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose

from dynamics import frames, quaternion

vectors = hnp.arrays(float, 3, elements=st.floats(-100.0, 100.0))
attitudes = (
    hnp.arrays(float, 4, elements=st.floats(-1.0, 1.0))
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(quaternion.normalise)
)


def test_gravity_points_down_in_both_worlds():
    assert_allclose(frames.enu_from_ned([0, 0, 9.81]), [0, 0, -9.81])


def test_specific_force_at_rest_points_up_on_both_bodies():
    assert_allclose(frames.flu_from_frd([0, 0, -9.81]), [0, 0, 9.81])


def test_north_is_the_second_axis_and_east_the_first():
    assert_allclose(frames.enu_from_ned([1, 2, 3]), [2, 1, -3])


@pytest.mark.parametrize(("heading_deg", "yaw_deg"), [(0, 90), (90, 0), (45, 45), (180, -90), (270, 180), (-45, 135)])
def test_level_heading_becomes_yaw_counted_from_east(heading_deg, yaw_deg):
    attitude = frames.attitude_enu_flu(quaternion.from_euler(0, 0, np.radians(heading_deg)))
    roll, pitch, _ = quaternion.to_euler(attitude)
    assert_allclose([roll, pitch], 0.0, atol=1e-12)
    assert quaternion.angle_between(attitude, quaternion.from_euler(0, 0, np.radians(yaw_deg))) < 1e-7


def test_nose_up_in_frd_is_nose_up_in_flu():
    attitude = frames.attitude_enu_flu(quaternion.from_euler(0, 0.2, 0))  # FRD: positive pitch lifts the nose
    assert quaternion.rotate(attitude, [1, 0, 0])[2] == pytest.approx(np.sin(0.2))
    assert quaternion.to_euler(attitude)[1] == pytest.approx(-0.2)


def test_right_wing_down_in_frd_is_right_wing_down_in_flu():
    attitude = frames.attitude_enu_flu(quaternion.from_euler(0.2, 0, 0))  # FRD: positive roll lowers the right
    assert quaternion.rotate(attitude, [0, -1, 0])[2] == pytest.approx(-np.sin(0.2))
    assert quaternion.to_euler(attitude)[0] == pytest.approx(0.2)


@given(attitudes, vectors)
def test_converting_before_or_after_a_rotation_is_the_same(attitude_ned, body_frd):
    direct = frames.enu_from_ned(quaternion.rotate(attitude_ned, body_frd))
    through = quaternion.rotate(frames.attitude_enu_flu(attitude_ned), frames.flu_from_frd(body_frd))
    assert_allclose(direct, through, atol=1e-9)


@given(attitudes)
def test_attitude_there_and_back_keeps_even_the_sign(q):
    assert_allclose(frames.attitude_ned_frd(frames.attitude_enu_flu(q)), q, atol=1e-12)


@given(vectors)
def test_vector_maps_are_their_own_inverse(v):
    assert_allclose(frames.enu_from_ned(frames.enu_from_ned(v)), v)
    assert_allclose(frames.flu_from_frd(frames.flu_from_frd(v)), v)


@given(vectors, vectors)
def test_cross_products_survive_so_the_maps_are_rotations(a, b):
    crossed = np.cross(frames.flu_from_frd(a), frames.flu_from_frd(b))
    assert_allclose(crossed, frames.flu_from_frd(np.cross(a, b)), atol=1e-6)
    crossed = np.cross(frames.enu_from_ned(a), frames.enu_from_ned(b))
    assert_allclose(crossed, frames.enu_from_ned(np.cross(a, b)), atol=1e-6)


def test_scalar_last_quaternions_are_put_in_order():
    assert_allclose(frames.quaternion_from_xyzw([0.1, 0.2, 0.3, 0.9]), [0.9, 0.1, 0.2, 0.3])
    assert frames.quaternion_from_xyzw(np.zeros((3, 4))).shape == (3, 4)
