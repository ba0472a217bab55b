"""Errors of the mock's estimate with `--estimator px4` beside those of PX4's own, recorded with ground truth.

Recorded: ULogs of flights in PX4's simulation (SITL, SIH quadrotor, EKF2 on GNSS and barometer, all at defaults) that
hold the estimate and the ground truth; every flight counts while it is in the air, and while it stands before take-off.
Mock: flights of as long, at a place, from seeds that were not used when the figures were chosen.

    python -m benchmarks.px4_estimate --recorded FOLDER_OF_ULOGS [--flights N] [--first-seed S]
"""

from __future__ import annotations

import argparse
import gzip
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyulog import ULog

from benchmarks.provenance import write_result
from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.vehicle_file import read_vehicle
from flights.parallel import parallel_map
from sitl_mock.vehicle.estimator import PX4_SENSORS, PX4_WANDER
from sitl_mock.vehicle.vehicle import SimulatedVehicle, VehicleOptions
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from vehicles import FOLDER

PERIOD = 0.02  # s, of the recorded ground truth
STANDING, FLYING, CLIMBING = 3.0, 45.0, 3.0  # s of a flight of the mock
AIRBORNE = 0.3  # m
LAGS = (0.3, 1.0, 3.0, 10.0)  # s
SLOPE = round(0.2 / PERIOD)  # samples
NOT_FLOWN = ("refused", "landed", "tipped", "crash")  # beginnings of the names of recordings without a normal flight
MEAN = "mean"  # in the name of a statistic of which flights give both signs
KINDS = {"position": "m", "velocity": "m/s", "rotation": "degrees"}


@dataclass(frozen=True)
class Errors:
    """Estimate less ground truth of one flight, north, east, down, every `PERIOD`.

    position, velocity, rotation: (samples, 3) m, m/s, degrees about the world's axes.
    height: (samples,) true, over the ground, m.
    """

    position: Floats
    velocity: Floats
    rotation: Floats
    height: Floats

    def flying(self, name: str) -> Floats:
        """(samples, 3) of one error from take-off to landing."""
        up = np.flatnonzero(self.height > AIRBORNE)
        return np.asarray(getattr(self, name)[up[0] : up[-1] + 1])

    def standing(self, name: str) -> Floats:
        """(samples, 3) of one error before take-off."""
        return np.asarray(getattr(self, name)[: np.argmax(self.height > 0.05)])


def rotation_error(estimate: Floats, truth: Floats) -> Floats:
    """(samples, 3) rotation about the world's axes from the true to the estimated attitude, degrees."""
    turned = quaternion.multiply(estimate, quaternion.conjugate(truth))
    return np.asarray(np.degrees(2 * turned[:, 1:] * np.sign(turned[:, :1])))


def recorded_errors(file: Path) -> Errors:
    """Errors of a recorded flight. file: ULog, packed by gzip."""
    with tempfile.NamedTemporaryFile(suffix=".ulg") as unpacked:
        unpacked.write(gzip.decompress(file.read_bytes()))
        unpacked.flush()
        log = ULog(unpacked.name)
    topics = {data.name: data.data for data in log.data_list}

    def columns(topic: str, names: list[str], time: Floats) -> Floats:
        stamps = topics[topic]["timestamp_sample"] * 1e-6
        return np.stack([np.interp(time, stamps, topics[topic][name]) for name in names], axis=1)

    def attitude(topic: str, time: Floats) -> Floats:
        table = topics[topic]
        values = quaternion.continuous(np.stack([table[f"q[{i}]"] for i in range(4)], axis=1))
        stamps = table["timestamp_sample"] * 1e-6
        between = np.stack([np.interp(time, stamps, values[:, i]) for i in range(4)], axis=1)
        return np.asarray(between / np.linalg.norm(between, axis=1, keepdims=True))

    estimate, truth = "vehicle_local_position", "vehicle_local_position_groundtruth"
    time = topics[truth]["timestamp_sample"] * 1e-6
    time = time[(time > time[0] + 0.1) & (time < topics[estimate]["timestamp_sample"][-1] * 1e-6)]
    place, speed = ["x", "y", "z"], ["vx", "vy", "vz"]
    height = -columns(truth, ["z"], time)[:, 0]
    return Errors(
        columns(estimate, place, time) - columns(truth, place, time),
        columns(estimate, speed, time) - columns(truth, speed, time),
        rotation_error(attitude("vehicle_attitude", time), attitude("vehicle_attitude_groundtruth", time)),
        height - height[0],
    )


