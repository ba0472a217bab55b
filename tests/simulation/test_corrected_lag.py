"""A model whose motor lag was corrected rightly flies at least as well, whatever the autopilot was tuned for."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.rate_loop import autopilot_gains
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller, ControllerOptions
from simulation.lockstep import FlownReference, fly_reference
from sitl_mock.vehicle.estimator import PX4_SENSORS
from sitl_mock.vehicle.tuning import default_tuning
from sitl_mock.vehicle.vehicle import VehicleOptions
from vehicles import FOLDER

CORRECTED = Path(__file__).parents[1] / "data" / "px4_sih_lag_corrected" / "vehicle.toml"
SLOW = (EffectUse("motor_lag", {"time_constant": 0.09}),)  # SIH_T_TAU of the flights that fell
SECONDS = 8.0


@pytest.fixture(scope="module")
def px4_sih() -> Vehicle:
    return read_vehicle(FOLDER / "px4_sih.toml")


def fly(
    plant: Vehicle, model: Vehicle, seed: int, *, retuned: bool = False, options: ControllerOptions | None = None
) -> FlownReference:
    """The Lemniscate on slow motors, with PX4's sensors. retuned: whether the autopilot was tuned for them."""
    return fly_reference(
        plant,
        named_reference("Lemniscate:height=4", plant, duration=SECONDS),
        effects=SLOW,
        controller=Controller.build(model, options),
        tuning=default_tuning(plant, SLOW if retuned else ()),
        options=VehicleOptions(sensors=PX4_SENSORS),
        seed=seed,
    )


def fastest(flown: FlownReference) -> float:
    """Largest rate of roll and pitch, rad/s."""
    rate = flown.truth.stream("rate")
    return np.inf if rate is None else float(np.abs(rate.values[:, :2]).max())


def tracking(flown: FlownReference) -> float:
    """RMS distance of the estimate, by which the controller flies, from the reference, m."""
    position, setpoint = flown.log.stream("position"), flown.log.stream("position_setpoint")
    assert position is not None
    assert setpoint is not None
    away = [np.interp(position.time, setpoint.time, setpoint.values[:, axis]) for axis in range(3)]
    return float(np.sqrt(np.mean(np.sum((position.values - np.stack(away, axis=1)) ** 2, axis=1))))


@pytest.mark.parametrize("retuned", [False, True], ids=["PX4's gains", "tuned for the slow motors"])
def test_the_corrected_file_flies_no_worse_than_the_uncorrected_one(px4_sih: Vehicle, *, retuned: bool) -> None:
    """With PX4's own gains this is the vehicle that was lost: pitch oscillated at 2 Hz up to 6 rad/s."""
    before, after = (fly(px4_sih, model, 71, retuned=retuned) for model in (px4_sih, read_vehicle(CORRECTED)))
    assert not after.aborted
    assert fastest(after) <= 1.1 * fastest(before)
    assert tracking(after) <= 1.1 * tracking(before)


def test_the_gains_that_the_next_version_keeps_are_the_autopilots(px4_sih: Vehicle) -> None:
    corrected = msgspec.structs.replace(read_vehicle(CORRECTED), autopilot=autopilot_gains(px4_sih))
    flown = fly(px4_sih, corrected, 72)
    assert not flown.aborted
    assert fastest(flown) < 6.0
    assert tracking(flown) < 0.1


def test_an_older_recordings_setpoints_stay_what_they_were(px4_sih: Vehicle) -> None:
    """Without the key, options are those of recordings from before it."""
    options = ControllerOptions.for_vehicle(px4_sih)
    recorded = msgspec.json.decode(msgspec.json.encode(options))
    del recorded["setpoint"]
    assert msgspec.convert(recorded, ControllerOptions).setpoint == "predicted"
    assert options.setpoint == "commanded"
