"""Reads every log of a folder and lists the quantities that each has and lacks; and how fast a long ULog is read.

    python -m benchmarks.read_flights [FOLDER]

FOLDER: any flight logs, by default the small ones that the tests use. The claim: a 10-minute ULog whose motion and
motors are logged at 250 Hz becomes a Flight in at most 3 s and 1 GB.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from benchmarks.provenance import write_result
from dynamics.errors import AlulaError
from fixtures.ulog_file import Topic, ulog_file
from flights import Flight, Log, read_chunks, read_folder

ROOT = Path(__file__).resolve().parents[1]

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
        command = [sys.executable, "-m", "benchmarks.read_flights", "--chunks", str(path)]
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
                [sys.executable, "-m", "benchmarks.read_flights", "--measure", str(path)],
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


def main() -> None:
    """Write the table."""
    if sys.argv[1:2] == ["--measure"]:
        measure_once(Path(sys.argv[2]))
        return
    if sys.argv[1:2] == ["--chunks"]:
        measure_chunks(Path(sys.argv[2]), CHUNK)
        return
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "tests" / "data"
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
        f"{reading_speed()}\n\n{reading_in_chunks()}\n\n"
        f"{len(rows)} files, {size / 1e6:.1f} MB, read in {elapsed:.1f} s.\n\n{head}" + "\n".join(rows)
    )
    write_result("read_flights", "Reading flights", body)


if __name__ == "__main__":
    main()
