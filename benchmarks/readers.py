"""Logs: what is read of them and how fast, delays between their streams, orders of their rotors."""

from __future__ import annotations

import argparse
import itertools
import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from benchmarks.measurement import ROOT, Page, options_of, own_command
from diagnosis.data.rotor_moments import compared_moments, require_rotor_moments
from diagnosis.data.segment import Segment, segments
from dynamics.errors import AlulaError, DataError
from dynamics.references import named_reference
from dynamics.references.campaign import REAL_WORLD
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect, read_vehicle
from fixtures.planted import planted_flights
from fixtures.ulog_file import Topic, ulog_file
from flights import Flight, read_chunks, read_folder
from flights.delays import estimate_delays
from flights.log import Log, Stream
from flights.parallel import parallel_map
from simulation.lockstep import fly_reference
from sitl_mock.vehicle.sensors import SensorErrors
from sitl_mock.vehicle.vehicle import VehicleOptions
from vehicles import FOLDER

DATA = ROOT / "tests" / "data"
MINUTES, RATE, REPEATS = 10, 250, 5
HOURS, CHUNK = 3, 1200.0  # of the log that is read in chunks, and s of a chunk
QUANTITIES = ("position", "velocity", "attitude", "rate", "specific_force", "rotor_speed")
INSTEAD = {"rotor_speed": ("rotor_speed_command", "rotor_command", "rotor_thrust_command", "collective_thrust_command")}


