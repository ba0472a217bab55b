"""MAVSDK, the client that most people fly PX4 with, against the mock: every message that it requests is there."""

# ruff: noqa: E402 - what is imported last needs MAVSDK, without which these tests are skipped
from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from simulation.mock_process import MockProcess, mock_process

mavsdk = pytest.importorskip("mavsdk", minversion="4", reason="MAVSDK's Python binding is not installed")

from mavsdk import ComponentType, Configuration
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync, ActionError
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.offboard import (
    AccelerationNed,
    Attitude,
    AttitudeRate,
    OffboardAsync,
    OffboardError,
    PositionNedYaw,
    VelocityNedYaw,
)
from mavsdk.asyncio.plugins.param import ParamAsync, ParamError
from mavsdk.asyncio.plugins.telemetry import FlightMode, LandedState, TelemetryAsync

pytestmark = pytest.mark.realtime

PATIENCE = 20.0  # s for anything to happen
SPEED = 2.0  # simulated seconds per second


@pytest.fixture(scope="module")
def vehicle() -> Iterator[MockProcess]:
    with mock_process("--speed", str(SPEED), "--estimator", "mocap") as process:
        yield process


@pytest.fixture(scope="module")
def on_px4_estimate() -> Iterator[MockProcess]:
    with mock_process("--speed", str(SPEED), "--estimator", "px4") as process:
        yield process


@asynccontextmanager
async def connected(vehicle: MockProcess) -> AsyncIterator[SimpleNamespace]:
    """MAVSDK's plug-ins, connected."""
    configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
    async with Mavsdk(configuration) as client:
        await client.add_any_connection(f"udpin://127.0.0.1:{vehicle.port}")
        system = await client.first_autopilot(timeout_s=PATIENCE)
        assert system is not None
        yield SimpleNamespace(
            action=ActionAsync(system),
            info=InfoAsync(system),
            offboard=OffboardAsync(system),
            param=ParamAsync(system),
            telemetry=TelemetryAsync(system),
        )


def run(vehicle: MockProcess, flight: Callable[[SimpleNamespace], Coroutine[Any, Any, None]]) -> None:
    """Run a flight with a client of its own."""

    async def connect_and_fly() -> None:
        async with connected(vehicle) as drone:
            await flight(drone)

    asyncio.run(connect_and_fly())


async def until(
    updates: AsyncIterator[Any], accept: Callable[[Any], bool] = lambda _: True, within: float = PATIENCE
) -> Any:
    """The first update that is accepted."""

    async def first() -> Any:
        async for update in updates:
            if accept(update):
                return update
        raise AssertionError("the updates ended")

    return await asyncio.wait_for(first(), within)


async def mode(drone: SimpleNamespace, expected: FlightMode) -> None:
    await until(drone.telemetry.subscribe_flight_mode(), lambda now: now == expected)


async def steer(drone: SimpleNamespace, set_it: Callable[[], Awaitable[None]], seconds: float) -> Any:
    """Fly a setpoint in OFFBOARD for simulated seconds, then hold; returns where that led."""
    await set_it()
    await drone.offboard.start()
    assert await drone.offboard.is_active()
    await asyncio.sleep(seconds / SPEED)
    where = await until(drone.telemetry.subscribe_position_velocity_ned())
    await drone.offboard.stop()
    return where


def test_on_the_ground_it_is_healthy_and_known(vehicle: MockProcess) -> None:
    async def look(drone: SimpleNamespace) -> None:
        await until(drone.telemetry.subscribe_health_all_ok(), lambda well: well)
        assert (await until(drone.telemetry.subscribe_health())).is_armable
        assert not (await until(drone.telemetry.subscribe_rc_status())).is_available
        assert await until(drone.telemetry.subscribe_landed_state()) == LandedState.ON_GROUND
        assert await until(drone.telemetry.subscribe_flight_mode()) == FlightMode.HOLD
        assert (await drone.info.get_version()).flight_sw_major == 1
        assert (await until(drone.telemetry.subscribe_battery())).remaining_percent > 90
        with pytest.raises(OffboardError, match="NO_SETPOINT_SET"):
            await drone.offboard.start()

    run(vehicle, look)


def test_parameters_are_read_and_written(vehicle: MockProcess) -> None:
    async def tune(drone: SimpleNamespace) -> None:
        param = drone.param
        assert await param.get_param_int("COM_OBL_RC_ACT") == 0
        await param.set_param_int("COM_OBL_RC_ACT", 4)
        assert await param.get_param_int("COM_OBL_RC_ACT") == 4
        await param.set_param_int("COM_OBL_RC_ACT", 0)
        await param.set_param_float("COM_OF_LOSS_T", 1.5)
        assert await param.get_param_float("COM_OF_LOSS_T") == pytest.approx(1.5)
        await param.set_param_float("COM_OF_LOSS_T", 1.0)
        with pytest.raises(ParamError, match="DOES_NOT_EXIST"):
            await param.get_param_int("NO_SUCH_NAME")
        with pytest.raises(ParamError, match="WRONG_TYPE"):
            await param.get_param_float("COM_OBL_RC_ACT")
        everything = await param.get_all_params()
        assert len(everything.float_params) > 20

    run(vehicle, tune)


