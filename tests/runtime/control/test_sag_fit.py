"""How thrust goes with the battery's voltage is named where it has fallen, and not before."""

import numpy as np
import pytest

from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.followed_parameters import FollowedParameter
from runtime.control.sag_fit import SagFit
from simulation.lockstep import fly_reference
from sitl_mock.vehicle.battery import usual_battery
from sitl_mock.vehicle.vehicle import VehicleOptions

GAIN = FollowedParameter("battery_sag.gain", 0, 0.0, 1.5, 0.0, 2.0, "voltage")
NAME = GAIN.name


def followed(gain: float, drop: float, seed: int, seconds: float = 120.0) -> tuple[float, float]:
    """From voltages that fall by a share, under loads that vary, and an effectiveness that its filter delays."""
    random, fit, thrust = np.random.default_rng(seed), SagFit([GAIN]), 0.92
    error = 0.0
    for step in range(round(seconds / 0.1)):
        load = 0.01 * np.sin(0.2 * step)
        voltage = 12.4 * (1 - drop * step * 0.1 / seconds - load)
        thrust += 0.1 / 1.3 * (0.92 * (voltage / 12.4) ** (2 * gain) - thrust)
        error += -0.1 / 1.3 * error + 0.004 * np.sqrt(0.2 / 1.3) * random.normal()
        fit.add(0.1 * step, voltage, thrust + error)
    return fit.named[NAME]


@pytest.mark.parametrize("gain", [0.0, 0.5, 1.0])
def test_its_interval_holds(gain: float) -> None:
    named = [followed(gain, 0.1, seed) for seed in range(12)]
    assert sum(abs(value - gain) < 1.96 * deviation for value, deviation in named) >= 10
    assert max(deviation for _, deviation in named) < 0.2


def test_a_battery_that_stays_full_names_nothing() -> None:
    fit = SagFit([GAIN])
    for step in range(600):
        fit.add(0.1 * step, 12.4, 0.9 + 0.01 * np.sin(0.1 * step))
    value, deviation = fit.named[NAME]
    assert deviation > 0.9 * GAIN.std
    assert abs(value) < 0.5


def test_values_that_are_none_move_nothing() -> None:
    fit = SagFit([GAIN])
    for step in range(600):
        fit.add(0.1 * step, np.nan if step % 2 else 0.0, 0.9)
    assert fit.named == {NAME: (GAIN.value, GAIN.std)}


@pytest.mark.parametrize("gain", [0.0, 1.0])
def test_it_is_named_in_flight(arpl_250g: Vehicle, gain: float) -> None:
    settings = AdaptationSettings(mode="on", follow=("battery_sag",))
    controller = Controller.build(arpl_250g, ControllerOptions.for_vehicle(arpl_250g, adaptation=settings))
    small = usual_battery(arpl_250g, endurance=90.0)
    sag = EffectUse("battery_sag", {"gain": gain, "reference": 1.0})
    fly_reference(
        arpl_250g,
        named_reference("circle", arpl_250g, duration=40.0),
        effects=[sag],
        options=VehicleOptions(battery=small, yaw=0.0),
        seed=4,
        controller=controller,
    )
    assert controller.adaptation is not None
    value = controller.adaptation.followed.parameters[NAME]
    assert abs(value.value - gain) < 2.5 * value.std
    assert value.std < 0.3
    assert controller.adaptation.followed.parameters["battery_sag.reference"].value == 1.0  # which no flight shows
