"""What must hold before a vehicle is armed: one list, each refusal with what to do."""

from __future__ import annotations

from math import nan
from typing import Any

import msgspec
import numpy as np
import pytest

from dynamics import quaternion
from dynamics.vehicle import GRAVITY
from runtime.link.estimate import StateEstimate
from runtime.link.start_conditions import Standing, StartFacts, VehicleFacts, standing, start_problems
from runtime.link.telemetry import EstimatorSample, VehicleStatus

STATUS = VehicleStatus(system=1, component=1, autopilot="px4", kind="quadrotor", mode="HOLD")
RATIOS = (("velocity", 0.1), ("horizontal position", 0.1), ("height", 0.2), ("magnetometer", nan))
ESTIMATOR = EstimatorSample(1.0, 1.0, 0b1101111111, RATIOS, 0.3, 0.5)
FACTS = StartFacts(
    STATUS,
    Standing(2.0, 0.02, 0.2, GRAVITY + 0.1, 1.5),
    ESTIMATOR,
    True,
    0.8,
    {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0, "MPC_THR_HOVER": 0.5, "CA_ROTOR_COUNT": 4, "THR_MDL_FAC": 0.0},
)
VEHICLE = VehicleFacts(4, lambda thrust_curve: 0.49)


def changed(**parts: Any) -> StartFacts:
    return msgspec.structs.replace(FACTS, **parts)


def stands(**parts: float) -> dict[str, Any]:
    assert FACTS.standing is not None
    return {"standing": msgspec.structs.replace(FACTS.standing, **parts)}


def estimator(**parts: Any) -> dict[str, Any]:
    return {"estimator": msgspec.structs.replace(ESTIMATOR, **parts)}


def parameters(**values: float) -> dict[str, Any]:
    return {"parameters": {**FACTS.parameters, **values}}


def test_a_vehicle_in_order_may_arm() -> None:
    assert start_problems(FACTS, VEHICLE) == ()
    assert start_problems(FACTS) == ()


@pytest.mark.parametrize(
    ("fault", "severity", "text"),
    [
        (stands(tilt=61.0), "error", "tilted by 61 degrees"),
        (stands(rate=0.6), "error", "turns at 0.60 rad/s"),
        (stands(speed=2.0), "error", "moves at 2.0 m/s"),
        (stands(specific_force=13.0), "error", "reads 13.0 m/s^2"),
        (stands(gravity_angle=30.0), "error", "30 degrees off the vertical"),
        ({"estimator": None}, "warning", "ESTIMATOR_STATUS does not come"),
        (estimator(flags=0b0000000111), "error", "no horizontal position, height"),
        (estimator(flags=ESTIMATOR.flags | 1024), "error", "jumps of the GPS"),
        (estimator(flags=ESTIMATOR.flags | 2048), "error", "accelerometer error"),
        (estimator(ratios=(("velocity", 1.7), ("height", 0.1))), "error", "rejects velocity (1.7)"),
        (estimator(vertical=5.0), "error", "uncertain of its vertical position by 5.0 m"),
        ({"charge": 0.12}, "error", "12% left"),
        ({"has_home": False}, "warning", "no home"),
        (parameters(COM_OF_LOSS_T=0.1), "error", "COM_OF_LOSS_T is 0.1 s"),
        (parameters(COM_OF_LOSS_T=3.0), "warning", "COM_OF_LOSS_T is 3 s"),
        (parameters(COM_OF_LOSS_T=30.0), "error", "COM_OF_LOSS_T is 30 s"),
        (parameters(COM_OBL_RC_ACT=6), "warning", "terminates the flight"),
        (parameters(COM_OBL_RC_ACT=7), "warning", "disarms in the air"),
        (parameters(CA_ROTOR_COUNT=6), "error", "6 rotors, the vehicle file has 4"),
        (parameters(MPC_THR_HOVER=0.25), "warning", "hovers at a thrust of 0.25"),
    ],
)
def test_each_fault_is_one_problem_with_a_remedy(fault: dict[str, Any], severity: str, text: str) -> None:
    (problem,) = start_problems(changed(**fault), VEHICLE)
    assert problem.severity == severity
    assert text in problem.text


def test_without_a_rotor_count_the_kind_of_vehicle_is_compared() -> None:
    bare = {name: value for name, value in FACTS.parameters.items() if name != "CA_ROTOR_COUNT"}
    hexarotor = msgspec.structs.replace(STATUS, kind="hexarotor")
    (problem,) = start_problems(changed(status=hexarotor, parameters=bare), VEHICLE)
    assert "6 rotors" in problem.text


def test_an_armed_vehicle_is_not_judged_by_how_it_stands() -> None:
    flying = msgspec.structs.replace(STATUS, armed=True)
    assert start_problems(changed(status=flying, **stands(tilt=40.0, rate=1.0, speed=5.0)), VEHICLE) == ()


def test_noise_of_an_estimate_at_rest_averages_out() -> None:
    random, estimates = np.random.default_rng(1), []
    attitude = quaternion.from_euler(np.radians(15.0), 0.0, 0.3)
    for tick in range(100):
        noise = np.hstack([np.zeros(3), 0.2 * random.standard_normal(3), np.zeros(4), 0.14 * random.standard_normal(3)])
        state = np.hstack([np.zeros(6), attitude, np.zeros(3)]) + noise
        estimates.append(StateEstimate(0.01 * tick, 0.01 * tick, state, 0, True, "ODOMETRY"))
    gravity = np.asarray(quaternion.rotate_inverse(attitude, np.array([0.0, 0.0, GRAVITY])))
    stand = standing(estimates, gravity + 1.4 * random.standard_normal((100, 3)))
    assert stand is not None
    assert stand.tilt == pytest.approx(15.0, abs=0.1)
    assert stand.rate < 0.1
    assert stand.speed < 0.2
    assert stand.specific_force == pytest.approx(GRAVITY, abs=0.5)
    assert stand.gravity_angle < 4.0
    assert standing([], gravity[None]) is None
