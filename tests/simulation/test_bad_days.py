"""Flights that must end safely on PX4's estimate and ground: each is named, and nothing is hit or tips over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynamics.references import named_reference
from runtime.flight.composition import Controllers
from runtime.flight.mission import Phase, Plan
from simulation.whole_flight import WholeFlight, fly_whole, tilts
from sitl_mock.mock import MockOptions
from vehicles import FOLDER

FILE = FOLDER / "px4_sih.toml"
PLAN = Plan(height=1.0, duration=3.0, settle=0.3, origin="takeoff")
STEEPEST = np.radians(12.0)


def fly(controllers: Controllers, folder: Path, scenario: str, *, seed: int = 31, **options: object) -> WholeFlight:
    path = folder / "scenario.toml"
    path.write_text(scenario)
    mock = MockOptions(FILE, scenario=path, seed=seed, **options)  # type: ignore[arg-type]
    reference = named_reference("hover", controllers.flying.trim)
    return fly_whole(mock, reference, plan=PLAN, controllers=controllers, limit=60.0)


def steepest(flight: WholeFlight) -> float:
    """Greatest true tilt of the whole flight, rad."""
    return float(tilts(np.array(flight.truth)[:, 6:10]).max())


def test_an_estimate_that_freezes_at_touch_down(controllers: Controllers, tmp_path: Path) -> None:
    flight = fly(controllers, tmp_path, '[[faults]]\nkind = "estimate_freeze"\nat = 0.0\nafter = "touchdown"')
    assert np.isfinite(flight.disarmed), flight.outcome
    assert flight.tilt_after_contact < STEEPEST


def test_satellites_lost_in_flight(controllers: Controllers, tmp_path: Path) -> None:
    flight = fly(controllers, tmp_path, '[[faults]]\nkind = "gnss_loss"\nat = 1.0\nafter = "takeoff"')
    assert np.isfinite(flight.disarmed), flight.outcome
    assert "input_not_finite" in flight.events
    assert flight.tilt_after_contact < STEEPEST


def test_a_height_that_jumps_while_landing(controllers: Controllers, tmp_path: Path) -> None:
    reset = '[[faults]]\nkind = "estimator_reset"\nat = 20.0\nafter = "takeoff"\nshift = [0.0, 0.0, 1.0]'
    flight = fly(controllers, tmp_path, reset)
    assert flight.landed, flight.outcome
    assert "estimator_reset" in flight.events
    assert flight.tilt_after_contact < STEEPEST


@pytest.mark.parametrize("ground", ["sih", "legs"])
def test_take_off_from_a_slope_of_15_degrees(controllers: Controllers, tmp_path: Path, ground: str) -> None:
    flight = fly(controllers, tmp_path, "", slope=15.0, ground=ground)
    assert flight.landed, flight.outcome
    assert steepest(flight) < np.radians(45.0)


def test_take_off_from_a_moving_deck(controllers: Controllers, tmp_path: Path) -> None:
    flight = fly(controllers, tmp_path, 'ground = { kind = "legs", speed = [1.0, 0.0] }')
    assert np.isfinite(flight.disarmed) or Phase.CLIMB not in flight.phases, flight.outcome
    assert steepest(flight) < np.radians(45.0)


def test_a_missing_propeller(controllers: Controllers, tmp_path: Path) -> None:
    lost = '[[effects]]\nname = "weak_rotor"\nrotor = 0\nparameters = { loss = 0.9, torque_loss = 0.9 }'
    flight = fly(controllers, tmp_path, lost)
    assert np.isfinite(flight.disarmed), flight.outcome
    assert {"tipping", "takeoff_failed"} & set(flight.events)
    assert max(flight.clearance) < 0.5


def test_held_by_hand(controllers: Controllers, tmp_path: Path) -> None:
    flight = fly(controllers, tmp_path, '[[faults]]\nkind = "held"\nat = 0.0')
    assert np.isfinite(flight.disarmed), flight.outcome
    assert "takeoff_failed" in flight.events
    assert max(flight.clearance) < 0.5
