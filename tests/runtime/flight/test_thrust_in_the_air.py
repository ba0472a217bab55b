"""Recordings of real PX4 on which motors were stopped in the air: no lift-off, no lasting force, no ground in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY
from dynamics.vehicle import GRAVITY
from runtime.flight.contact import ForceMeter, LandingContact
from runtime.flight.ground_probe import Ground, GroundProbe
from runtime.flight.settling import Settling
from runtime.flight.takeoff import TakeoffRamp
from runtime.flight.thrust import MAX_FILE_ERROR, MIN_FILE_ERROR, EffectivenessEstimator, vertical

FLIGHTS = Path(__file__).parents[2] / "data" / "px4_thrust"
MASS, WEIGHT, THRUST_MAX = 1.0, GRAVITY, 20.0  # of PX4's SIH quadrotor
HALVED = 2.6 / 5.0
LOST_AT = 11.9  # s, by which the halved thrust has gone


def recorded(name: str) -> dict[str, Floats]:
    with np.load(FLIGHTS / f"{name}.npz") as columns:
        return {key: columns[key].astype(float) for key in columns.files}


def test_a_ramp_on_which_the_estimate_climbs_with_the_noise_is_no_lift_off() -> None:
    """As PX4's did: by 0.07 m at 0.2 m/s while the accelerometer's mean passed 1.07 g and the vehicle stood."""
    flight = recorded("false_lift_off")
    assert flight["height"].max() < 0.01
    ramp = TakeoffRamp(WEIGHT, THRUST_MAX)
    for row, time in enumerate(flight["time"].tolist()):
        state = flight["state"][row]
        force = vertical(flight["specific_force"][row], state[ATTITUDE])
        ramp.update(time, state[POSITION][2], state[VELOCITY][2], force)
        assert not ramp.lifted


@pytest.mark.parametrize("effectiveness", [0.6, 0.8, 1.0, 1.3, 1.6])
def test_noise_that_the_estimate_integrates_lifts_nothing_off_before_the_vehicle_does(effectiveness: float) -> None:
    for seed in range(20):
        rng, ramp = np.random.default_rng(seed), TakeoffRamp(WEIGHT, THRUST_MAX)
        force = climb = height = false_climb = false_height = 0.0
        for tick in range(500):
            felt = max(force / WEIGHT, 1.0) * GRAVITY + 1.4 * rng.normal()
            false_climb += (felt - max(force / WEIGHT, 1.0) * GRAVITY) * 0.01
            false_height += false_climb * 0.01
            thrust = ramp.update(0.01 * tick, height + false_height, climb + false_climb, felt)
            if ramp.lifted:
                break
            force += (effectiveness * thrust - force) * 0.01 / 0.07
            climb = max(climb + (force / WEIGHT - 1) * GRAVITY * 0.01, 0.0 if height <= 0 else -9.0)
            height += climb * 0.01
        assert ramp.lifted
        assert 0.0 < height < 0.4
        assert ramp.effectiveness == pytest.approx(effectiveness, rel=0.15)


def test_the_effectiveness_at_lift_off_is_none_that_no_file_is_wrong_by() -> None:
    """Without an accelerometer, on an estimate that climbs at once."""
    ramp = TakeoffRamp(WEIGHT, THRUST_MAX)
    for tick in range(300):
        ramp.update(0.01 * tick, 0.01 * tick, 1.0)
        if ramp.lifted:
            break
    assert ramp.lifted
    assert ramp.collective_thrust * MAX_FILE_ERROR >= WEIGHT
    assert MIN_FILE_ERROR <= ramp.effectiveness <= MAX_FILE_ERROR


def flown(flight: dict[str, Floats]) -> tuple[list[float], list[Floats], list[bool]]:
    """Effectiveness, usual force and landing contacts, tick by tick, of a flight that tracks all the time."""
    estimator, meter, detector = EffectivenessEstimator(MASS), ForceMeter(), LandingContact()
    values, usual, contacts = [], [], []
    for row, time in enumerate(flight["time"].tolist()):
        state, force = flight["state"][row], flight["specific_force"][row]
        attitude, velocity = state[ATTITUDE], state[VELOCITY]
        climb = float(quaternion.rotate_inverse(attitude, velocity)[2])
        sideways = (float(force[0]), float(force[1]))
        estimator.measure(float(force[2]), time, float(np.linalg.norm(velocity)), climb=climb, sideways=sideways)
        estimator.command(float(flight["thrust"][row]), time)
        meter.update(force, estimator.thrust(time) / MASS, attitude, (time, velocity), time)
        meter.learn(0.01)
        values.append(estimator.value)
        usual.append(meter.usual.copy())
        contacts.append(detector.update(meter, time, slow=True))
    return values, usual, contacts


def test_half_of_the_thrust_lost_is_thrust_and_not_a_force_from_outside() -> None:
    flight = recorded("thrust_halved")
    values, usual, _ = flown(flight)
    since = flight["time"] - LOST_AT
    assert np.allclose(np.array(values)[since > 0.6], HALVED, atol=0.12)
    assert max(np.linalg.norm(force) for force in usual) < 0.25 * GRAVITY


def test_no_ground_is_found_while_a_vehicle_sinks_under_half_of_its_thrust() -> None:
    flight = recorded("thrust_halved")
    assert flight["height"].min() > 1.8
    _, _, contacts = flown(flight)
    assert not any(np.array(contacts)[flight["time"] > LOST_AT + 0.6])


@pytest.mark.parametrize("effectiveness", [0.55, 1.0, 1.65])
@pytest.mark.parametrize("height_allows", [False, True])
def test_a_probe_in_the_air_finds_no_ground_whatever_the_thrust_and_the_force_before(
    effectiveness: float, *, height_allows: bool
) -> None:
    probe, meter, climb, force = (
        GroundProbe(0.0, WEIGHT, WEIGHT, climb_rate=-0.3, levelling=0.1),
        ForceMeter(),
        -0.3,
        1.0,
    )
    meter.usual = np.array([0.0, 0.0, -0.8 * GRAVITY])
    verdicts, rng = [], np.random.default_rng(1)
    for tick in range(40):
        time = 0.01 * tick
        force += (probe.thrust(time) / WEIGHT - force) * 0.01 / 0.07
        felt = effectiveness * force * GRAVITY - climb  # with a drag of 1 1/s
        climb += (felt - GRAVITY) * 0.01
        measured = np.array([0.0, 0.0, felt + rng.normal()])
        meter.update(measured, force * GRAVITY, quaternion.IDENTITY, (time, np.array([0.0, 0.0, climb])), time)
        verdicts.append(
            probe.update(meter.force, meter.thrust, quaternion.IDENTITY, time, climb_rate=climb, low=height_allows)
        )
    assert Ground.CARRIES not in verdicts
    assert Ground.ABSENT in verdicts or effectiveness > 1.5  # with so much thrust left it hardly falls


def test_force_alone_is_no_ground_where_the_estimate_falls_and_lasts_longer_where_it_is_high() -> None:
    def verdicts_of(climb_rate: float, *, low: bool) -> list[Ground]:
        probe, meter = GroundProbe(0.0, WEIGHT, WEIGHT, climb_rate=0.0, levelling=0.0), ForceMeter()
        verdicts = []
        for tick in range(60):
            time = 0.01 * tick
            felt, thrust = np.array([0.0, 0.0, GRAVITY]), probe.thrust(time) * GRAVITY / WEIGHT
            meter.update(felt, thrust, quaternion.IDENTITY, (time, np.zeros(3)), time)
            now = climb_rate * time
            verdicts.append(probe.update(meter.force, meter.thrust, quaternion.IDENTITY, time, climb_rate=now, low=low))
        return verdicts

    near, high = verdicts_of(0.0, low=True), verdicts_of(0.0, low=False)
    assert near.index(Ground.CARRIES) < 25
    assert high.index(Ground.CARRIES) > near.index(Ground.CARRIES) + 20
    assert Ground.CARRIES not in verdicts_of(-0.8 * GRAVITY, low=True)


def test_a_steady_fall_that_air_brakes_is_no_ground() -> None:
    """At 2.2 m/s, where drag and half of the thrust carry the weight: the force stays, and so does the speed."""
    probe, meter = GroundProbe(0.0, WEIGHT, WEIGHT, climb_rate=-2.2, levelling=0.5), ForceMeter()
    verdicts = []
    for tick in range(100):
        time, velocity = 0.01 * tick, np.array([0.0, 0.0, -2.2])
        thrust = probe.thrust(time) * GRAVITY / WEIGHT
        meter.update(np.array([0.0, 0.0, GRAVITY]), thrust, quaternion.IDENTITY, (time, velocity), time)
        verdicts.append(probe.update(meter.force, thrust, quaternion.IDENTITY, time, climb_rate=-2.2, low=True))
    assert Ground.CARRIES not in verdicts
    assert verdicts.index(Ground.ABSENT) < 10


@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_thrust_ends_at_once_on_the_ground_but_not_while_the_vehicle_turns(rate: float) -> None:
    settling, meter = Settling(WEIGHT, 6.0), ForceMeter()
    state = np.zeros(13)
    state[ATTITUDE] = quaternion.IDENTITY
    state[RATE][0] = rate
    settling.begin(state, WEIGHT, 0.0, cause="")
    thrusts: list[float] = []
    for tick in range(60):
        time = 0.01 * tick
        sent = thrusts[-1] if thrusts else WEIGHT
        meter.update(np.array([0.0, 0.0, GRAVITY]), sent, quaternion.IDENTITY, (time, np.zeros(3)), time)
        _, thrust, ground = settling.command(state, meter, time, current=True, low=True)
        thrusts.append(thrust)
        if ground is Ground.CARRIES:
            break
        if time > 0.35:
            state[RATE][0] = 0.0
    assert thrusts[-1] == 0.0
    assert min(thrusts[:-1]) >= 0.29 * WEIGHT
    assert (len(thrusts) > 35) is (rate > 0.0)
    assert len(thrusts) < 55