def test_rates_are_what_was_set(vehicle: MockProcess) -> None:
    async def measure(drone: SimpleNamespace) -> None:
        await drone.telemetry.set_rate_odometry(100.0)
        start, count = 0, 0
        async for update in drone.telemetry.subscribe_odometry():
            start = start or update.time_usec
            count += 1
            if update.time_usec - start > 1_500_000:
                assert (count - 1) / ((update.time_usec - start) * 1e-6) == pytest.approx(100.0, rel=0.05)
                return

    run(vehicle, measure)


@pytest.mark.slow
@pytest.mark.parametrize(("mock", "error"), [("vehicle", 0.0), ("on_px4_estimate", 0.6)])
def test_a_flight_from_arming_to_landing(mock: str, error: float, request: pytest.FixtureRequest) -> None:
    """error: by which an estimated velocity may be off, m/s; the estimate's position follows all the same."""

    async def fly(drone: SimpleNamespace) -> None:
        action, offboard = drone.action, drone.offboard
        await until(drone.telemetry.subscribe_health_all_ok(), lambda well: well)
        await action.set_takeoff_altitude(3.0)
        await action.arm()
        await action.takeoff()
        await until(drone.telemetry.subscribe_landed_state(), lambda state: state == LandedState.TAKING_OFF)
        with pytest.raises(ActionError, match="COMMAND_DENIED"):
            await action.disarm()
        await mode(drone, FlightMode.HOLD)
        await steer(drone, lambda: offboard.set_position_ned(PositionNedYaw(1.0, 0.0, -4.0, 0.0)), 2.5)
        where = await until(drone.telemetry.subscribe_position_velocity_ned())
        assert where.position.down_m == pytest.approx(-4.0, abs=0.4 + 0.5 * error)
        moved = await steer(drone, lambda: offboard.set_velocity_ned(VelocityNedYaw(0.0, 1.0, 0.0, 0.0)), 1.5)
        assert moved.velocity.east_m_s == pytest.approx(1.0, abs=0.35 + error)
        pushed = await steer(drone, lambda: offboard.set_acceleration_ned(AccelerationNed(1.0, 0.0, 0.0)), 0.6)
        assert 0.2 - error < pushed.velocity.north_m_s < 0.9 + error
        await steer(drone, lambda: offboard.set_attitude(Attitude(0.0, 0.0, 0.0, 0.5)), 0.4)
        await steer(drone, lambda: offboard.set_attitude_rate(AttitudeRate(0.0, 0.0, 20.0, 0.5)), 0.4)
        await action.return_to_launch()
        await mode(drone, FlightMode.RETURN_TO_LAUNCH)
        await action.land()
        await until(drone.telemetry.subscribe_landed_state(), lambda state: state == LandedState.LANDING)
        await until(drone.telemetry.subscribe_armed(), lambda armed: not armed)

    run(request.getfixturevalue(mock), fly)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["px4_sih", "arpl_250g"])
def test_the_usual_script_sets_a_setpoint_and_starts_at_once(name: str) -> None:
    async def fly(drone: SimpleNamespace) -> None:
        offboard, telemetry = drone.offboard, drone.telemetry
        await until(telemetry.subscribe_health_all_ok(), lambda well: well)
        here = await until(telemetry.subscribe_position_velocity_ned())
        await drone.action.arm()
        await offboard.set_position_ned(PositionNedYaw(0.0, 0.0, here.position.down_m, 0.0))
        await offboard.start()
        goal = here.position.down_m - 2.0
        await offboard.set_position_ned(PositionNedYaw(0.0, 0.0, goal, 0.0))
        await until(telemetry.subscribe_position_velocity_ned(), lambda now: now.position.down_m < goal + 0.3)
        await offboard.stop()
        await drone.action.land()
        await until(telemetry.subscribe_armed(), lambda armed: not armed)

    with mock_process("--speed", str(SPEED), vehicle=name) as process:
        run(process, fly)


@pytest.mark.slow
def test_kill_stops_the_motors_in_the_air(vehicle: MockProcess) -> None:
    async def fall(drone: SimpleNamespace) -> None:
        await until(drone.telemetry.subscribe_health(), lambda health: health.is_armable)
        await drone.action.arm()
        await drone.action.takeoff()
        await until(drone.telemetry.subscribe_in_air(), lambda in_air: in_air)
        await drone.action.kill()
        await until(drone.telemetry.subscribe_armed(), lambda armed: not armed)
        await until(drone.telemetry.subscribe_in_air(), lambda in_air: not in_air)

    run(vehicle, fall)
