"""How much faster than real time the mock's vehicle flies: plant, inner loop and sensors on one core.

A setpoint a control period of 10 ms, as a controller at 100 Hz sends it, and the estimate, an inertial sample and the
rotor speeds read back after each; also in the 4 ms passes in which the mock flight controller advances it.

    python -m benchmarks.mock_speed [--seconds S]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

import numpy as np

from benchmarks.provenance import write_result
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from sitl_mock.vehicle.vehicle import SimulatedVehicle
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from vehicles import FOLDER

PERIOD = 0.010  # s
EVERY_EFFECT = [
    EffectUse("rotor_drag"),
    EffectUse("parasitic_drag"),
    EffectUse("blade_flapping"),
    EffectUse("wind"),
    EffectUse("gust"),
    EffectUse("ground_effect"),
    EffectUse("axial_inflow"),
    EffectUse("translational_lift"),
    EffectUse("centre_of_mass"),
    EffectUse("battery_sag"),
]


def hovering(vehicle: Vehicle, effects: list[EffectUse]) -> SimulatedVehicle:
    mock = SimulatedVehicle(vehicle, effects=effects)
    mock.advance(ControlSetpoint("hold", position_world=np.array([0.0, 0.0, 20.0])), True, 15.0)
    return mock


def by_rates(mock: SimulatedVehicle, number: int) -> None:
    rate = np.array([0.1 * np.sin(number / 20), 0.1 * np.cos(number / 20), 0.0])
    mock.advance(ControlSetpoint("rates", rate_body=rate, thrust=mock.tuning.hover_thrust), True, PERIOD)
    read(mock)


def in_passes(mock: SimulatedVehicle, number: int) -> None:
    setpoint = ControlSetpoint("rates", rate_body=np.zeros(3), thrust=mock.tuning.hover_thrust)
    for duration in (0.004, 0.004, 0.002):
        mock.advance(setpoint, True, duration)
    read(mock)


def by_position(mock: SimulatedVehicle, number: int) -> None:
    mock.advance(ControlSetpoint("hold"), True, PERIOD)
    read(mock)


def read(mock: SimulatedVehicle) -> None:
    _ = mock.estimate, mock.imu, mock.rotor_speed


def measure(mock: SimulatedVehicle, fly: Callable[[SimulatedVehicle, int], None], periods: int) -> list[float]:
    """For one period: median and 99th percentile of the wall time, and mean processor time, s."""
    taken, used = [], time.thread_time()
    for number in range(periods):
        start = time.perf_counter()
        fly(mock, number)
        taken.append(time.perf_counter() - start)
    processor = (time.thread_time() - used) / periods
    return [float(np.median(taken)), float(np.percentile(taken, 99)), processor]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="simulated time for each row")
    periods = round(parser.parse_args().seconds / PERIOD)
    small, sih = (read_vehicle(FOLDER / f"{name}.toml") for name in ("arpl_250g", "px4_sih"))
    cases = [
        ("arpl_250g, body rates", small, [], by_rates),
        ("arpl_250g, body rates, 4 ms passes", small, [], in_passes),
        ("arpl_250g, ten hidden effects, body rates", small, EVERY_EFFECT, by_rates),
        ("px4_sih, body rates", sih, [], by_rates),
        ("arpl_250g, position hold", small, [], by_position),
    ]
    rows = [
        "| vehicle and setpoints | 10 ms take, median us | p99 us | processor time us | times real time |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, vehicle, effects, fly in cases:
        median, slowest, processor = measure(hovering(vehicle, effects), fly, periods)
        cells = [f"{1e6 * value:.1f}" for value in (median, slowest, processor)]
        rows.append(f"| {name} | {' | '.join(cells)} | {PERIOD / median:.0f} |")
    text = f"{periods} periods of 10 ms in each row, ten steps of 1 ms (RK4) each; one core, from Python. "
    text += f"The machine was shared: load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores.\n\n"
    write_result("mock_speed", "Speed of the mock's vehicle", text + "\n".join(rows))


if __name__ == "__main__":
    main()
