"""The paper's Table II on the mock: eight manoeuvres, each with five models in the controller, several runs of each.

The mock hides what the campaign's vehicle hides (`dynamics.references.campaign.REAL_WORLD`: drags, flapping, inflow,
motor lag, a thrust and an inertia that are a little off, moving air); sensor noise, estimation errors, delays and
PX4's rate loop are always on. Models: nominal; the same with what a diagnosis finds on nine training
flights of the campaign (effects); one member of the networks beside the vehicle file (pi_mlp, pi_tcn, and ours on
named effects, grey_box), exported. 15 s of each reference over UDP MAVLink in real time; the first 3 s, the ramp, do
not count.

Every flight is kept as a file, so that an interrupted run resumes; files of models that have changed since are
left out. Draws docs/pictures/table_two.png. With --estimates whole flights in lockstep instead, in motion capture and
on PX4's estimate, into a page of their own.

    python -m benchmarks tracking table_two [--runs 5] [--models NAME,..] [--jobs 2] [--lockstep]
    python -m benchmarks tracking table_two --estimates [--runs 1] [--models nominal,effects]
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
from collections.abc import Sequence
from pathlib import Path

import msgspec

from benchmarks.measurement import ROOT, Page, add_names, options_of
from benchmarks.tracking.table_two_page import PICTURE, body, draw, estimates_body
from benchmarks.tracking.table_two_worker import VEHICLE, Flown, Pace, Run, fly
from diagnosis.addition import write_next_version
from diagnosis.completion import complete
from diagnosis.data.dataset import read_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle_file import find_vehicle, read_vehicle
from export.bundle import ExportOptions, export_bundle
from export.trained import read_model
from flights.parallel import parallel_map
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from studies.paper import TRACKING_NOMINAL

BUILD = ROOT / "build"
MODELS = ("nominal", "effects", "pi_mlp", "pi_tcn", "grey_box")
FIRST_SEED = 9001  # the campaign's flights were flown with others
DIAGNOSED = (
    "circle_xy_wide",
    "line_x_wide",
    "line_z_wide",
    "yaw_spin_130",
    "TransposedParabola_wide",
    "WarpedEllipse_1_xz",
    "Lemniscate_xz_60",
    "ExtendedLemniscate_xy_60",
    "WarpedEllipse_2_yz_60",
)


def table_two(words: Sequence[str]) -> Page:
    """The measurement's page."""
    arguments = _arguments(words)
    models = arguments.models.split(",")
    runs = [
        Run(pace, model, str(path), key, manoeuvre, FIRST_SEED + number)
        for model in models
        for path, key in [_model(model, arguments.keep, arguments.campaign)]
        for number in range(arguments.runs)
        for manoeuvre in arguments.manoeuvres
        for pace in _paces(arguments)
    ]
    missing = [] if arguments.only_finished else [run for run in runs if not _file(arguments.keep, run).exists()]
    for number, (_, flown) in enumerate(parallel_map(fly, missing, jobs=arguments.jobs), start=1):
        _write(_file(arguments.keep, flown.run), flown)
        outcome = flown.ended or f"{100 * flown.position_rmse:.1f} cm"
        print(
            f"{number}/{len(missing)} {flown.run.model} {flown.run.manoeuvre} {flown.run.seed}: {outcome}", flush=True
        )
    results = [_read(_file(arguments.keep, run)) for run in runs if _file(arguments.keep, run).exists()]
    if arguments.estimates:
        return Page(
            "table_two_px4",
            "Tracking on PX4's estimate, hidden effects",
            estimates_body(results, _effects_file(arguments.keep)),
        )
    title = "Tracking with five models, hidden effects"
    if arguments.lockstep:
        return Page("table_two", title, body(results, [], _effects_file(arguments.keep)), trial=True)
    quick = [msgspec.structs.replace(run, pace="lockstep") for run in runs]
    lockstep_flights = [_read(_file(arguments.keep, run)) for run in quick if _file(arguments.keep, run).exists()]
    if not (arguments.no_page or arguments.quick):
        draw(results, PICTURE)
    return Page("table_two", title, body(results, lockstep_flights, _effects_file(arguments.keep)))


def _paces(arguments: argparse.Namespace) -> tuple[Pace, ...]:
    if arguments.estimates:
        return ("mocap", "px4")
    return ("lockstep",) if arguments.lockstep else ("link",)


def _arguments(words: Sequence[str]) -> argparse.Namespace:
    parser = options_of(__doc__)
    parser.add_argument("--runs", type=int, default=5)
    add_names(parser, "--manoeuvres", TRACKING_NOMINAL)
    parser.add_argument("--models", default=",".join(MODELS))
    parser.add_argument("--jobs", type=int, choices=(1, 2), default=2, help="flights at the same time")
    parser.add_argument("--lockstep", action="store_true", help="simulated time, no link; prints, writes nothing")
    parser.add_argument("--estimates", action="store_true", help="in lockstep, in motion capture and on PX4's estimate")
    parser.add_argument("--only-finished", action="store_true", help="fly nothing, write from what is there")
    parser.add_argument("--keep", type=Path, default=BUILD / "table_two")
    parser.add_argument("--campaign", type=Path, default=BUILD / "campaign_learning", help="of `alula campaign`")
    return parser.parse_args(words)


def _model(name: str, keep: Path, campaign: Path) -> tuple[Path, str]:
    """A model's vehicle file or bundle, made unless it is there, and the key of what it came from."""
    if name == "nominal":
        path = find_vehicle(VEHICLE)
        return path, _key(path)
    if name == "effects":
        path = _effects_file(keep)
        if not path.exists():
            _diagnose(keep, campaign)
        return path, _key(path)
    checkpoint = find_vehicle(VEHICLE).with_suffix(f".{name}.pt")
    key = _key(checkpoint)
    folder = keep / f"{name}-{key}"
    if not folder.exists():
        export_bundle(read_model(checkpoint), folder, ExportOptions(Problem(), native_processor()))
    return folder, key


def _effects_file(keep: Path) -> Path:
    return keep / f"{VEHICLE}.v2.toml"


def _diagnose(keep: Path, campaign: Path) -> None:
    """Write the vehicle file with what training flights show to be missing."""
    file = find_vehicle(VEHICLE)
    vehicle = read_vehicle(file)
    dataset = read_dataset([campaign / "train" / f"{name}.parquet" for name in DIAGNOSED], vehicle)
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    results = complete(dataset, vehicle, CATALOGUE, date=today, command="python -m benchmarks tracking table_two")
    keep.mkdir(parents=True, exist_ok=True)
    write_next_version(results.vehicle, keep / f"{VEHICLE}.toml", source=file)


def _key(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:10]


def _file(keep: Path, run: Run) -> Path:
    return keep / f"{run.pace}_{run.model}_{run.key}_{run.manoeuvre}_{run.seed}.json"


def _write(path: Path, flown: Flown) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".part").write_bytes(msgspec.json.encode(flown))
    path.with_suffix(".part").replace(path)


def _read(path: Path) -> Flown:
    return msgspec.json.decode(path.read_bytes(), type=Flown)
