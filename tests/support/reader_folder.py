"""A folder with what the pages of the documentation name: logs, vehicle files, recordings, a campaign, models."""

from __future__ import annotations

import gzip
import shutil
from collections.abc import Sequence
from math import cos, pi
from pathlib import Path

import msgspec

import alula
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect, write_vehicle
from fixtures.fleet_flights import write_fleet
from fixtures.followed_flight import fly_following
from fixtures.planted import planted_flights
from tests.support.flight_files import manoeuvre, paper_bag
from tests.support.pages import ROOT
from tests.support.small_campaign import fly_campaign

DATA = ROOT / "tests" / "data"
MANOEUVRES = ("line:laps=3,ramp=1", "circle:laps=2,ramp=1,speed=1.2", "Lemniscate:laps=3,ramp=1.5,speed=0.9")
REAL_LOG = DATA / "px4_sih_flights" / "nothing_1_circle.ulg.gz"
RECORDED = DATA / "recorded_flight" / "flight.mcap"
HOVERING = {  # of one real Crazyflie
    "suspect.csv": "cut_propeller_M3_3mm_E8_log01.csv.gz",
    "normal_1.csv": "normal_flight_E8_log00.csv.gz",
    "normal_2.csv": "normal_flight_E8_log03.csv.gz",
}
HIDDEN = ("motor_lag:time_constant=0.035", "rotor_drag:coefficient=6e-5")
CAMPAIGN = {
    "train/Line": "line:laps=3,ramp=1",
    "train/Circle": "circle:laps=3,ramp=1",
    "train/Figure": MANOEUVRES[2],
    "test/Ellipse": "circle:laps=2",
}


def heavier(vehicle: Vehicle) -> Vehicle:
    """The same vehicle with a wrong mass in its file."""
    return msgspec.structs.replace(vehicle, body=msgspec.structs.replace(vehicle.body, mass=1.06 * vehicle.body.mass))


def planted_logs(folder: Path, vehicle: Vehicle, effects: Sequence[str] = ()) -> Path:
    """Three logs of a vehicle that hides effects, the last of them named to be held out."""
    folder.mkdir()
    uses = [parse_effect(text, vehicle.rotors.count) for text in effects]
    flown = planted_flights(vehicle, uses, seed=5, manoeuvres=MANOEUVRES)
    for name, flight in zip(("flight_0", "flight_1", "holdout_0"), flown, strict=True):
        flight.to_csv(folder / f"{name}.csv")
    return folder


def hovering_logs(folder: Path) -> None:
    """Real flights in hover: one with a cut propeller, and normal ones."""
    folder.mkdir(exist_ok=True)
    for name, original in HOVERING.items():
        (folder / name).write_bytes(gzip.decompress((DATA / "crazypad_trim" / original).read_bytes()))


def prepare_reader_folder(folder: Path, vehicle: Vehicle) -> Path:
    """Write it. The log in `logs` is a real one of PX4, those in `planted` are of a vehicle whose file lacks drag."""
    (folder / "logs").mkdir(parents=True)
    shutil.copy(REAL_LOG, folder / "logs")
    planted_logs(folder / "planted", vehicle, ["rotor_drag:coefficient=6e-5"])
    hovering_logs(folder)
    write_fleet(folder / "fleet", {"alpha": [()], "beta": [()]})
    (folder / "recordings").mkdir()
    shutil.copy(RECORDED, folder / "recordings" / "20260301-101500.mcap")
    (folder / "adapted").mkdir()
    drag = parse_effect("rotor_drag:coefficient=4e-5", vehicle.rotors.count)
    fly_following(vehicle, folder / "adapted" / "flight.mcap", hidden=[drag])
    (folder / "flights").mkdir()
    shutil.copy(folder / "planted" / "holdout_0.csv", folder / "flights" / "held_out.mcap")  # its content decides
    shutil.copytree(ROOT / "vehicles", folder / "vehicles", ignore=shutil.ignore_patterns("__pycache__", "*.py"))
    shutil.copy(folder / "vehicles/arpl_250g.pi_tcn.pt", folder / "vehicles/my_quad.pi_tcn.pt")
    write_vehicle(vehicle, folder / "vehicle.toml")
    for name in ("my_quad.toml", "my_quad.v2.toml"):
        write_vehicle(heavier(vehicle), folder / name)
    alula.export(folder / "my_quad.toml", folder / "bundles" / "my_quad", windows=10)
    shutil.copy(ROOT / "examples" / "my_effects.py", folder)
    (folder / "bad_day.toml").write_text(
        'wind = { x = 1.0, y = 0.0 }\n[[faults]]\nkind = "estimator_reset"\nat = 60.0\n'
    )
    _write_paths(folder)
    fly_campaign(folder / "build" / "campaign_learning", vehicle, HIDDEN, CAMPAIGN)
    fly_campaign(folder / "build" / "campaign_nominal", vehicle, (), {"train/Line": CAMPAIGN["train/Line"]})
    (folder / "build" / "campaign").symlink_to("campaign_learning")
    for seconds, name in enumerate(("train/Ellipse_1_slow", "train/Lemniscate_xz", "train/line", "test/Ellipse_1")):
        (folder / name).parent.mkdir(exist_ok=True)
        paper_bag(manoeuvre(duration=10.0 + seconds), folder / f"{name}.bag")
    return folder


def _write_paths(folder: Path) -> None:
    """References of a reader's own: a slow line out and back, 1.5 m up."""
    rows = [f"{t / 10},{0.25 - 0.25 * cos(pi * t / 50):.5f},0,1.5" for t in range(101)]
    text = "\n".join(["t,position_x,position_y,position_z", *rows]) + "\n"
    for name in ("my_path.csv", "next.csv"):
        (folder / name).write_text(text)
