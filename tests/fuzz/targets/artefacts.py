"""What Alula itself wrote and somebody sends: bundles, checkpoints, cases, recordings to replay, results, approvals."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from dynamics import approvals
from dynamics.approvals import approve, read_approvals
from dynamics.model import build_model
from dynamics.trust import approve_here
from dynamics.vehicle_file import read_vehicle, vehicle_toml
from runtime.control.bundle import (
    FORMAT,
    KERNEL,
    LAST_LAYER,
    MANIFEST,
    TICKS,
    VEHICLE,
    Manifest,
    read_bundle,
    whole_manifest,
    with_digest,
)
from runtime.control.bundle import VERSION as BUNDLE_VERSION
from runtime.control.kernel_model import kernel_facts
from runtime.control.network_features import last_layer_file, read_features
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from runtime.control.verification import read_ticks
from runtime.flight_setup import recorded_flight
from runtime.record.recording import damage_named, read_attachments, read_recording
from runtime.replay import replay
from studies.results.read import show
from studio.case.archive import unpack_archive, write_archive
from studio.case.case import Case
from studio.case.commands import script
from tests.fuzz.mutation import Parts
from tests.fuzz.target import Target, files_in_folder, one_file
from tests.fuzz.targets.logs import mcap_of, recorded_messages
from tests.support.results_on_disk import evaluation_file, fleet_folder, sweep_folder, training_file
from tests.support.trained import untrained_model
from training.checkpoint import load, save
from training.config import ModelConfig
from vehicles import FOLDER

VEHICLE_FILE = FOLDER / "arpl_250g.toml"


# --- archives: whole members that are mutated inside, as well as the archive's own bytes


def _members(path: Path) -> Parts:
    with zipfile.ZipFile(path) as archive:
        return {entry.filename: archive.read(entry) for entry in archive.infolist()}


def _zip(name: str, parts: Parts, folder: Path) -> Path:
    """Members stored without compression, as torch reads them, with right checksums."""
    with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_STORED) as archive:
        for member, content in parts.items():
            archive.writestr(zipfile.ZipInfo(member), content)
    return folder / name


# --- checkpoints


def _checkpoint(folder: Path) -> Path:
    config = ModelConfig("pi_tcn", "tcn", channels=4, hidden=(4,))
    save(untrained_model(config, read_vehicle(VEHICLE_FILE)), folder / "m.pt")
    return folder / "m.pt"


# --- bundles: without code that could be loaded, which a bundle's libraries are


def _bundle(_: Path) -> list[Parts]:
    vehicle = read_vehicle(VEHICLE_FILE)
    facts = kernel_facts(build_model(vehicle))
    manifest = Manifest(
        "nominal", learned=False, physics="vehicle", motors="command", label="mean_increment", filtered_inputs=False,
        integrator="rk4", rotors=4, history=1, dt=0.01, frame="body", ranges=(), errors={}, members=1, fades=False,
        shapes={"x": ("n", 13)}, units={}, problem=Problem(), kernel_facts=facts, vehicle_facts=facts,
        processor=native_processor().name, precision="double", files={}, command="alula export", date="2026-01-01",
        versions={}, provenance={}, notes=("a note",), format=FORMAT, version=BUNDLE_VERSION,
    )  # fmt: skip
    return [{MANIFEST: msgspec.json.encode(manifest), VEHICLE: vehicle_toml(vehicle).encode(), KERNEL: b"no code"}]


def _sealed(parts: Parts, folder: Path) -> Path:
    """A bundle whose hashes and digest are right, as whoever edits one makes them, and which the user has approved."""
    path = files_in_folder(parts, folder)
    try:
        table = json.loads(parts[MANIFEST])
        table["files"] |= {name: hashlib.sha256(parts[name]).hexdigest() for name in parts if name != MANIFEST}
        content = json.dumps(table).encode()
        content = msgspec.json.encode(with_digest(msgspec.json.decode(content, type=Manifest)))
        (path / MANIFEST).write_bytes(content)
    except (ValueError, TypeError, KeyError, RecursionError, msgspec.MsgspecError):
        return path
    approve_here([("bundle", hashlib.sha256(content).hexdigest())])
    return path


def _npz(name: str, made: Callable[[], bytes]) -> Callable[[Path], list[Parts]]:
    return lambda _: [{name: made()}]


def _ticks() -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **{f"{KERNEL}/0/state": np.zeros(13), f"{KERNEL}/0/inputs": np.ones((3, 4))})
    return file.getvalue()


def _inside(made: Callable[[], bytes]) -> Callable[[Path], list[Parts]]:
    def seeds(folder: Path) -> list[Parts]:
        (folder / "arrays.npz").write_bytes(made())
        return [_members(folder / "arrays.npz")]

    return seeds


def _features() -> bytes:
    return last_layer_file(np.eye(5), body=True)


# --- cases


def _case_archive(folder: Path) -> Path:
    (folder / "flight.csv").write_text("t\n1\n")
    case = Case.create(folder / "case", name="my case")
    case.add_logs([folder / "flight.csv"])
    case.set_vehicle("px4_sih")
    case.add_version(case.vehicle_path().read_text() + "# more\n", action="added drag", channels={})
    case.undo()
    write_archive(case, folder / "case.alula.zip")
    case.close()
    return folder / "case.alula.zip"


def _open_case(path: Path) -> None:
    """What the studio does with a case that was sent to somebody; it is thrown away afterwards."""
    folder = path.parent / "unpacked"
    try:
        unpack_archive(path, folder)
        case = Case.open(folder)
        try:
            case.vehicle_name()
            script(case)
            case.key("check")
            case.undo()
            case.redo()
        finally:
            case.close()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


# --- recordings


def _replay(path: Path) -> None:
    """As `alula replay` does it."""
    read_attachments(path)
    recording = read_recording(path)
    with damage_named(path):
        replay(recording, *recorded_flight(recording, None, None))


# --- results of studies


def _folder_of(made: Callable[[Path], Path]) -> Callable[[Path], list[Parts]]:
    def seeds(folder: Path) -> list[Parts]:
        path = made(folder / "result")
        return [{file.name: file.read_bytes() for file in sorted(path.iterdir())}]

    return seeds


def _file_of(made: Callable[[Path], Path]) -> Callable[[Path], list[Parts]]:
    def seeds(folder: Path) -> list[Parts]:
        path = made(folder)
        return [{path.name: path.read_bytes()}]

    return seeds


def _approvals(_: Path) -> list[Parts]:
    approve([("effects", "ab" * 32, "my_effects.py"), ("bundle", "cd" * 32, "bundle")])
    return [{"approvals": approvals.store_path().read_bytes()}]


def _listed(path: Path) -> object:
    store = approvals.store_path()
    before = store.read_bytes()
    try:
        store.write_bytes(path.read_bytes())
        return read_approvals()
    finally:
        store.write_bytes(before)


TARGETS = (
    Target("checkpoint", _file_of(_checkpoint), load),
    Target("checkpoint_members", lambda folder: [_members(_checkpoint(folder))], load, partial(_zip, "m.pt")),
    Target("bundle", _bundle, read_bundle, _sealed),
    Target("bundle_edited", _bundle, whole_manifest, files_in_folder),
    Target("ticks", _npz(TICKS, _ticks), read_ticks),
    Target("ticks_members", _inside(_ticks), read_ticks, partial(_zip, TICKS)),
    Target("last_layer", _npz(LAST_LAYER, _features), lambda path: read_features(path, 3)),
    Target("last_layer_members", _inside(_features), lambda path: read_features(path, 3), partial(_zip, LAST_LAYER)),
    Target("case_archive", _file_of(_case_archive), _open_case),
    Target(
        "case_members", lambda folder: [_members(_case_archive(folder))], _open_case, partial(_zip, "case.alula.zip")
    ),
    Target("replay", lambda _: [recorded_messages()], _replay, mcap_of),
    Target("replay_page", lambda _: [recorded_messages()], show, mcap_of),
    Target("fleet", _folder_of(fleet_folder), show, files_in_folder),
    Target("sweep", _folder_of(sweep_folder), show, files_in_folder),
    Target("training", _file_of(training_file), show),
    Target("evaluation", _file_of(evaluation_file), show),
    Target("approvals", _approvals, _listed, one_file),
)
