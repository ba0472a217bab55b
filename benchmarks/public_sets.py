"""Public flights in a user's own download, scored: what is missing from their model, and what the effects explain.

    make study-public DIR=~/datasets [SETS="nanobench idsia"]
    python -m benchmarks public_sets score ~/datasets [--sets nanobench idsia neurobem neural_fly] [--flights 10]

DIR holds one folder for each set, under any of the names listed in `SETS`. Nothing is downloaded. Of a set with more
flights than are asked for, some are taken evenly from all. Held out are the flights that its authors test on where
they say which, else the last fifth; forces and moments are compared below 8 Hz. Writes results/public_sets.md.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

import alula
from benchmarks.measurement import Page, options_of
from diagnosis.models.open_loop import open_loop_errors
from dynamics.arrays import Floats
from dynamics.effects import CATALOGUE
from dynamics.errors import AlulaError, DataError, RequestError
from dynamics.vehicle import Body, Rotors, Vehicle
from dynamics.vehicle_file import read_vehicle
from flights import Flight
from flights.log import Log, Provenance, Stream
from vehicles import FOLDER

QUAD_X = (2, 1, 3, 0)  # PX4's motors at our rotors
NEURAL_FLY_COLUMNS = ("t", "p", "v", "R", "w", "pwm")


def neural_fly_flight(path: Path) -> Flight:
    """A flight of Neural-Fly: cells hold lists, positions may be north-east-down.

    Raises DataError for a file without its columns.
    """
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    missing = [name for name in NEURAL_FLY_COLUMNS if not rows or name not in rows[0]]
    if missing:
        raise DataError(f"{path.name} lacks the columns {', '.join(missing)} of Neural-Fly's experiments.")
    table = {name: np.array([_cell(row[name]) for row in rows], dtype=float) for name in NEURAL_FLY_COLUMNS}
    time = table["t"].ravel() - table["t"].ravel()[0]
    turn = Rotation.from_matrix(table["R"].reshape(-1, 3, 3))
    position, velocity, rate = table["p"], table["v"], table["w"]
    if np.mean(position[:, 2]) < 0:  # down is positive: north-east-down and forward-right-down
        swap = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
        position, velocity = swap.apply(position), swap.apply(velocity)
        turn = swap * turn * Rotation.from_euler("x", np.pi)
        rate = rate * [1.0, -1.0, -1.0]
    command = np.clip((table["pwm"][:, list(QUAD_X)] - 1000.0) / 1000.0, 0.0, 1.0)
    quantities: dict[str, Floats] = {
        "position": position, "velocity": velocity, "rate": rate, "rotor_command": command,
        "attitude": np.roll(turn.as_quat(canonical=True), 1, axis=1),
    }  # fmt: skip
    rising = np.concatenate([[True], np.diff(time) > 0])
    streams = [Stream(name, time[rising], values[rising], "neural_fly") for name, values in quantities.items()]
    return Flight.from_log(Log(tuple(streams), Provenance(path.name, "", "Neural-Fly experiment", "neural_fly")))


def _cell(text: str) -> list[float]:
    """A number, or a list of them, nested or not."""
    return np.asarray(json.loads(text), dtype=float).ravel().tolist()


@dataclass(frozen=True)
class PublicSet:
    """A public data set.

    folders: names that its download usually has; patterns: of the flights in it.
    read: a flight from its file.
    tested_on: pattern of the file names that its authors test on; empty where they name none.
    published: figures of its authors to compare with, and where they stand; empty where none could be checked.
    unverified: what of the layout could not be verified without the data.
    """

    title: str
    folders: tuple[str, ...]
    patterns: tuple[str, ...]
    vehicle: Callable[[], Vehicle]
    source: str
    read: Callable[[Path], Flight] = Flight.read
    tested_on: str = ""
    published: str = ""
    unverified: str = ""


def _vehicle(name: str, mass: float, inertia: tuple[float, float, float], places: Sequence[tuple[float, float]],
             thrust: float, torque: float, top: float, radius: float) -> Vehicle:  # fmt: skip
    position = tuple((x, y, 0.0) for x, y in places)
    rotors = Rotors(position, (1, -1, 1, -1), thrust, torque, top, radius=radius)
    return Vehicle(name=name, body=Body(mass, inertia), rotors=rotors)


def _quadrants(x: float, y: float) -> list[tuple[float, float]]:
    return [(x, y), (-x, y), (-x, -y), (x, -y)]


def nanobench() -> Vehicle:
    """The Crazyflie, as heavy as flown."""
    vehicle = read_vehicle(FOLDER / "crazyflie.toml")
    return msgspec.structs.replace(vehicle, body=msgspec.structs.replace(vehicle.body, mass=0.04085))


def crazyflie_brushless() -> Vehicle:
    """The benchmark's own physical model: 45 g, 35.3 mm, its thrust constant; torque over thrust as of a Crazyflie."""
    inertia = (2.3951e-5, 2.3951e-5, 3.2347e-5)
    return _vehicle("crazyflie_brushless", 0.045, inertia, _quadrants(0.0353, 0.0353), 3.72e-8, 2.6e-10, 3200.0, 0.0275)