def long_ulog(path: Path) -> int:
    """A synthetic ULog of MINUTES at RATE, with topics that no reader uses. Returns its size, bytes."""
    count = MINUTES * 60 * RATE
    stamps = (1_000_000 + np.arange(count) * (1_000_000 // RATE)).astype("<u8")
    swing = np.sin(np.arange(count) / 40.0)

    def numbers(columns: int) -> np.ndarray:
        return np.repeat(swing[:, None], columns, axis=1).astype("<f4")

    attitude = np.stack([np.cos(0.1 * swing), np.sin(0.1 * swing), 0 * swing, 0 * swing], axis=1).astype("<f4")
    position = {name: swing.astype("<f4") for name in ("x", "y", "z", "vx", "vy", "vz")}
    force = np.stack([0 * swing, 0 * swing, -9.81 + 0 * swing], axis=1).astype("<f4")
    topics = [
        Topic("vehicle_local_position", {"timestamp": stamps, **position}),
        Topic("vehicle_attitude", {"timestamp": stamps, "q": attitude}),
        Topic("vehicle_angular_velocity", {"timestamp": stamps, "xyz": 0 * numbers(3)}),
        Topic("sensor_combined", {"timestamp": stamps, "gyro_rad": 0 * numbers(3), "accelerometer_m_s2": force}),
        Topic("actuator_motors", {"timestamp": stamps, "control": 0.5 + 0.1 * numbers(12)}),
        Topic("estimator_states", {"timestamp": stamps, "states": numbers(24)}),
    ]
    path.write_bytes(ulog_file(topics))
    return path.stat().st_size


def long_csv(path: Path) -> int:
    """A synthetic flight CSV of HOURS at RATE. Returns its size, bytes."""
    block = 60 * RATE
    names = ["position_x", "position_y", "position_z", "velocity_x", "velocity_y", "velocity_z"]
    names += [f"rate_{axis}" for axis in "xyz"] + [f"rotor_speed_{rotor}" for rotor in range(4)]
    swing = np.sin(np.arange(block) / 1000.0)
    columns = {name: pa.array(0.1 * swing if name[0] in "pv" else 0 * swing) for name in names}
    with path.open("wb") as stream:
        for minute in range(HOURS * 60):
            table = pa.table({"t": pa.array(60.0 * minute + np.arange(block) / RATE), **columns})
            pa_csv.write_csv(table, stream, pa_csv.WriteOptions(include_header=minute == 0, quoting_style="none"))
    return path.stat().st_size


def peak_memory() -> float:
    """Peak memory of this process, MB; not ru_maxrss, which begins with the parent's."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def measure_chunks(path: Path, seconds: float) -> None:
    """Read one log in chunks and print the seconds of data, the number of chunks and peak memory, MB."""
    lengths = [Flight.from_log(chunk).duration for chunk in read_chunks(path, seconds)]
    print(sum(lengths), len(lengths), peak_memory())


def reading_in_chunks() -> str:
    """Cost of a log that need not fit into memory."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.csv"
        size = long_csv(path)
        command = own_command("readers", "reading", "--chunks", str(path))
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    data, chunks, memory = (float(word) for word in done.stdout.split())
    return (
        f"A flight CSV of {HOURS} h, {size / 1e6:.0f} MB, read in {chunks:.0f} chunks of {CHUNK:.0f} s "
        f"({data / 3600:.2f} h in all): peak memory {memory:.0f} MB."
    )


def measure_once(path: Path) -> None:
    """Read one ULog and print seconds of the clock and of the processor, and peak memory, MB."""
    started, worked = time.perf_counter(), time.process_time()
    flight = Flight.read(path)
    elapsed, work = time.perf_counter() - started, time.process_time() - worked
    assert flight.has("position", "rate", "rotor_command")
    assert len(flight) > MINUTES * 60 * RATE - 10
    print(elapsed, work, peak_memory())


def reading_speed() -> str:
    """The claim's table."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.ulg"
        size = long_ulog(path)
        runs = []
        for _ in range(REPEATS):
            done = subprocess.run(
                own_command("readers", "reading", "--measure", str(path)),
                capture_output=True,
                text=True,
                check=True,
            )
            runs.append([float(word) for word in done.stdout.split()])
    elapsed, work = (statistics.median(run[index] for run in runs) for index in (0, 1))
    memory, load = max(run[2] for run in runs), os.getloadavg()[0]
    verdict = "met" if work <= 3.0 and memory <= 1024 else "MISSED"
    return (
        f"A {MINUTES}-minute ULog, {RATE} Hz, {size / 1e6:.0f} MB, five topics read and one passed over, in a process "
        f"of its own, {REPEATS} times, imports not counted in the seconds, load average {load:.1f}:\n\n"
        f"| | measured | goal |\n| --- | --- | --- |\n| processor seconds to a Flight, median | {work:.2f} | 3 |\n"
        f"| seconds by the clock on this machine and load, median | {elapsed:.2f} | |\n"
        f"| peak memory, largest, MB | {memory:.0f} | 1024 |\n\nGoal {verdict}."
    )


def row(name: str, log: Log | AlulaError) -> str:
    """One line of the table."""
    if isinstance(log, AlulaError):
        return f"| {name} | not read | | | {_short(str(log).rpartition(name)[2] or str(log))} |"
    flight = Flight.from_log(log)
    gives = ", ".join(f"{quantity} {origin.rate:.0f}" for quantity, origin in flight.origins.items())
    lacks = [name for name in QUANTITIES if not flight.has(name)]
    remarks = [f"no {lack}{_instead(flight, lack)}" for lack in lacks]
    remarks += [f"**{repair.name}** {_short(repair.detail)}" for repair in log.provenance.repairs]
    remarks += [_short(note) for note in log.provenance.notes]
    segments = flight.segments()
    flown = sum(segment.duration for segment in segments)
    duration = f"{flight.duration:.1f} ({flown:.1f} in {len(segments)})"
    return f"| {name} | {log.provenance.format} | {duration} | {gives} | {'; '.join(remarks)} |"


def _instead(flight: Flight, lack: str) -> str:
    have = [name for name in INSTEAD.get(lack, ()) if flight.has(name)]
    return f" (but {', '.join(have)})" if have else ""


def _short(text: str) -> str:
    line = text.replace("|", "/").replace("\n", " ")
    return line if len(line) < 180 else line[:177] + "..."


def reading(words: Sequence[str]) -> Page | None:
    """Reads every log of a folder and lists the quantities that each has and lacks; and how fast a long ULog is read.

        python -m benchmarks readers reading [FOLDER]

    FOLDER: any flight logs, by default the small ones that the tests use. The claim: a 10-minute ULog whose motion and
    motors are logged at 250 Hz becomes a Flight in at most 3 s and 1 GB.
    """
    parser = options_of(reading.__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=DATA, help="that holds the logs")
    parser.add_argument("--speed", action=argparse.BooleanOptionalAction, default=True, help="time a long ULog and CSV")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--chunks", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args(words)
    if chosen.measure:
        measure_once(chosen.measure)
        return None
    if chosen.chunks:
        measure_chunks(chosen.chunks, CHUNK)
        return None
    folder = chosen.folder
    started, size, rows = time.perf_counter(), 0, []
    for path, log in read_folder(folder):
        if path.suffix in (".txt", ".md", ".toml", ".py", ".npz") or path.name.startswith("LICENSE"):
            continue
        size += path.stat().st_size
        name = os.path.relpath(path, folder)
        rows.append(row(name, log))
    elapsed = time.perf_counter() - started
    head = (
        "| file | format | seconds (of them usable, in segments) | quantities, Hz as logged | what it lacks, "
        "**repairs** and notes |\n| --- | --- | --- | --- | --- |\n"
    )
    body = (
        (f"{reading_speed()}\n\n{reading_in_chunks()}\n\n" if chosen.speed else "")
        + f"{len(rows)} files, {size / 1e6:.1f} MB, read in {elapsed:.1f} s.\n\n{head}"
        + "\n".join(rows)
    )
    return Page("read_flights", "Reading flights", body)


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


def delays(words: Sequence[str]) -> Page:
    """Planted delays of 0 to 80 ms between the streams of simulated flights with noise, and the errors of their
    estimates.

    Each flight is flown by the runtime's logic on the mock's vehicle with the hidden effects and sensors of a campaign;
    then every stream gets stamps of its own: planted delay, jitter of 0.5 ms, motors at half the rate. The interval was
    calibrated on other seeds than the table's.

        python -m benchmarks readers delays [--flights N] [--first-seed S] [--jobs J]
    """
    parser = options_of(delays.__doc__)
    parser.add_argument("--flights", type=int, default=40, help="flights of each noise level")
    parser.add_argument("--first-seed", type=int, default=50_000, help="10000 and up are for calibration")
    parser.add_argument("--jobs", type=int, default=None)
    options = parser.parse_args(words)
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
    return Page("delay_estimation", "Delays between streams", text + "\n".join(rows(answers)))


HEADER = (
    "| set | flights | s | agreement, file's order | any combination | yaw | right order passes | "
    "wrong orders refused, named rightly, named wrongly | reversed spin refused | 0.2 s shift refused |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
)
CLOCK = 0.2  # s
GENTLE = ("circle:laps=1,ramp=2,speed=0.5", "line:laps=1,ramp=2,speed=0.5", "yaw_spin:laps=1,ramp=2")


def rotor_orders(words: Sequence[str]) -> Page:
    """All orders of the rotors on real and planted flights: which are refused. Writes results/rotor_orders.md.

        python -m benchmarks readers rotor_orders

    Every flight is judged alone, and each set as a whole, in all 24 orders, with the rotors' turning directions
    reversed, and with the rotors' clock shifted by 0.2 s.
    """
    parser = options_of(rotor_orders.__doc__)
    parser.add_argument("--sets", type=int, help="so many of the sets alone")
    lines = [HEADER]
    for name, flights, vehicle in islice(sets(), parser.parse_args(words).sets):
        parts = [tuple(segments(flight, vehicle)) for flight in flights]
        flown = [part for part in parts if part]
        together = [s for part in flown for s in part]
        groups: list[Sequence[Segment]] = [together, *(flown if len(flown) > 1 else ())]
        lines.append(rotor_orders_row(name, groups, vehicle))
    return Page("rotor_orders", "Orders of the rotors that pass the check of the data", "\n".join(lines))


def sets() -> Iterator[tuple[str, Sequence[Flight], Vehicle]]:
    """Name, flights and vehicle file of each set."""
    crazyflie, px4 = read_vehicle(FOLDER / "crazyflie.toml"), read_vehicle(FOLDER / "px4_sih.toml")
    lee = [DATA / "crazyflie" / "log20.gz", *sorted((DATA / "imrc_lee_crazyflie").glob("log*.gz"))]
    yield "Crazyflie, Lee controller, commanded thrust and torque", read(lee), heavier(crazyflie, 0.037, 3300.0)
    yield "Crazyflie, manual flight", read([DATA / "arpl_crazyflie" / "log10_cut.csv.gz"]), crazyflie
    yield "NanoBench", read(sorted((DATA / "nanobench").glob("*.gz"))), heavier(crazyflie, 0.0409, 2700.0)
    yield "PX4, SIH", read(sorted((DATA / "px4_sih_flights").glob("*.ulg.gz"))), px4
    small = read_vehicle(FOLDER / "arpl_250g.toml")
    yield "planted, nothing hidden", planted_flights(small, [], seed=101), small
    yield "planted, gentle", planted_flights(small, [], seed=103, manoeuvres=GENTLE), small


def read(logs: Sequence[Path]) -> list[Flight]:
    """The flights of logs."""
    return [Flight.read(log) for log in logs]


def heavier(vehicle: Vehicle, mass: float, speed_max: float) -> Vehicle:
    """The vehicle with another mass, kg, and speed at full signal, rad/s."""
    body = msgspec.structs.replace(vehicle.body, mass=mass)
    return msgspec.structs.replace(
        vehicle, body=body, rotors=msgspec.structs.replace(vehicle.rotors, speed_max=speed_max)
    )


def rotor_orders_row(name: str, groups: Sequence[Sequence[Segment]], vehicle: Vehicle) -> str:
    """A line of the table: the first group is all flights, the others one flight each."""
    permutations = list(itertools.permutations(range(vehicle.rotors.count)))
    moments = compared_moments(groups[0], vehicle)
    passed, refused, right, wrong, spins, clocks = 0, 0, 0, 0, 0, 0
    rotors = vehicle.rotors
    backwards = msgspec.structs.replace(
        vehicle, rotors=msgspec.structs.replace(rotors, spin=tuple(-s for s in rotors.spin))
    )
    for group in groups:
        for order in permutations:
            answer = refusal([replace(s, rotor_speed=s.rotor_speed[:, np.argsort(order)]) for s in group], vehicle)
            if order == permutations[0]:
                passed += answer == ""
                continue
            refused += answer != ""
            right += f"columns {list(order)}" in answer
            wrong += "columns [" in answer and f"columns {list(order)}" not in answer
        spins += refusal(group, backwards) != ""
        late = [replace(s, rotor_speed=np.roll(s.rotor_speed, round(CLOCK * s.rate), axis=0)) for s in group]
        clocks += refusal(late, vehicle) != ""
    count, others = len(groups), len(groups) * (len(permutations) - 1)
    own = range(rotors.count)
    return (
        f"| {name} | {max(1, count - 1)} | {sum(s.duration for s in groups[0]):.0f} | {moments.agreement(own):.2f} | "
        f"{moments.explained:.2f} | {moments.correlations(own)[2]:.2f} | {passed} of {count} | {refused} of {others}, "
        f"{right}, {wrong} | {spins} of {count} | {clocks} of {count} |"
    )


def refusal(parts: Sequence[Segment], vehicle: Vehicle) -> str:
    """The message with which segments are refused, empty if they are not."""
    try:
        require_rotor_moments(parts, vehicle)
    except DataError as error:
        return str(error)
    return ""
