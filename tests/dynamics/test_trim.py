"""A vehicle's trim: its weight and the share of each rotor, with the effects of its file."""

import numpy as np
import pytest

from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.trim import find_trim
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import find_vehicle, read_vehicle

HOVER = np.array([0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])


@pytest.fixture
def vehicle() -> Vehicle:
    return read_vehicle(find_vehicle("arpl_250g"))


def test_a_vehicle_without_effects_is_its_own_trim(vehicle: Vehicle) -> None:
    trim = find_trim(build_model(vehicle))
    assert trim.vehicle == vehicle
    assert trim.rotor_speed == pytest.approx(vehicle.hover_speed)


@pytest.mark.parametrize("name", [name for name, effect in CATALOGUE.items() if name != "wind"])
def test_the_trimmed_rotors_hold_the_vehicle_up_without_turning_it(vehicle: Vehicle, name: str) -> None:
    effect = CATALOGUE[name]
    use = EffectUse(name, effect.defaults(vehicle), 1 if effect.per_rotor else None)
    model = build_model(vehicle.with_effects(use))
    trim = find_trim(model)
    state = model.initial_state(HOVER)
    for item in model.effects:
        if "rotor_speed" in item.hidden:
            state[item.hidden["rotor_speed"]] = trim.rotor_speed
    force, angular, _ = model.observe(state, trim.rotor_speed, model.parameter_values, ENVIRONMENT_DEFAULT)
    assert float(force[2]) == pytest.approx(9.81, rel=1e-6)
    assert np.array(angular).ravel() == pytest.approx(np.zeros(3), abs=1e-4)


def test_mass_and_load_weigh_in_full_and_thrust_counts_by_its_constant(vehicle: Vehicle) -> None:
    def trimmed(name: str, **values: float) -> Vehicle:
        return find_trim(build_model(vehicle.with_effects(EffectUse(name, values)))).vehicle

    assert trimmed("mass", ratio=1.2).body.mass == pytest.approx(0.3)
    assert trimmed("slung_load", mass=0.05, length=0.5).body.mass == pytest.approx(0.3)
    weak = trimmed("thrust_constant", ratio=0.8)
    assert weak.rotors.thrust_constant == pytest.approx(0.8 * vehicle.rotors.thrust_constant)
    assert weak.body.mass == vehicle.body.mass
    assert not weak.effects


def test_a_centre_of_mass_to_the_front_loads_the_front_rotors(vehicle: Vehicle) -> None:
    use = EffectUse("centre_of_mass", {"x": 0.01, "y": 0.0, "z": 0.0})
    shares = find_trim(build_model(vehicle.with_effects(use))).shares
    assert shares[[0, 3]] == pytest.approx(np.sqrt(1 + 0.01 / 0.076), rel=1e-6)
    assert shares[[1, 2]] == pytest.approx(np.sqrt(1 - 0.01 / 0.076), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "values"),
    [("centre_of_mass", {"x": 0.12, "y": 0.0, "z": 0.0}), ("mass", {"ratio": 4.0})],
)
def test_a_vehicle_that_cannot_hover_with_its_effects_is_refused(
    vehicle: Vehicle, name: str, values: dict[str, float]
) -> None:
    """A centre of mass outside of the rotors; a weight beyond their thrust."""
    heavy = vehicle.with_effects(EffectUse(name, values))
    with pytest.raises(RequestError, match=rf"cannot hover.*{name}"):
        find_trim(build_model(heavy))


def test_a_lost_rotor_of_four_leaves_no_hover(vehicle: Vehicle) -> None:
    lost = vehicle.with_effects(EffectUse("weak_rotor", {"loss": 1.0, "torque_loss": 1.0}, 0))
    with pytest.raises(RequestError, match=r"cannot hover.*weak_rotor"):
        find_trim(build_model(lost))
