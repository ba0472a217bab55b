"""What lies between command and thrust leaves alone what flights show of the weight, and competes with the effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.by_likelihood import problems_of
from diagnosis.data.dataset import Dataset
from diagnosis.data.segment import Segment, segments
from diagnosis.models.command_effects import (
    COMMAND_EFFECTS,
    seen_as,
    with_command_effects,
    without_command_effects,
)
from diagnosis.models.predictor import Predictor
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from flights import Flight


@pytest.fixture(scope="module")
def commanded(plain_flights: list[Flight], arpl_250g: Vehicle) -> Segment:
    return replace(segments(plain_flights[5], arpl_250g)[0], rotor_source="command")


def predicted(vehicle: Vehicle, segment: Segment, **changed: float) -> tuple[np.ndarray, np.ndarray]:
    """Specific force and angular acceleration (n, 3) with some parameters changed."""
    full, catalogue = with_command_effects(vehicle, CATALOGUE, [segment])
    predictor = Predictor(full, full.effects, catalogue, speed_measured=False)
    prediction = predictor.predict(segment, {name.replace("__", "."): value for name, value in changed.items()})
    return prediction.specific_force, prediction.angular_acceleration


def test_at_their_neutral_values_they_change_nothing(commanded: Segment, arpl_250g: Vehicle) -> None:
    plain = Predictor(arpl_250g, [], CATALOGUE, speed_measured=False).predict(commanded)
    force, angular = predicted(arpl_250g, commanded)
    np.testing.assert_allclose(force, plain.specific_force, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(angular, plain.angular_acceleration, rtol=1e-9, atol=1e-9)


def test_a_gain_scales_forces_and_moments(commanded: Segment, arpl_250g: Vehicle) -> None:
    force, _ = predicted(arpl_250g, commanded)
    more, _ = predicted(arpl_250g, commanded, command_gain__ratio=1.1)
    np.testing.assert_allclose(more, 1.1 * force, atol=1e-9)


def test_beside_the_gain_less_thrust_is_more_torque(commanded: Segment, arpl_250g: Vehicle) -> None:
    with_both = arpl_250g.with_effects(
        EffectUse("thrust_constant", {"ratio": 1.0}), EffectUse("torque_constant", {"ratio": 1.0})
    )
    weak = predicted(with_both, commanded, thrust_constant__ratio=0.9, command_gain__ratio=1 / 0.9)
    twisting = predicted(with_both, commanded, torque_constant__ratio=1 / 0.9)
    np.testing.assert_allclose(weak, twisting, atol=1e-9)
    assert seen_as(["inertia", "torque_constant"], CATALOGUE) == ["thrust_constant"]
    assert seen_as(["inertia"], CATALOGUE) == []


def test_one_motors_gain_leaves_the_sum(commanded: Segment, arpl_250g: Vehicle) -> None:
    level = replace(commanded, rotor_speed=np.full_like(commanded.rotor_speed, arpl_250g.hover_speed))
    full, catalogue = with_command_effects(arpl_250g, CATALOGUE, [level])
    predictor = Predictor(full, full.effects, catalogue, speed_measured=False)
    changed = predictor.predict(level, {"motor_gain[0].ratio": 1.2})
    np.testing.assert_allclose(changed.specific_force, predictor.predict(level).specific_force, atol=1e-9)
    assert np.min(np.max(np.abs(changed.angular_acceleration[:, :2]), axis=0)) > 1.0


@pytest.mark.parametrize("in_file", [None, 1.25])
def test_thrust_carries_whatever_mass_the_model_has(
    commanded: Segment, arpl_250g: Vehicle, in_file: float | None
) -> None:
    """Thrust over mass stays as the flights show it; drag over mass falls, moment over inertia rises."""
    drag = EffectUse("linear_drag", {"coefficient": 0.1})
    vehicle = arpl_250g.with_effects(drag, EffectUse("mass", {"ratio": in_file or 1.0}))
    segment = replace(commanded, carried_mass=in_file or 1.0)
    light, heavy = (
        predicted(vehicle, segment, mass__ratio=ratio * segment.carried_mass, linear_drag__coefficient=0.0)
        for ratio in (1.0, 1.2)
    )
    np.testing.assert_allclose(heavy[0], light[0], atol=1e-9)
    dragged = [
        predicted(vehicle, segment, mass__ratio=ratio * segment.carried_mass)[0] - light[0] for ratio in (1.0, 1.2)
    ]
    np.testing.assert_allclose(1.2 * dragged[1], dragged[0], atol=1e-9)
    np.testing.assert_allclose(np.ptp(heavy[1], axis=0), 1.2 * np.ptp(light[1], axis=0), rtol=0.02)


def test_they_are_in_the_likelihoods_model_and_never_reach_a_vehicle_file(
    commanded: Segment, arpl_250g: Vehicle
) -> None:
    catalogue = {name: CATALOGUE[name] for name in ("linear_drag", "mass", "gyro_bias", "imu_bias", "time_delay")}
    dataset = Dataset((commanded,), (0,), (), {}, ())
    (problem,) = problems_of(dataset, arpl_250g, catalogue)
    own = (problem.what.all[problem.what.columns[place].candidate] for place in problem.what.of_commands)
    assert {candidate.effect.name for candidate in own} == set(COMMAND_EFFECTS)
    assert without_command_effects(problem.vehicle) == arpl_250g
    again, _ = with_command_effects(problem.vehicle, problem.catalogue, [commanded])
    assert again is problem.vehicle


def test_measured_speeds_need_none_of_it(commanded: Segment, arpl_250g: Vehicle) -> None:
    measured = replace(commanded, rotor_source="measured")
    assert with_command_effects(arpl_250g, CATALOGUE, [measured]) == (arpl_250g, CATALOGUE)
