"""The recorded PX4 flight again, with the mock and its real vehicle: arm, climb, hover, lose the stream, land."""

from __future__ import annotations

import math
from typing import Any

import pytest

from sitl_mock.mock import MockOptions, build_autopilot
from tests.support.bench import ARM, OFFBOARD, RTL, SET_INTERVAL, SET_MODE, Bench
from vehicles import FOLDER

ODOMETRY = 331


def bench_of(name: str, **options: Any) -> Bench:
    bench = Bench(mock=build_autopilot(MockOptions(FOLDER / f"{name}.toml", **options)))
    assert bench.request(SET_INTERVAL, ODOMETRY, 10_000) == 0
    return bench


def hold_height(bench: Bench, height: float, seconds: float) -> None:
    """Steer by ODOMETRY alone: level attitude against drift, thrust for a height, 100 Hz."""
    hover = bench.mock.parameters["MPC_THR_HOVER"]
    for _ in range(round(seconds * 100)):
        o = bench.of("ODOMETRY")[-1]
        heading = 2 * math.atan2(o.q[3], o.q[0])
        north, east = -0.6 * o.x - 1.2 * o.vx, -0.6 * o.y - 1.2 * o.vy
        forward = math.cos(heading) * north + math.sin(heading) * east
        right = -math.sin(heading) * north + math.cos(heading) * east
        roll, pitch = max(-0.3, min(0.3, right / 9.81)), max(-0.3, min(0.3, -forward / 9.81))
        climb = 2.0 * (height + o.z) + 2.5 * o.vz
        cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
        cy, sy = math.cos(heading / 2), math.sin(heading / 2)
        q = [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
        bench.setpoint(max(0.1 * hover, min(0.9, hover * (1 + climb / 9.81))), 7, q=q)
        bench.mock.advance(0.010)
        bench.hear()


@pytest.mark.parametrize("name", ["px4_sih", "arpl_250g"])
def test_a_flight_like_the_recorded_one(name: str) -> None:
    bench = bench_of(name)
    bench.stream(1.2)
    assert bench.request(SET_MODE, 1, 6) == 0
    bench.setpoint()
    assert bench.request(ARM, 1) == 0
    hold_height(bench, 4.0, 7.0)
    assert -bench.of("ODOMETRY")[-1].z == pytest.approx(4.0, abs=0.4)
    assert bench.of("EXTENDED_SYS_STATE")[-1].landed_state == 2
    assert bench.request(ARM, 0) == 1  # not in the air
    lost = bench.until(lambda: bench.heartbeat.custom_mode != OFFBOARD)
    assert lost <= 1.13
    assert bench.heartbeat.custom_mode == RTL
    bench.run(1.0)
    hold_height(bench, 4.0, 3.0)
    assert bench.heartbeat.custom_mode == OFFBOARD
    assert bench.request(SET_MODE, 1, 4, 6) == 0
    bench.until(lambda: not bench.heartbeat.base_mode & 128)
    assert bench.of("EXTENDED_SYS_STATE")[-1].landed_state == 1
    assert bench.vehicle.truth.position_world[2] < 0.3
    assert math.hypot(*bench.vehicle.truth.position_world[:2]) < 1.0


def test_an_ignored_throttle_makes_the_real_vehicle_fall() -> None:
    bench = bench_of("px4_sih")
    bench.stream(0.1)
    bench.request(SET_MODE, 1, 6)
    bench.setpoint()
    bench.request(ARM, 1)
    hold_height(bench, 8.0, 8.0)
    before = bench.vehicle.truth.velocity_world[2]
    for _ in range(50):
        bench.setpoint(0.5, 7 + 64)
        bench.mock.advance(0.010)
    fallen = before - bench.vehicle.truth.velocity_world[2]
    assert 3.4 < fallen < 4.9  # PX4 fell by 3.4 m/s, braked by its simulator's drag, which this vehicle lacks


def test_after_touch_down_disarming_is_refused_until_the_land_detector_agrees() -> None:
    bench = bench_of("px4_sih", seed=2)
    bench.stream(0.1)
    bench.request(SET_MODE, 1, 6)
    bench.setpoint()
    bench.request(ARM, 1)
    hold_height(bench, 1.5, 5.0)
    while bench.vehicle.ground_force < 0.3:
        hold_height(bench, bench.vehicle.estimate_now.position_world[2] - 0.3, 0.02)
    answers = []
    while not answers or answers[-1] == 1:
        bench.stream(0.4, thrust=0.0)
        answers.append(bench.request(ARM, 0))
    assert answers[-1] == 0
    assert 1 <= answers.count(1) <= 5
