"""Flights that must end safely on PX4's estimate and ground: each is named, and nothing is hit or tips over."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

from dynamics.references import named_reference
from runtime.flight.composition import Controllers
from runtime.flight.events import Event
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from simulation.whole_flight import Lockstep, WholeFlight, fly_whole
from sitl_mock.autopilot.fault_schedule import Fault
from sitl_mock.mock import MockOptions
from sitl_mock.scenario import Scenario
from sitl_mock.vehicle.ground import Ground
from vehicles import FOLDER

FILE = FOLDER / "px4_sih.toml"
PLAN = Plan(height=1.5, duration=3.0, settle=0.3, origin="takeoff", low=0.7)
STEEPEST = radians(12.0)


def fly(
    controllers: Controllers,
    *faults: Fault,
    ground: Ground | None = None,
    effects: tuple[str, ...] = (),
    watch: object = None,
    plan: Plan = PLAN,
) -> WholeFlight:
    scenario = Scenario(faults=faults, ground=ground or Ground())
    reference = named_reference("hover:height=1.5", controllers.flying.trim)
    return fly_whole(
        MockOptions(FILE, scenario=scenario, effects=effects, seed=31),
        reference,
        plan=plan,
        controllers=controllers,
        watch=watch,  # type: ignore[arg-type]
        limit=60.0,
    )


def nightly(*values: object) -> object:
    """Parameters of a flight that `make test-all` flies."""
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize(("at", "after"), [(0.0, "touchdown"), nightly(0.3, "touchdown"), (4.0, "takeoff")])
def test_an_estimate_that_freezes(controllers: Controllers, at: float, after: str) -> None:
    flight = fly(controllers, Fault("estimate_freeze", at, after))  # type: ignore[arg-type]
    assert np.isfinite(flight.disarmed), flight.outcome
    assert Event.ESTIMATE_FROZEN in flight.raised
    assert flight.tilt_after_contact < STEEPEST


@pytest.mark.parametrize(("at", "after"), [(0.5, "arming"), (1.0, "takeoff"), (4.0, "takeoff"), (0.0, "touchdown")])
def test_satellites_lost(controllers: Controllers, at: float, after: str) -> None:
    flight = fly(controllers, Fault("gnss_loss", at, after))  # type: ignore[arg-type]
    assert np.isfinite(flight.disarmed), flight.outcome
    assert after == "touchdown" or {Event.INPUT_NOT_FINITE, Event.ESTIMATOR_DEGRADED} & flight.raised
    assert flight.tilt_after_contact < STEEPEST


def test_an_estimator_that_does_not_vouch_for_its_estimate_any_more(controllers: Controllers) -> None:
    flight = fly(controllers, Fault("gnss_glitch", 4.0, "takeoff"))
    assert Event.ESTIMATOR_DEGRADED in flight.raised
    assert "jumps of the GPS" in flight.landing_reason
    assert flight.outcome == "landed and disarmed"
    assert flight.tilt_after_contact < STEEPEST


@pytest.mark.parametrize("shift", [nightly(1.0), -1.0])
@pytest.mark.parametrize("phase", [Phase.DESCEND, Phase.TOUCHDOWN])
@pytest.mark.parametrize("reported", [nightly(True), False])
def test_a_height_that_jumps_by_a_metre_while_landing(
    controllers: Controllers, shift: float, phase: Phase, reported: bool
) -> None:
    done: list[float] = []

    def jump(flown: Lockstep) -> None:
        since = flown.autopilot.time - flown.flyer.mission.phase_started
        if flown.flyer.mission.phase is phase and since > 0.3 and not done:
            fault, counter = flown.autopilot.estimate_fault, flown.autopilot.estimate_fault.reset_counter
            fault.reset(np.array([0.0, 0.0, shift]), 0.0)
            if not reported:
                fault.reset_counter = counter
            done.append(flown.autopilot.time)

    flight = fly(controllers, watch=jump)
    assert done
    assert flight.landed, flight.outcome
    assert {Event.ESTIMATOR_RESET, Event.ESTIMATE_JUMP} & flight.raised
    assert flight.tilt_after_contact < STEEPEST


@pytest.mark.parametrize("kind", [nightly("sih"), "legs"])
def test_take_off_from_a_slope_of_15_degrees(controllers: Controllers, kind: str) -> None:
    flight = fly(controllers, ground=Ground(kind=kind, slope=radians(15.0)))  # type: ignore[arg-type]
    assert flight.landed, flight.outcome
    assert flight.tilt.max() < radians(45.0)


@pytest.mark.parametrize("speed", [nightly((0.5, 0.0)), (0.0, 1.0)])
def test_take_off_from_a_deck_that_moves_sideways(controllers: Controllers, speed: tuple[float, float]) -> None:
    flight = fly(controllers, ground=Ground(kind="legs", speed=speed, heave=0.1))
    assert np.isfinite(flight.disarmed) or Phase.CLIMB not in flight.phases, flight.outcome
    assert flight.tilt.max() < radians(45.0)


@pytest.mark.parametrize("rotor", [0, nightly(3)])
@pytest.mark.parametrize("kind", ["sih", "legs"])
def test_a_missing_propeller(controllers: Controllers, rotor: int, kind: str) -> None:
    lost = f"weak_rotor:rotor={rotor},loss=0.9,torque_loss=0.9"
    flight = fly(controllers, effects=(lost,), ground=Ground(kind=kind))  # type: ignore[arg-type]
    assert np.isfinite(flight.disarmed), flight.outcome
    assert {Event.TIPPING, Event.TAKEOFF_FAILED} & flight.raised
    assert not flight.landed
    assert flight.outcome.startswith("did not take off and disarmed: ")
    assert max(flight.clearance) < 0.5


def test_held_by_hand_on_the_ground(controllers: Controllers) -> None:
    flight = fly(controllers, Fault("held", 0.0))
    assert np.isfinite(flight.disarmed), flight.outcome
    assert Event.TAKEOFF_FAILED in flight.raised
    assert not flight.landed
    assert "is it held" in flight.outcome
    assert max(flight.clearance) < 0.5


@pytest.mark.parametrize("at", [3.0, 5.0])
def test_seized_and_held_in_flight(controllers: Controllers, at: float) -> None:
    flight = fly(controllers, Fault("held", at, "takeoff"))
    assert np.isfinite(flight.disarmed), flight.outcome
    assert {Event.IMPACT, Event.HELD, Event.GROUND_CONTACT, Event.SETPOINT_REFUSED} & flight.raised
    assert not (flight.landed and flight.landing_reason == "")
