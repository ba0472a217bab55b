"""Conditions before a vehicle is armed: one list for `alula link` and `alula fly`, each refusal with its remedy.

`start_problems` is pure; `observe_start` collects its facts on a link in a second.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from math import acos, degrees, hypot, isfinite, nan

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from runtime.link.dialect import mavlink
from runtime.link.estimate import StateEstimate
from runtime.link.link import Link
from runtime.link.parameters import read_parameter
from runtime.link.problem import Problem
from runtime.link.telemetry import BatterySample, EstimatorSample, HomeSample, ImuSample, VehicleStatus

MAX_START_TILT = 20.0  # degrees: the steepest slope to start from, 15, and an error of the estimate
MAX_START_RATE = 0.3  # rad/s, mean
MAX_START_SPEED = 1.0  # m/s, median; PX4's estimate shows up to 0.5 at rest, 0.8 at worst
MAX_FORCE_ERROR = 1.0  # m/s^2
MAX_GRAVITY_ANGLE = 10.0  # degrees, of the specific force to the estimated vertical
MAX_RATIO = 1.0  # innovation test ratio above which PX4's estimator rejects a measurement
MAX_DEVIATION = {"horizontal": 2.0, "vertical": 3.0}  # m
MIN_CHARGE = 0.2
MIN_LOSS_TIME, WARN_LOSS_TIME, MAX_LOSS_TIME = 0.3, 2.0, 5.0  # s, of COM_OF_LOSS_T
HOVER_RATIO = 1.5  # between the hover thrusts of autopilot and vehicle file
PARAMETERS = ("COM_OF_LOSS_T", "COM_OBL_RC_ACT", "MPC_THR_HOVER", "THR_MDL_FAC", "CA_ROTOR_COUNT")
STREAMS: Mapping[str, float] = {"ESTIMATOR_STATUS": 5.0, "HOME_POSITION": 2.0}  # Hz
OBSERVED_TIME, SAMPLE_PERIOD, MAX_AGE = 1.0, 0.02, 3.0  # s
ROTORS = {"quadrotor": 4, "hexarotor": 6, "octorotor": 8}
_ESTIMATES = {
    mavlink.ESTIMATOR_ATTITUDE: "attitude",
    mavlink.ESTIMATOR_VELOCITY_HORIZ: "horizontal velocity",
    mavlink.ESTIMATOR_VELOCITY_VERT: "climb rate",
    mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS: "horizontal position",
    mavlink.ESTIMATOR_POS_VERT_ABS | mavlink.ESTIMATOR_POS_VERT_AGL: "height",
}
# ESTIMATOR_CONST_POS_MODE is none of them: PX4 sets it for some seconds after its start beside a good position
_FAULTS = {
    mavlink.ESTIMATOR_GPS_GLITCH: "reports jumps of the GPS: wait, or go where the sky is free.",
    mavlink.ESTIMATOR_ACCEL_ERROR: "reports an accelerometer error: look for vibration, calibrate the accelerometer.",
}


class Standing(msgspec.Struct, frozen=True):
    """How a vehicle stands, over a second.

    tilt: degrees, median. rate: rad/s, of the mean body rates. speed: m/s, of the median velocity.
    specific_force: m/s^2, length of its mean; gravity_angle: degrees, its angle to the estimated vertical; NaN without
    inertial samples.
    """

    tilt: float
    rate: float
    speed: float
    specific_force: float = nan
    gravity_angle: float = nan


class StartFacts(msgspec.Struct, frozen=True):
    """All that the conditions are judged by; None or NaN where the vehicle does not say."""

    status: VehicleStatus
    standing: Standing | None
    estimator: EstimatorSample | None
    has_home: bool
    charge: float
    parameters: Mapping[str, float]


class VehicleFacts(msgspec.Struct, frozen=True):
    """Facts of the vehicle file that the autopilot's parameters must agree with.

    rotors: their number. hover_thrust: the autopilot's THR_MDL_FAC to its thrust setpoint in hover, 0..1.
    """

    rotors: int
    hover_thrust: Callable[[float], float]


def observe_start(
    link: Link, parameters: Mapping[str, float] | None = None, duration: float = OBSERVED_TIME
) -> StartFacts:
    """Collect the facts on a link whose streams were requested. parameters: those that have been read already."""
    values = dict(parameters or {})
    for name in PARAMETERS:
        if name not in values and (value := read_parameter(link, name, timeout=0.3, attempts=2).value) is not None:
            values[name] = float(value)
    estimates: list[StateEstimate] = []
    forces: list[ImuSample] = []
    for _ in range(round(duration / SAMPLE_PERIOD)):
        time.sleep(SAMPLE_PERIOD)
        if (estimate := link.estimate) is not None and (not estimates or estimate is not estimates[-1]):
            estimates.append(estimate)
        imu = link.peer.latest.get(ImuSample)
        if isinstance(imu, ImuSample) and (not forces or imu is not forces[-1]):
            forces.append(imu)
    now, latest = time.monotonic(), link.peer.latest
    estimator, battery, home = (latest.get(kind) for kind in (EstimatorSample, BatterySample, HomeSample))
    return StartFacts(
        link.status,
        standing(estimates, np.array([sample.specific_force_body for sample in forces])),
        estimator if isinstance(estimator, EstimatorSample) and now - estimator.received < MAX_AGE else None,
        home is not None,
        battery.remaining if isinstance(battery, BatterySample) else nan,
        values,
    )


def standing(estimates: list[StateEstimate], forces: Floats) -> Standing | None:
    """How a vehicle stands; None without estimates. forces: (n, 3) specific forces, m/s^2, body."""
    if not estimates:
        return None
    attitude = estimates[-1].attitude
    ups = [float(quaternion.rotate(each.attitude, np.array([0.0, 0.0, 1.0]))[2]) for each in estimates]
    rate = np.mean([each.rate_body for each in estimates], axis=0)
    speed = np.median([each.velocity_world for each in estimates], axis=0)
    length = angle = nan
    if len(forces) and np.isfinite(forces).all():
        mean = forces.mean(axis=0)
        length = hypot(*mean)
        angle = _angle(float(quaternion.rotate(attitude, mean)[2]) / length) if length > 0 else 180.0
    return Standing(_angle(float(np.median(ups))), hypot(*rate), hypot(*speed), length, angle)


def _angle(cosine: float) -> float:
    return degrees(acos(max(-1.0, min(1.0, cosine))))


def start_problems(facts: StartFacts, vehicle: VehicleFacts | None = None) -> tuple[Problem, ...]:
    """The problems that stand against arming; an error refuses it. vehicle: from its file, None without one."""
    checks: tuple[Callable[[], Iterator[Problem]], ...] = (
        lambda: _standing_problems(facts),
        lambda: _estimator_problems(facts.estimator),
        lambda: _supply_problems(facts),
        lambda: _parameter_problems(facts.parameters),
        lambda: _vehicle_file_problems(facts, vehicle),
    )
    return tuple(problem for check in checks for problem in check())


def _standing_problems(facts: StartFacts) -> Iterator[Problem]:
    stands = facts.standing
    if stands is None or facts.status.armed:
        return
    if stands.tilt > MAX_START_TILT:
        yield Problem(
            "error",
            f"The vehicle is tilted by {stands.tilt:.0f} degrees, at most {MAX_START_TILT:.0f} may be. Put it upright "
            "on level ground; if it stands so already, calibrate its level horizon.",
        )
    if stands.rate > MAX_START_RATE:
        text = f"The vehicle turns at {stands.rate:.2f} rad/s. Put it down; if it stands still, calibrate its gyro."
        yield Problem("error", text)
    if stands.speed > MAX_START_SPEED:
        yield Problem(
            "error",
            f"The vehicle moves at {stands.speed:.1f} m/s by its estimate. Start from ground that does not move; if it "
            "stands still, wait until the estimator has converged, or restart the autopilot.",
        )
    if abs(stands.specific_force - GRAVITY) > MAX_FORCE_ERROR:
        yield Problem(
            "error",
            f"The accelerometer reads {stands.specific_force:.1f} m/s^2 at rest, expected about {GRAVITY}: landings "
            "are found by it. Calibrate the accelerometer.",
        )
    if stands.gravity_angle > MAX_GRAVITY_ANGLE and stands.speed < MAX_START_SPEED and stands.rate < MAX_START_RATE:
        yield Problem(
            "error",
            f"At rest the attitude puts gravity {stands.gravity_angle:.0f} degrees off the vertical: wrong frames, or "
            "an estimator that has not converged. Wait, then check the autopilot's orientation (SENS_BOARD_ROT).",
        )


def _estimator_problems(status: EstimatorSample | None) -> Iterator[Problem]:
    if status is None:
        yield Problem("warning", "ESTIMATOR_STATUS does not come: what the estimator says of itself is not checked.")
        return
    for text in (*estimator_doubts(status), estimator_rejections(status)):
        if text:
            yield Problem("error", f"The estimator {text}")


def estimator_doubts(status: EstimatorSample) -> list[str]:
    """Why the estimator does not vouch for its estimate, each with what to do."""
    missing = [name for flags, name in _ESTIMATES.items() if not status.flags & flags]
    doubts = [text for flag, text in _FAULTS.items() if status.flags & flag]
    for name, limit in MAX_DEVIATION.items():
        deviation = getattr(status, name)
        if deviation > limit:
            text = f"is uncertain of its {name} position by {deviation:.1f} m, at most {limit:g} m may be. Wait."
            doubts.append(text)
    if missing:
        doubts.insert(0, f"has no {', '.join(missing)}. Check GPS, motion capture or optical flow, and wait for it.")
    return doubts


def estimator_rejections(status: EstimatorSample) -> str:
    """Which measurements the estimator rejects, with what to do; empty if none."""
    rejected = [f"{name} ({ratio:.1f})" for name, ratio in status.ratios if ratio > MAX_RATIO]
    if not rejected:
        return ""
    return f"rejects {', '.join(rejected)}: test ratio above 1. Wait, or look for what disturbs it."


def _supply_problems(facts: StartFacts) -> Iterator[Problem]:
    if facts.charge < MIN_CHARGE:
        text = f"The battery has {facts.charge:.0%} left, at least {MIN_CHARGE:.0%} are needed. Charge or change it."
        yield Problem("error", text)
    if not facts.has_home and facts.parameters.get("COM_OBL_RC_ACT", 0) in (0, 1, 2, 3):
        yield Problem(
            "warning",
            "The vehicle has no home yet, but returns to it when it loses the companion (COM_OBL_RC_ACT). Wait for "
            "GPS, or set COM_OBL_RC_ACT to 4, which lands.",
        )


def _parameter_problems(values: Mapping[str, float]) -> Iterator[Problem]:
    loss, action = values.get("COM_OF_LOSS_T", nan), values.get("COM_OBL_RC_ACT")
    if loss < MIN_LOSS_TIME:
        yield Problem(
            "error",
            f"COM_OF_LOSS_T is {loss:g} s: a few late setpoints would end the flight. Set it to 1.",
        )
    elif loss > WARN_LOSS_TIME:
        text = f"COM_OF_LOSS_T is {loss:g} s: so long the vehicle keeps to the last setpoint of a dead companion."
        yield Problem("error" if loss > MAX_LOSS_TIME else "warning", f"{text} Set it to 1.")
    if action in (6, 7):
        what = "terminates the flight" if action == 6 else "disarms in the air"
        text = f"COM_OBL_RC_ACT is {action:g}: losing the companion {what}. 4 lands, 5 holds."
        yield Problem("warning", text)


def _vehicle_file_problems(facts: StartFacts, vehicle: VehicleFacts | None) -> Iterator[Problem]:
    if vehicle is None:
        return
    count = facts.parameters.get("CA_ROTOR_COUNT", ROTORS.get(facts.status.kind, nan))
    if isfinite(count) and count > 0 and count != vehicle.rotors:
        text = f"The autopilot flies {count:.0f} rotors, the vehicle file has {vehicle.rotors}."
        yield Problem("error", f"{text} Give the vehicle's own file.")
    hover = facts.parameters.get("MPC_THR_HOVER", nan)
    expected = vehicle.hover_thrust(facts.parameters.get("THR_MDL_FAC", 0.0))
    if isfinite(hover) and not expected / HOVER_RATIO <= hover <= expected * HOVER_RATIO:
        yield Problem(
            "warning",
            f"The autopilot hovers at a thrust of {hover:.2f} (MPC_THR_HOVER), by the vehicle file it takes "
            f"{expected:.2f}: if the parameter was ever set, mass or thrust_constant of the file are wrong.",
        )
