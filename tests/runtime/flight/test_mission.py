"""A flight goes from the ground through the reference and back, whatever happens in between, without leaps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dynamics import quaternion
from dynamics.state import ATTITUDE, POSITION, VELOCITY
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.flight.mission import Mission, Plan
from runtime.flight.motion import Transfer
from runtime.flight.phases import Phase

STEP = 0.05


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return read_vehicle("vehicles/arpl_250g.toml")


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    return np.array([x, y, z, yaw])


def state_at(position: tuple[float, float, float], velocity: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    return np.array([*position, *velocity, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def fly(mission: Mission, state: np.ndarray, start: float, duration: float) -> tuple[list[Phase], np.ndarray, float]:
    """Follow the mission perfectly; the phases in order, the states at every step, the time at the end."""
    phases, states = [mission.phase], []
    time = start
    while time < start + duration and mission.airborne:
        states.append(mission.window(np.array([time]), state[ATTITUDE])[0][0])
        state = states[-1]
        mission.update(state, time)
        if mission.phase is not phases[-1]:
            phases.append(mission.phase)
        time += STEP
    return phases, np.array(states), time


def airborne(vehicle: Vehicle, plan: Plan | None = None) -> Mission:
    reference = Transfer(vehicle, pose(2.0, 1.0, 1.5, 1.0), pose(-2.0, 1.0, 1.5, 1.0), 6.0)
    mission = Mission(vehicle, reference, plan or Plan())
    mission.ramp(state_at((0.5, -0.5, 0.1)), 0.0)
    mission.climb(state_at((0.5, -0.5, 0.15)), 1.0)
    return mission


def test_a_whole_flight_has_its_phases_in_order_and_no_leap_in_its_reference(vehicle: Vehicle) -> None:
    mission = airborne(vehicle)
    phases, states, _ = fly(mission, state_at((0.5, -0.5, 0.15)), 1.0, 60.0)
    assert phases == [Phase.CLIMB, Phase.APPROACH, Phase.TRACK, Phase.RETURN, Phase.DESCEND, Phase.TOUCHDOWN]
    steps = np.linalg.norm(np.diff(states[:, POSITION], axis=0), axis=1)
    assert np.max(steps) < 2.0 * Plan().speed * STEP
    turns = quaternion.angle_between(states[1:, 6:10], states[:-1, 6:10])
    assert np.max(turns) < 0.15
    # it descends where it took off, and without end: the landing detector ends it
    np.testing.assert_allclose(states[-1, 0:2], [0.5, -0.5], atol=1e-6)
    assert states[-1, 2] < 0.1


def test_positions_and_velocities_of_every_phase_belong_together(vehicle: Vehicle) -> None:
    mission = airborne(vehicle)
    _, states, _ = fly(mission, state_at((0.5, -0.5, 0.15)), 1.0, 25.0)
    moved = np.diff(states[:, POSITION], axis=0)
    predicted = 0.5 * (states[1:, 3:6] + states[:-1, 3:6]) * STEP
    assert np.max(np.linalg.norm(moved - predicted, axis=1)) < 0.02


def test_a_landing_in_the_air_brakes_and_descends_there(vehicle: Vehicle) -> None:
    mission = airborne(vehicle)
    _, states, time = fly(mission, state_at((0.5, -0.5, 0.15)), 1.0, 9.0)
    state = states[-1]
    mission.land("interrupted", state, time)
    mission.land("and again", state, time)
    assert mission.landing_reason == "interrupted"
    phases, after, _ = fly(mission, state, time, 20.0)
    assert phases == [Phase.BRAKE, Phase.DESCEND, Phase.TOUCHDOWN]
    assert np.linalg.norm(after[-1, 0:2] - state[0:2]) < np.linalg.norm(state[VELOCITY]) ** 2 / 2 + 0.1


def test_a_landing_on_the_ground_only_shuts_down(vehicle: Vehicle) -> None:
    mission = Mission(vehicle, Transfer(vehicle, pose(0, 0, 1), pose(1, 0, 1), 3.0), Plan())
    mission.ramp(state_at((0, 0, 0)), 0.0)
    mission.land("interrupted", state_at((0, 0, 0)), 0.5)
    assert mission.phase is Phase.SHUTDOWN
    assert not mission.airborne


def test_a_reference_cut_short_ends_in_a_brake_not_in_a_leap(vehicle: Vehicle) -> None:
    mission = airborne(vehicle, Plan(duration=3.0))
    phases, states, _ = fly(mission, state_at((0.5, -0.5, 0.15)), 1.0, 60.0)
    assert phases[2:5] == [Phase.TRACK, Phase.BRAKE, Phase.RETURN]
    assert phases[-1] is Phase.TOUCHDOWN
    assert np.max(np.linalg.norm(np.diff(states[:, POSITION], axis=0), axis=1)) < 1.5


def test_taking_over_in_the_air_never_descends_fast_because_the_ground_is_unknown(vehicle: Vehicle) -> None:
    mission = Mission(vehicle, Transfer(vehicle, pose(1, 0, 5), pose(2, 0, 5), 3.0), Plan())
    state = state_at((0.0, 0.0, 5.0), (2.0, 0.0, 0.0))
    mission.take_over(state, 0.0)
    phases, states, _ = fly(mission, state, 0.0, 40.0)
    assert phases == [Phase.BRAKE, Phase.APPROACH, Phase.TRACK, Phase.RETURN, Phase.DESCEND, Phase.TOUCHDOWN]
    assert np.min(states[:, 5]) >= -Plan().touchdown - 1e-9


def test_an_estimator_reset_moves_the_reference_and_not_the_vehicle(vehicle: Vehicle) -> None:
    mission, untouched = airborne(vehicle), airborne(vehicle)
    state = state_at((0.5, -0.5, 0.15))
    jump, turn = np.array([3.0, -2.0, 0.5]), 0.7
    _, before, time = fly(mission, state, 1.0, 4.0)
    fly(untouched, state, 1.0, 4.0)
    mission.shift(jump, turn)
    times = time + np.arange(10) * 0.1
    moved, _ = mission.window(times, before[-1, 6:10])
    same, _ = untouched.window(times, before[-1, 6:10])
    np.testing.assert_allclose(moved[:, POSITION] - same[:, POSITION], np.tile(jump, (10, 1)), atol=1e-9)
    # thrust points the same way in the world, the heading is turned
    up = np.array([0.0, 0.0, 1.0])
    axes = quaternion.rotate(moved[:, ATTITUDE], up), quaternion.rotate(same[:, ATTITUDE], up)
    np.testing.assert_allclose(*axes, atol=1e-9)
    relative = quaternion.multiply(quaternion.conjugate(same[:, ATTITUDE]), moved[:, ATTITUDE])
    np.testing.assert_allclose(quaternion.angle_between(same[:, ATTITUDE], moved[:, ATTITUDE]), turn, atol=1e-9)
    assert np.all(np.abs(relative[:, 1:3]) < 1e-9)
    _, after, _ = fly(mission, moved[0], time, 60.0)
    np.testing.assert_allclose(after[-1, 0:2], np.array([0.5, -0.5]) + jump[:2], atol=1e-6)


@pytest.mark.parametrize("yaw", [-3.0, 0.0, 3.0, 9.0])
def test_yaw_turns_the_short_way(vehicle: Vehicle, yaw: float) -> None:
    reference = Transfer(vehicle, pose(0, 0, 1.5, yaw), pose(1, 0, 1.5, yaw), 3.0)
    mission = Mission(vehicle, reference, Plan(settle=10.0))
    mission.ramp(state_at((0, 0, 0)), 0.0)
    mission.climb(state_at((0, 0, 0.1)), 1.0)
    _, states, _ = fly(mission, state_at((0, 0, 0.1)), 1.0, 14.0)
    yaws = np.unwrap(2 * np.arctan2(states[:, 9], states[:, 6]), period=math.tau)
    assert np.ptp(yaws) <= math.pi + 1e-6
    assert np.cos(yaws[-1] - yaw) == pytest.approx(1.0)


def test_airborne_phases_have_a_window_and_the_others_say_so(vehicle: Vehicle) -> None:
    mission = Mission(vehicle, Transfer(vehicle, pose(0, 0, 1), pose(1, 0, 1), 3.0), Plan())
    assert not mission.airborne
    with pytest.raises(ValueError, match="ground has no reference"):
        mission.window(np.zeros(1), quaternion.IDENTITY)


def test_a_second_flight_flies_the_same_reference_and_can_be_cut_short_again(vehicle: Vehicle) -> None:
    mission = airborne(vehicle, Plan(origin="takeoff"))
    here = state_at((1.0, 1.0, 1.0))
    mission.land("the battery is low", here, 5.0)
    assert mission.landing_reason
    mission.ramp(state_at((0.5, -0.5, 0.1)), 50.0)
    mission.climb(state_at((0.5, -0.5, 0.15)), 51.0)
    assert not mission.landing_reason
    np.testing.assert_allclose(mission.origin, [0.5, -0.5, 0.1])
    phases, states, _ = fly(mission, state_at((0.5, -0.5, 0.15)), 51.0, 60.0)
    assert phases[:3] == [Phase.CLIMB, Phase.APPROACH, Phase.TRACK]
    assert np.max(states[:, 0]) == pytest.approx(2.5, abs=0.05)
    mission.ramp(state_at((0.5, -0.5, 0.1)), 150.0)
    mission.climb(state_at((0.5, -0.5, 0.15)), 151.0)
    mission.land("the battery is low", here, 155.0)
    assert mission.phase is Phase.BRAKE
