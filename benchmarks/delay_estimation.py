"""Planted delays of 0 to 80 ms between the streams of simulated flights with noise, and the errors of their estimates.

Each flight is flown by the runtime's logic on the mock's vehicle with the hidden effects and sensors of a campaign;
then every stream gets stamps of its own: planted delay, jitter of 0.5 ms, motors at half the rate. The interval was
calibrated on other seeds than the table's.

    python -m benchmarks.delay_estimation [--flights N] [--first-seed S] [--jobs J]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.provenance import write_result
from dynamics.references import named_reference
from dynamics.references.campaign import REAL_WORLD
from dynamics.vehicle_file import parse_effect, read_vehicle
from flights.delays import estimate_delays
from flights.log import Log, Stream
from flights.parallel import parallel_map
from simulation.lockstep import fly_reference
from sitl_mock.vehicle.sensors import SensorErrors
from sitl_mock.vehicle.vehicle import VehicleOptions
from vehicles import FOLDER

REFERENCES = (
    "Ellipse_2",
    "WarpedEllipse_1",
    "WarpedEllipse_2:speed=0.9",
    "Lemniscate:speed=0.8",
    "ExtendedLemniscate",
    "Parabola",
    "circle:plane=yz",
    "line:plane=yx",
)
DURATION = 24.0  # s
JITTER = 0.0005  # s
MAX_DELAY = 0.08  # s
IMU_MIDDLE = 0.0005  # s: the four milliseconds of an inertial sample lie so much after its stamp
NOISES = (1.0, 3.0)


@dataclass(frozen=True)
class Case:
    reference: str
    noise: float
    seed: int


@dataclass(frozen=True)
class Answer:
    stream: str
    noise: float
    planted: float
    estimate: float | None
    half_width: float
    covered: bool


def noisy(factor: float) -> SensorErrors:
    usual = SensorErrors()
    names = ("gyro", "accelerometer", "position", "velocity", "tilt", "yaw", "rotor_speed")
    return replace(usual, **{name: factor * getattr(usual, name) for name in names})


def stamped(log: Log, planted: dict[str, float], random: np.random.Generator) -> Log:
    """The log with each stream on its own clock."""
    streams = []
    for stream in log.streams:
        late = planted.get(stream.name, IMU_MIDDLE if stream.source == "imu" else 0.0)
        time = stream.time + late + JITTER * random.standard_normal(len(stream.time)).clip(-3, 3)
        every = 2 if stream.source == "motors" else 1
        streams.append(Stream(stream.name, time[::every], stream.values[::every], stream.source))
    return replace(log, streams=tuple(streams))


def judge(case: Case) -> list[Answer]:
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    effects = [parse_effect(text, vehicle.rotors.count) for text in REAL_WORLD]
    reference = named_reference(case.reference, vehicle, duration=DURATION)
    options = VehicleOptions(sensors=noisy(case.noise), position=tuple(reference.states(np.zeros(1))[0, :2]))
    flown = fly_reference(vehicle, reference, effects=effects, options=options, seed=case.seed)
    random = np.random.default_rng(case.seed)
    planted = {name: random.uniform(0, MAX_DELAY) for name in ("attitude", "velocity", "position", "rotor_speed")}
    estimates = {delay.stream: delay for delay in estimate_delays(stamped(flown.log, planted, random))}
    planted["position"] -= planted["velocity"]  # against which it is measured
    answers = []
    for name, true in planted.items():
        delay = estimates.get(name)
        if delay is None:
            answers.append(Answer(name, case.noise, true, None, float("nan"), False))
        else:
            covered = delay.low <= true <= delay.high
            answers.append(Answer(name, case.noise, true, delay.seconds, (delay.high - delay.low) / 2, covered))
    return answers


def rows(answers: list[Answer]) -> list[str]:
    heads = (
        "stream",
        "sensor noise",
        "flights",
        "median error ms",
        "90th percentile ms",
        "half interval, median ms",
        "inside the 95 % interval",
    )
    lines = [f"| {' | '.join(heads)} |", "|" + " --- |" * len(heads)]
    for noise in NOISES:
        for name in ("attitude", "velocity", "position", "rotor_speed"):
            some = [answer for answer in answers if answer.stream == name and answer.noise == noise]
            answered = [answer for answer in some if answer.estimate is not None]
            errors = 1e3 * np.abs([answer.estimate - answer.planted for answer in answered])  # type: ignore[operator]
            width = 1e3 * np.median([answer.half_width for answer in answered])
            inside = np.mean([answer.covered for answer in answered])
            lines.append(
                f"| {name} | {noise:g} x | {len(answered)} of {len(some)} | {np.median(errors):.2f} | "
                f"{np.percentile(errors, 90):.2f} | {width:.2f} | {inside:.0%} |"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=40, help="flights of each noise level")
    parser.add_argument("--first-seed", type=int, default=50_000, help="10000 and up are for calibration")
    parser.add_argument("--jobs", type=int, default=None)
    options = parser.parse_args()
    cases = [
        Case(REFERENCES[number % len(REFERENCES)], noise, options.first_seed + 1000 * index + number)
        for index, noise in enumerate(NOISES)
        for number in range(options.flights)
    ]
    answers = [answer for _, estimates in parallel_map(judge, cases, jobs=options.jobs) for answer in estimates]
    text = (
        f"{len(cases)} flights of {DURATION:.0f} s with the hidden effects of a campaign, seeds from "
        f"{options.first_seed}; planted delays uniform in 0 to 80 ms, position against velocity, the others "
        "against the IMU. The interval's "
        "width was calibrated on seeds 10000 to 11023, which are not in this table.\n\n"
    )
    write_result("delay_estimation", "Delays between streams", text + "\n".join(rows(answers)))


if __name__ == "__main__":
    main()