def kingfisher() -> Vehicle:
    """The quadrotor of NeuroBEM: mass as its page corrects it, the rest as the Agilicious stack configures it."""
    places = _quadrants(0.075, 0.10)
    return _vehicle("kingfisher", 0.772, (0.0025, 0.0021, 0.0043), places, 1.5625e-6, 3.44e-8, 2800.0, 0.0648)


def neural_fly() -> Vehicle:
    """The custom drone of Neural-Fly: 2.6 kg; arms, inertia and rotors are estimates, so that moments say little."""
    places = _quadrants(0.11, 0.14)
    return _vehicle("neural_fly", 2.6, (0.035, 0.03, 0.06), places, 1.3e-5, 1.6e-7, 1000.0, 0.127)


SETS = {
    "nanobench": PublicSet(
        "NanoBench",
        ("nanobench-iros2026", "nanobench"),
        ("**/B*_rep*.csv*",),
        nanobench,
        "Ullah and Baca, arXiv 2603.09908; https://github.com/syediu/nanobench-iros2026",
    ),
    "idsia": PublicSet(
        "IDSIA NanoDrone",
        ("nanodrone-sysid-benchmark", "idsia", "nanodrone"),
        tuple(f"**/{part}/*_run*.{ending}" for part in ("train", "test") for ending in ("csv", "parquet")),
        crazyflie_brushless,
        "Busetto et al., arXiv 2512.14450; https://github.com/idsia-robotics/nanodrone-sysid-benchmark",
        tested_on="melon_*",
        unverified="torque over thrust; that its Parquet tables have the columns of its text tables",
    ),
    "neurobem": PublicSet(
        "NeuroBEM",
        ("neurobem", "neuro_bem", "NeuroBEM"),
        ("**/processed_data/*.csv", "merged_*.csv"),
        kingfisher,
        "Bauersfeld et al., RSS 2021; https://rpg.ifi.uzh.ch/neuro_bem/Readme.html",
        published="force, authors' network: 0.565 N (flights and filter of theirs)",
        unverified="the directions in which the rotors turn (wrong ones are refused), thrust and torque constants",
    ),
    "neural_fly": PublicSet(
        "Neural-Fly",
        ("neural-fly", "neural_fly", "neuralfly"),
        ("**/data/experiment/custom_*.csv",),
        neural_fly,
        "O'Connell et al., Science Robotics 2022; https://github.com/aerorobotics/neural-fly",
        read=neural_fly_flight,
        unverified="the vehicle's arms, inertia and rotors; the frame, which is taken from the sign of height",
    ),
}


def flights_below(public: PublicSet, folder: Path) -> list[Path]:
    """The files of a set's flights, in the order of its patterns and of their names; of a flight in two formats one."""
    paths: dict[Path, Path] = {}
    for path in (path for pattern in public.patterns for path in sorted(folder.glob(pattern))):
        paths.setdefault(path.parent / path.name.partition(".")[0], path)
    return list(paths.values())


