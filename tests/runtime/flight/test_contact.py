"""Contacts, impacts and the ground show in PX4's own recordings, and nowhere where there are none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, VELOCITY
from dynamics.vehicle import GRAVITY
from runtime.flight.contact import ExternalForce, ForceMeter, LandingContact
from runtime.flight.crash import CrashDetector
from runtime.flight.events import Event
from runtime.flight.ground_probe import Ground, GroundProbe
from runtime.flight.thrust import ThrustResponse

FLIGHTS = Path(__file__).parents[2] / "data" / "px4_contacts"
MASS = 1.0  # kg, of PX4's SIH quadrotor
IN_FLIGHT = ("approach", "track", "brake", "return")
LEVEL = quaternion.IDENTITY


def recorded(name: str) -> Iterator[tuple[float, str, Floats, ForceMeter, float]]:
    """Time, phase, estimated state, external force, and true height of each sample of a recorded flight."""
    with np.load(FLIGHTS / f"{name}.npz") as columns:
        flight = {key: columns[key] for key in columns.files}
    meter, response = ForceMeter(), ThrustResponse()
    for row, time in enumerate(flight["time"].tolist()):
        state = flight["state"][row].astype(float)
        response.command(float(flight["thrust"][row]), time)
        attitude = state[ATTITUDE] / np.linalg.norm(state[ATTITUDE])
        force = flight["specific_force"][row].astype(float)
        meter.update(force, response.advance(time) / MASS, attitude, (time, state[VELOCITY]), time)
        phase = str(flight["phase"][row])
        if phase in IN_FLIGHT:
            meter.learn(0.01)
        yield time, phase, state, meter, float(flight["height"][row])


def landing_contact(name: str) -> tuple[float | None, float | None]:
    """When the landing contact shows, and when the true height falls below 2 cm, s."""
    detector, contact_time, touched = LandingContact(), None, None
    for time, phase, _, meter, height in recorded(name):
        if phase in ("descend", "touchdown"):
            touched = time if touched is None and height < 0.02 else touched
            if detector.update(meter, time, slow=phase == "touchdown") and contact_time is None:
                contact_time = time
    return contact_time, touched


def crash_events(name: str, until: float = np.inf) -> dict[Event, float]:
    """When events of a crash are first present, s."""
    detector = CrashDetector()
    first: dict[Event, float] = {}
    for time, phase, state, meter, _ in recorded(name):
        if phase not in IN_FLIGHT or time > until:
            continue
        for event in detector.force(meter, state[VELOCITY], time):
            first.setdefault(event, time)
        for event in detector.motion(state[ATTITUDE], LEVEL, 0.0, time):
            first.setdefault(event, time)
    return first


def test_a_landing_is_found_within_half_a_second() -> None:
    contact_time, touched = landing_contact("tipped_44deg")
    assert contact_time is not None
    assert touched is not None
    assert 0.0 <= contact_time - touched < 0.5


def test_nothing_is_found_in_a_fast_flight_with_twice_the_drag() -> None:
    assert crash_events("drag2_4_lemniscate") == {}
    assert landing_contact("drag2_4_lemniscate") == (None, None)


def test_the_crash_is_found_within_a_tenth_of_a_second_and_not_before() -> None:
    first = crash_events("crash_circle")
    touched = next(time for time, phase, _, _, height in recorded("crash_circle") if phase == "track" and height < 0.01)
    assert 0.0 <= first[Event.IMPACT] - touched < 0.1
    assert Event.GROUND_CONTACT in first
    assert crash_events("crash_circle", until=touched) == {}


def samples(acceleration: Floats, thrust: float, attitude: Floats, count: int = 12) -> ExternalForce:
    """The external force of a vehicle that accelerates like this, m/s^2, world, under a thrust per mass, m/s^2."""
    force = ExternalForce()
    felt = np.asarray(quaternion.rotate_inverse(attitude, acceleration + np.array([0.0, 0.0, GRAVITY])))
    for tick in range(count):
        force.add(0.01 * tick, felt, thrust, attitude)
    return force


def probed(acceleration: Floats, attitude: Floats, thrust: float) -> Ground:
    """What a probe finds of a vehicle that accelerates like this, m/s^2, world, under a thrust per mass, m/s^2."""
    probe, force = GroundProbe(0.0, 9.81, 9.81, climb_rate=0.0, levelling=0.0), samples(acceleration, thrust, attitude)
    verdicts = [
        probe.update(force, thrust, attitude, since, climb_rate=float(acceleration[2]) * since, low=True)
        for since in np.arange(0.0, 0.3, 0.01).tolist()
    ]
    return next((verdict for verdict in verdicts if verdict is not Ground.OPEN), Ground.OPEN)


@pytest.mark.parametrize("tilt", [0.0, 15.0, 45.0, 90.0, 170.0])
def test_a_vehicle_at_rest_is_carried_at_any_tilt_and_one_that_falls_is_not(tilt: float) -> None:
    attitude, thrust = quaternion.from_euler(np.radians(tilt), 0.0, 0.4), 0.3 * GRAVITY
    assert probed(np.zeros(3), attitude, thrust) is Ground.CARRIES
    falling = thrust * np.asarray(quaternion.rotate(attitude, np.array([0.0, 0.0, 1.0]))) - np.array([0, 0, GRAVITY])
    assert probed(falling, attitude, thrust) is Ground.ABSENT
    wind = np.array([3.0, 0.0, 0.0])
    assert probed(falling + wind, LEVEL, thrust) is not Ground.CARRIES or tilt > 45.0


@pytest.mark.parametrize("carried", [False, True])
def test_a_storm_that_was_there_before_the_probe_does_not_carry(carried: bool) -> None:
    storm, thrust = np.array([8.5, 0.0, 0.0]), 0.3 * GRAVITY
    attitude = quaternion.from_euler(0.0, -np.radians(40.0), 0.0)
    up = np.asarray(quaternion.rotate(attitude, np.array([0.0, 0.0, 1.0])))
    acceleration = np.zeros(3) if carried else thrust * up - np.array([0.0, 0.0, GRAVITY]) + storm
    assert probed(acceleration, attitude, thrust) is (Ground.CARRIES if carried else Ground.ABSENT)


def test_a_probe_reduces_thrust_within_a_third_of_a_second_and_not_below_its_floor() -> None:
    probe = GroundProbe(0.0, 8.0, 9.81, climb_rate=0.0, levelling=0.1)
    assert probe.thrust(0.01) < 0.61 * 9.81
    assert probe.thrust(0.3) == probe.thrust(1.0) == pytest.approx(0.3 * 9.81)


def test_without_inertial_samples_the_velocity_shows_the_force() -> None:
    meter = ForceMeter()
    for tick in range(60):
        meter.update(np.full(3, np.nan), 0.6 * GRAVITY, LEVEL, (0.01 * tick, np.zeros(3)), 0.01 * tick)
    assert meter.by_velocity
    assert meter.force.up == pytest.approx(0.4 * GRAVITY)


def test_a_stream_that_stops_leaves_no_force() -> None:
    force = samples(np.zeros(3), 0.0, LEVEL)
    before = force.up
    force.expire(1.0)
    assert before == pytest.approx(GRAVITY)
    assert force.up == 0.0


@pytest.mark.parametrize("rate", [20.0, 100.0, 500.0])
def test_an_impact_is_noticed_at_any_control_rate(rate: float) -> None:
    meter, detector, events = ForceMeter(), CrashDetector(), set()
    for tick in range(round(1.5 * rate)):
        time = tick / rate
        struck = 4.0 * GRAVITY if time > 1.0 else 0.0
        meter.update(np.array([struck, 0.0, GRAVITY]), GRAVITY, LEVEL, (time, np.zeros(3)), time)
        events |= set(detector.force(meter, np.array([5.0, 0.0, 0.0]), time))
    assert Event.IMPACT in events


@pytest.mark.parametrize(
    ("course", "overturned"),
    [
        (lambda time: 125.0 * np.sin(np.pi * time / 0.8), False),  # beyond 100 for 0.33 s
        (lambda time: min(400.0 * time, 180.0), True),
        (lambda time: min(150.0 * time, 110.0), True),
    ],
)
def test_a_vehicle_that_turns_back_to_level_is_not_overturned(
    course: Callable[[float], float], overturned: bool
) -> None:
    detector, events = CrashDetector(), set()
    for tick in range(120):
        half = np.radians(max(course(0.01 * tick), 0.0)) / 2
        attitude = np.array([np.cos(half), np.sin(half), 0.0, 0.0])
        events |= set(detector.motion(attitude, LEVEL, 0.0, 0.01 * tick))
    assert (Event.OVERTURNED in events) is overturned