def mock_errors(seed: int) -> Errors:
    """Errors of a flight of the mock."""
    options = VehicleOptions(sensors=PX4_SENSORS, wander=PX4_WANDER)
    vehicle = SimulatedVehicle(read_vehicle(FOLDER / "px4_sih.toml"), options=options, seed=seed)
    idle, hover = ControlSetpoint("idle"), ControlSetpoint("hold", position_world=np.array([0.0, 0.0, 3.0]))
    estimates: list[Floats] = []
    truths: list[Floats] = []
    for i in range(round((STANDING + CLIMBING + FLYING) / PERIOD)):
        flies = i * PERIOD >= STANDING
        vehicle.advance(hover if flies else idle, flies, PERIOD)
        for rows, state in ((estimates, vehicle.estimate_now), (truths, vehicle.truth)):
            rows.append(np.concatenate([state.position_world, state.velocity_world, state.attitude]))
    estimate, truth = np.array(estimates), np.array(truths)
    difference = estimate - truth
    turned = rotation_error(estimate[:, 6:10], truth[:, 6:10])
    ned = frames.enu_from_ned  # its own inverse
    return Errors(ned(difference[:, 0:3]), ned(difference[:, 3:6]), ned(turned), truth[:, 2] - truth[0, 2])


def correlation(error: Floats, lag: float) -> Floats:
    """(3,) of an error with itself a lag (s) later, about its mean over the flight. error: (samples, 3)."""
    centred, n = error - error.mean(axis=0), round(lag / PERIOD)
    return np.asarray((centred[:-n] * centred[n:]).mean(axis=0) / (centred**2).mean(axis=0))


def correlation_time(error: Floats) -> Floats:
    """(3,) until the correlation has fallen to 1/e, s."""
    lags = np.arange(1, round(10.0 / PERIOD), 5) * PERIOD
    low = np.array([correlation(error, lag) for lag in lags]) < np.exp(-1.0)
    return np.asarray(np.where(low.any(axis=0), lags[low.argmax(axis=0)], lags[-1]))


def slope(error: Floats) -> Floats:
    """(samples, 3) change per second over 0.2 s."""
    return np.asarray((error[SLOPE:] - error[:-SLOPE]) / (SLOPE * PERIOD))


def inconsistency(flight: Errors) -> Floats:
    """(3,) RMS of the position's slope less the velocity, errors alone, m/s."""
    velocity = flight.flying("velocity")[SLOPE // 2 : -SLOPE // 2]
    return root_mean_square(slope(flight.flying("position")) - velocity)


def root_mean_square(values: Floats) -> Floats:
    """(3,) over the rows."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def statistics(flight: Errors) -> dict[str, Floats]:
    """Of one flight, by their names: (3,) north, east, down."""
    values: dict[str, Floats] = {}
    for kind, unit in KINDS.items():
        error = flight.flying(kind)
        values[f"{kind}: std in flight, {unit}"] = error.std(axis=0)
        values[f"{kind}: correlation time, s"] = correlation_time(error)
        values |= {f"{kind}: correlation after {lag:g} s": correlation(error, lag) for lag in LAGS}
        values[f"{kind}: {MEAN} of a flight, {unit}"] = error.mean(axis=0)
    values["velocity: slope over 0.2 s, RMS, m/s^2"] = root_mean_square(slope(flight.flying("velocity")))
    values["position's slope less velocity, RMS, m/s"] = inconsistency(flight)
    values["velocity: std before take-off, m/s"] = flight.standing("velocity").std(axis=0)
    values[f"position: {MEAN} before take-off, m"] = flight.standing("position").mean(axis=0)
    return values


def over_flights(flights: Sequence[Errors]) -> dict[str, Floats]:
    """(3,) of each statistic: the median over flights, of means the root mean square."""
    each = [statistics(flight) for flight in flights]
    return {
        name: root_mean_square(np.array([one[name] for one in each]))
        if MEAN in name
        else np.median([one[name] for one in each], axis=0)
        for name in each[0]
    }


def table(recorded: Sequence[Errors], flown: Sequence[Errors]) -> str:
    """Both in Markdown."""
    lines = [
        f"| north, east, down | PX4, {len(recorded)} flights | mock, {len(flown)} flights |",
        "| --- | --- | --- |",
    ]
    measured, simulated = over_flights(recorded), over_flights(flown)
    for name, values in measured.items():
        both = [" ".join(f"{value:.2f}" for value in part) for part in (values, simulated[name])]
        lines.append(f"| {name} | {both[0]} | {both[1]} |")
    return "\n".join(lines)


def main() -> None:
    """Compare and write the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--recorded", type=Path, required=True, help="folder of *.ulg.gz with ground truth")
    options.add_argument("--flights", type=int, default=20)
    options.add_argument("--first-seed", type=int, default=5000)
    options.add_argument("--jobs", type=int, default=1)
    chosen = options.parse_args()
    files = [file for file in sorted(chosen.recorded.glob("*.ulg.gz")) if not file.name.startswith(NOT_FLOWN)]
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.flights)
    flown = [errors for _, errors in parallel_map(mock_errors, list(seeds), jobs=chosen.jobs)]
    note = (
        "Medians over flights; of means the root mean square over flights. "
        f"Seeds of the mock: {seeds[0]} to {seeds[-1]}; its figures were chosen on others."
    )
    body = f"{note}\n\n{table([recorded_errors(file) for file in files], flown)}"
    write_result("px4_estimate", "The mock's estimate beside PX4's", body)


if __name__ == "__main__":
    main()
