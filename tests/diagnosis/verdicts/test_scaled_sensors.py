"""A gyro or an accelerometer of a wrong scale is named as such: its derivative looks like another inertia."""

from __future__ import annotations

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.report import Diagnosis
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from fixtures.compiled_flights import compiled_flights
from fixtures.mutated_flights import USUAL, with_columns
from flights import Flight

CENTRE_OF_MASS = EffectUse("centre_of_mass", {"x": 0.004, "y": -0.002, "z": 0.0})
HIDDEN = {"nothing": [], "centre_of_mass": [CENTRE_OF_MASS]}


@pytest.fixture(scope="module", params=HIDDEN)
def hidden(request: pytest.FixtureRequest, arpl_250g: Vehicle) -> tuple[list[EffectUse], list[Flight]]:
    """What is hidden, and flights with sound sensors."""
    uses = HIDDEN[request.param]
    return uses, compiled_flights(arpl_250g, uses, catalogue=CATALOGUE, seed=104, manoeuvres=USUAL)


def scaled(flights: list[Flight], columns: list[str], ratio: float) -> list[Flight]:
    """The flights with some columns times a ratio."""
    return [with_columns(f, {name: ratio * f[name] for name in columns}) for f in flights]


def diagnosed(flights: list[Flight], vehicle: Vehicle) -> Diagnosis:
    """By the whole catalogue."""
    return diagnose_dataset(make_dataset(flights, vehicle), vehicle, CATALOGUE).diagnosis


@pytest.mark.parametrize(
    ("name", "quantity", "ratio"),
    [("gyro_scale", "rate", 1.1), ("gyro_scale", "rate", 0.9), ("imu_scale", "specific_force", 1.1)],
)
def test_a_sensor_of_another_scale_is_named_with_its_ratio(hidden, arpl_250g, name, quantity, ratio):
    uses, flights = hidden
    diagnosis = diagnosed(scaled(flights, [f"{quantity}_{axis}" for axis in "xyz"], ratio), arpl_250g)
    assert diagnosis.verdict == "effect"
    assert {e.name for e in diagnosis.effects} == {name, *(use.name for use in uses)}
    estimate = next(e for e in diagnosis.effects if e.name == name).parameters["ratio"]
    assert estimate.value == pytest.approx(ratio, rel=0.002)
    assert abs(estimate.value - ratio) < 3 * estimate.std


def test_sound_sensors_have_no_wrong_scale(hidden, arpl_250g):
    uses, flights = hidden
    diagnosis = diagnosed(flights, arpl_250g)
    assert {e.name for e in diagnosis.effects} == {use.name for use in uses}
    assert diagnosis.verdict == ("effect" if uses else "explained")


def test_one_axis_of_the_gyro_is_no_inertia(hidden, arpl_250g):
    """The catalogue has no error of one axis: the answer is `unknown`, and no moment is named for it."""
    _, flights = hidden
    diagnosis = diagnosed(scaled(flights, ["rate_x"], 1.1), arpl_250g)
    assert diagnosis.verdict == "unknown"
    assert not {e.name for e in diagnosis.effects} & {"inertia", "torque_constant"}
