"""The plant flies the flight model: every effect changes the truth by its own formula."""

from collections.abc import Iterator

import casadi as ca
import numpy as np
import pytest

from dynamics import quaternion
from dynamics.effects import CATALOGUE
from dynamics.model import build_model
from dynamics.state import ATTITUDE, RATE, VELOCITY
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle
from sitl_mock.vehicle.plant import DT, plant_effects
from sitl_mock.vehicle.vehicle import SimulatedVehicle
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from tests.support.flights import QUIET

# one compilation serves a group: of its effects all but one are neutral at a time
GROUPS = (
    {
        "rotor_drag": {"coefficient": 4e-5},
        "parasitic_drag": {"coefficient": 0.02},
        "blade_flapping": {"coefficient": -1e-6},
        "ground_effect": {"gain": 2.0, "radius": 0.2},
        "axial_inflow": {"coefficient": 3e-5},
        "translational_lift": {"coefficient": 0.01},
        "mass": {"ratio": 1.2},
    },
    {
        "wind": {"x": 4.0, "y": -2.0, "z": 0.0, "coefficient": 3e-5},
        "gust": {"intensity": 3.0, "correlation_time": 0.5, "coefficient": 3e-5},
        "centre_of_mass": {"x": 0.01, "y": 0.004, "z": 0.0},
        "thrust_constant": {"ratio": 0.85},
        "weak_rotor": {"loss": 0.15},
        "battery_sag": {"gain": 1.0},
    },
)
CASES = [(group, name) for group in GROUPS for name in group]


def uses(group: dict[str, dict[str, float]], active: str | None) -> list[EffectUse]:
    """All effects of a group, those not active at the values at which they vanish."""
    uses = []
    for name, values in group.items():
        effect = CATALOGUE[name]
        neutral = {p.name: 0.0 if p.name in ("x", "y", "z") else p.neutral for p in effect.parameters}
        rotor = 1 if effect.per_rotor else None
        uses.append(EffectUse(name, values if name == active else neutral, rotor))
    return uses


def fly(mock: SimulatedVehicle) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Whole states before and after single steps of a lively flight, every 50 ms from lift-off on."""
    for k in range(60):
        rate = np.array([0.5 * np.sin(k / 3), 0.4 * np.cos(k / 4), 0.3])
        setpoint = ControlSetpoint("rates", rate_body=rate, thrust=0.62)
        mock.advance(setpoint, True, 0.049)
        before, airborne = mock.plant_state, mock.ground_force == 0
        mock.advance(setpoint, True, 0.001)
        if airborne and mock.ground_force == 0:
            yield before, mock.plant_state


@pytest.mark.parametrize(("group", "name"), CASES, ids=[name for _, name in CASES])
def test_an_effect_changes_the_truth_by_its_formula(
    arpl_250g: Vehicle, group: dict[str, dict[str, float]], name: str
) -> None:
    mock = SimulatedVehicle(arpl_250g, effects=uses(group, name), options=QUIET)
    models = [build_model(arpl_250g, effects=plant_effects(arpl_250g, uses(group, active))) for active in (name, None)]
    differences = []
    for before, after in fly(mock):
        environment = [0.0, mock.battery.voltage / (3 * 4.2)]
        measured = np.concatenate([(after[VELOCITY] - before[VELOCITY]) / DT, (after[RATE] - before[RATE]) / DT])
        modelled = [np.mean([acceleration(model, x, environment) for x in (before, after)], axis=0) for model in models]
        np.testing.assert_allclose(measured, modelled[0], atol=0.02)
        differences.append(np.abs(measured - modelled[1]).max())
    assert max(differences) > 0.2  # what the nominal model would miss


def acceleration(model: object, x: np.ndarray, environment: list[float]) -> np.ndarray:
    """Linear, world, m/s^2, and angular, body, rad/s^2, acceleration that the model observes in a state."""
    force, angular, _ = model.observe(x, ca.DM.zeros(4), model.parameter_values, environment)  # type: ignore[attr-defined]
    linear = quaternion.rotate(x[ATTITUDE], np.array(force).ravel()) - [0, 0, GRAVITY]
    return np.concatenate([linear, np.array(angular).ravel()])


def test_the_accelerometer_measures_the_force_that_moves_the_vehicle(arpl_250g: Vehicle) -> None:
    mock = SimulatedVehicle(arpl_250g, effects=uses(GROUPS[0], "rotor_drag"), options=QUIET)
    mock.advance(ControlSetpoint("rates", rate_body=np.array([0.2, 0.3, 0.0]), thrust=0.7), True, 1.0)
    before = mock.truth
    mock.advance(ControlSetpoint("rates", rate_body=np.array([0.2, 0.3, 0.0]), thrust=0.7), True, 0.004)
    after, imu = mock.truth, mock.imu
    acceleration = (after.velocity_world - before.velocity_world) / 0.004 + [0, 0, GRAVITY]
    np.testing.assert_allclose(
        imu.specific_force_body, quaternion.rotate_inverse(after.attitude, acceleration), atol=0.05
    )


def test_a_hidden_effect_takes_the_place_of_the_files_own(arpl_250g: Vehicle) -> None:
    vehicle = arpl_250g.with_effects(EffectUse("rotor_drag", {"coefficient": 1e-5}))
    uses = plant_effects(vehicle, [EffectUse("rotor_drag", {"coefficient": 3e-5})])
    assert [use.parameters for use in uses if use.name == "rotor_drag"] == [{"coefficient": 3e-5}]


def test_there_is_always_a_motor_lag(arpl_250g: Vehicle) -> None:
    slow = EffectUse("motor_lag", {"time_constant": 0.04})
    for hidden, expected in (([], 0.02), ([slow], 0.04)):
        assert [use.parameters["time_constant"] for use in plant_effects(arpl_250g, hidden)] == [expected]


def test_rotors_follow_their_command_with_the_motor_lag(arpl_250g: Vehicle) -> None:
    lag = EffectUse("motor_lag", {"time_constant": 0.1})
    mock = SimulatedVehicle(arpl_250g, effects=[lag], options=QUIET)
    setpoint = ControlSetpoint("rates", thrust=0.3)
    mock.advance(setpoint, True, 0.106)  # 6 ms until the motors receive it
    settled = 1741.3 * np.sqrt(0.3)
    np.testing.assert_allclose(mock.true_rotor_speed, settled * (1 - np.exp(-1)), rtol=0.02)


def test_a_gust_has_its_intensity(arpl_250g: Vehicle) -> None:
    mock = SimulatedVehicle(arpl_250g, effects=uses(GROUPS[1], "gust"), options=QUIET, seed=4)
    gust = next(item for item in mock.plant.model.effects if item.effect.name == "gust")
    winds = []
    for _ in range(2000):
        mock.advance(ControlSetpoint("idle"), False, 0.05)
        winds.append([mock.plant_state[gust.hidden[f"wind_{axis}"]][0] for axis in "xyz"])
    np.testing.assert_allclose(np.std(winds, axis=0), [3.0, 3.0, 1.5], rtol=0.2)