def folder_of(public: PublicSet, parent: Path) -> Path:
    """Of a set's download. Raises RequestError, with what to download, where there is none."""
    if not parent.is_dir():
        raise RequestError(f"{parent} is no folder. Give the folder that holds the downloads as DIR.")
    for name in public.folders:
        if flights_below(public, parent / name):
            return parent / name
    if parent.name in public.folders and flights_below(public, parent):
        return parent
    tried = ", ".join(f"{name}/{pattern}" for name in public.folders for pattern in public.patterns)
    raise RequestError(
        f"{parent} lacks {public.title}: none of {tried} is there. Download it from {public.source} and give the "
        "folder above it as DIR."
    )


def chosen(paths: Sequence[Path], limit: int) -> list[Path]:
    """So many of the files at most, evenly from all."""
    if len(paths) <= limit:
        return list(paths)
    return [paths[round(place)] for place in np.linspace(0, len(paths) - 1, limit)]


def _held_out(public: PublicSet, flights: Sequence[Flight]) -> str | None:
    """The pattern of the flights to hold out, if some but not all of them are what the authors test on."""
    tested = [fnmatchcase(Path(flight.provenance.path).name, public.tested_on) for flight in flights]
    return public.tested_on if any(tested) and not all(tested) else None


def _shortened(error: AlulaError, path: Path) -> str:
    """The beginning of a message without its file."""
    return str(error).removeprefix(f"{path}").lstrip(": ")[:160]


def section(public: PublicSet, folder: Path, limit: int) -> str:
    """Diagnosis of a set: its sentence, held-out errors over their floor, and open-loop errors before and after.

    Raises RequestError where no flight of it can be read.
    """
    paths = chosen(flights_below(public, folder), limit)
    flights, left_out = [], []
    for path in paths:
        try:
            flights.append(public.read(path))
        except AlulaError as error:
            left_out.append(f"{path.name}: {_shortened(error, path)}")
    if not flights:
        raise RequestError(f"{folder}: none of {len(paths)} flights of {public.title} can be read. {left_out[0]}")
    vehicle = public.vehicle()
    head = [f"## {public.title}", "", f"{public.source}. {len(flights)} flights."]
    head += [f"Not verified without the data: {public.unverified}."] if public.unverified else []
    head += (
        [f"Published: {public.published}."]
        if public.published
        else ["Published figures: see the paper; none is copied here."]
    )
    head += [f"Left out: {'; '.join(left_out)}."] if left_out else []
    try:
        result = alula.diagnose(flights, vehicle, hold_out=_held_out(public, flights))
    except AlulaError as error:
        return "\n".join([*head, "", f"Refused: {error}"])
    report = result.report
    lines = [
        *head,
        "",
        f"{report.verdict}: {result.sentence}",
        "",
        "| channel, held out | before | after | floor | unit |",
    ]
    lines.append("| --- | --- | --- | --- | --- |")
    lines += [
        f"| {k} | {c.before:.3g} | {c.after:.3g} | {c.floor:.3g} | {c.unit} |" for k, c in report.channels.items()
    ]
    force = report.channels.get("imu") or report.channels.get("mocap")
    if force is not None:
        weight = vehicle.body.mass
        lines.append(
            f"| force | {weight * force.before:.3g} | {weight * force.after:.3g} | {weight * force.floor:.3g} | N |"
        )
    lines += [
        "",
        "| open loop after | position m | velocity m/s | attitude rad | rate rad/s |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, model in (("nominal", vehicle), ("with effects", result.details.vehicle)):
        for e in open_loop_errors(model, CATALOGUE, result.dataset.held_out):
            values = " | ".join(f"{v:.3g}" for v in (e.position, e.velocity, e.attitude, e.rate))
            lines.append(f"| {e.horizon:g} s, {name} | {values} |")
    return "\n".join(lines)


def score(words: Sequence[str]) -> Page:
    """Score the sets that are there."""
    made = options_of(__doc__)
    made.add_argument("folder", type=Path, help="that holds the downloads")
    made.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    made.add_argument("--flights", type=int, default=12, help="of each set at most")
    options = made.parse_args(words)
    np.seterr(all="ignore")
    parts, missing = [], []
    for name in options.sets:
        try:
            parts.append(section(SETS[name], folder_of(SETS[name], options.folder), options.flights))
        except RequestError as error:
            missing.append(str(error))
    print("\n".join(dict.fromkeys(missing)), file=sys.stderr)
    if not parts:
        raise SystemExit(2)
    return Page("public_sets", "Public flights", "\n\n".join(parts))
