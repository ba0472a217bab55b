"""A bundle: a folder with a compiled kernel, its vehicle file, and a manifest with their hashes.

A bundle is code. It runs where the user has approved its manifest, and with that every file that the manifest lists:
by exporting it here, or with `alula trust BUNDLE` (`dynamics.trust`).

`alula export` writes bundles. A bundle flies without CasADi and without a compiler: what its kernel must be told of the
vehicle stands in the manifest. A folder with a vehicle file alone is a bundle of that file's model, compiled before it
flies.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynamics.approvals import Kind
from dynamics.decoding import decode_json
from dynamics.effect_source import ENDING, printable
from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.network_inputs import Frame
from dynamics.trust import approve_here, is_approved, quoted
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_vehicle
from dynamics.vehicle_file import vehicle_text as read_vehicle_text
from runtime.control.kernel_model import FlownModel, KernelFacts, KernelModel
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import PROCESSORS

FORMAT, VERSION = "alula bundle", 5
MANIFEST, VEHICLE, KERNEL, ONNX = "manifest.json", "vehicle.toml", "kernel.so", "model.onnx"
PHYSICS = "physics.so"  # the solver of the vehicle file's model, the fallback of a learned one
LAST_LAYER = "last_layer.npz"  # what a network's last layer was trained on, where it may follow in flight
TICKS = "ticks.npz"  # recorded ticks of the kernels, which `alula export --verify` repeats
Integrator = Literal["hold", "adams_bashforth", "rk4"]


class InputRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Smallest and largest value of an input in training, in SI units."""

    name: str
    unit: str
    lowest: float
    highest: float


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A bundle's content and origin.

    kind: of the model.
    learned: whether there is a network.
    physics: "none" for a network alone, "nominal" for the nominal model, "vehicle" for the identified one.
    motors: whether rotor speeds are commanded or measured ones.
    label: what the network predicts: accelerations at an instant, or their mean over a step.
    filtered_inputs: whether training filtered its inputs with their future, which no flight has.
    integrator: how the kernel integrates accelerations.
    history: columns of a window.
    dt: s between columns.
    frame: of the network's inputs.
    ranges: of the inputs in training.
    errors: RMSE on the validation flights, linear m/s^2 and angular rad/s^2.
    members: networks whose disagreement shows in flight how certain the model is; 1 for a network alone.
    fades: whether the network's output fades where they disagree.
    shapes: of ONNX inputs and outputs.
    problem: the optimal control problem that the kernel was compiled for.
    kernel_facts: of the kernel's model.
    vehicle_facts: of the vehicle file's model, from which references and a learned model's fallback follow.
    precision: of the kernel's network.
    files: sha256 by name.
    provenance: of the model, from its training.
    notes: for the pilot.
    digest: sha256 of everything else here.
    """

    kind: str
    learned: bool
    physics: Literal["none", "nominal", "vehicle"]
    motors: Literal["command", "measured"]
    label: Literal["instantaneous", "mean_increment"]
    filtered_inputs: bool
    integrator: Integrator
    rotors: int
    history: int
    dt: float
    frame: Frame
    ranges: tuple[InputRange, ...]
    errors: dict[str, float]
    members: int
    fades: bool
    shapes: dict[str, tuple[int | str, ...]]
    units: dict[str, str]
    problem: Problem
    kernel_facts: KernelFacts
    vehicle_facts: KernelFacts
    processor: str
    precision: Literal["float", "double"]
    files: dict[str, str]
    command: str
    date: str
    versions: dict[str, str]
    provenance: dict[str, str]
    notes: tuple[str, ...]
    digest: str = ""
    format: str = FORMAT
    version: int = VERSION


class _Head(msgspec.Struct, frozen=True):
    """The fields of a manifest by which one of another version is refused, whatever else that version lists."""

    format: str = FORMAT
    version: int = VERSION


def with_digest(manifest: Manifest) -> Manifest:
    """The manifest with its digest, which reveals a later edit."""
    rest = msgspec.json.encode(msgspec.structs.replace(manifest, digest=""))
    return msgspec.structs.replace(manifest, digest=hashlib.sha256(rest).hexdigest())


@dataclass(frozen=True, eq=False)
class Bundle:
    """A bundle that has passed the checks.

    model: states, parameters and vehicle of the kernel's physics.
    vehicle_model: the same of the vehicle file's model.
    """

    folder: Path
    manifest: Manifest
    vehicle: Vehicle
    vehicle_text: str
    model: FlownModel
    vehicle_model: FlownModel

    @property
    def kernel(self) -> Path:
        """The compiled kernel."""
        return self.folder / KERNEL

    @property
    def physics(self) -> Path:
        """The compiled solver of the vehicle file's model, in a bundle of a learned one."""
        return self.folder / PHYSICS

    @property
    def last_layer(self) -> Path | None:
        """File of the last layer's training moments; None in a bundle without it."""
        return self.folder / LAST_LAYER if LAST_LAYER in self.manifest.files else None

    @property
    def range_limits(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Smallest and largest inputs (k,) in training."""
        ranges = self.manifest.ranges
        return np.array([r.lowest for r in ranges]), np.array([r.highest for r in ranges])


def read_bundle(folder: Path) -> Bundle:
    """Read and check a bundle.

    Raises RequestError for one that is damaged or edited, built for another machine, only usable on a workbench, or
    not approved.
    """
    manifest, sha256 = _read_manifest(folder / MANIFEST)
    _require_files(folder, manifest)
    for name in (VEHICLE, KERNEL, *([PHYSICS] if manifest.learned else [])):
        if name not in manifest.files:
            raise RequestError(f"{folder / MANIFEST} lists no {name}: it was edited. Export the model again.")
    if manifest.filtered_inputs:
        raise RequestError(
            f"{folder} cannot fly: its model was trained on inputs filtered with their future, which no flight has. "
            "Train it with --causal-inputs; its model.onnx and model.c can be used on a workbench."
        )
    _require_machine(folder, manifest)
    _require_unedited(folder, manifest)
    _require_approved(folder, manifest, sha256)
    text = read_vehicle_text(folder / VEHICLE)
    vehicle = parse_vehicle(text)
    return bundle_of(folder, manifest, vehicle, text)


def whole_manifest(folder: Path) -> tuple[Manifest, str]:
    """The manifest of a bundle whose files are those that it lists, and the manifest's sha256. Nothing runs.

    Raises RequestError for a bundle that is damaged or edited.
    """
    manifest, sha256 = _read_manifest(folder / MANIFEST)
    _require_files(folder, manifest)
    _require_unedited(folder, manifest)
    return manifest, sha256


def _require_files(folder: Path, manifest: Manifest) -> None:
    """Raise RequestError for a file that is not the one that the manifest lists."""
    for name, digest in manifest.files.items():
        if _digest(folder / name) != digest:
            raise RequestError(
                f"{folder / name} is not the file that was exported: its sha256 differs from the manifest's. Nothing "
                "is proven about it; export the model again."
            )


def _require_unedited(folder: Path, manifest: Manifest) -> None:
    """Raise RequestError for a manifest that was edited after the export."""
    if with_digest(manifest) != manifest:
        raise RequestError(
            f"{folder / MANIFEST} is not what was exported: its digest does not fit. Limits and errors that guard the "
            "flight may have changed; export the model again."
        )


def code_of(manifest: Manifest) -> dict[str, tuple[Kind, str]]:
    """The files of a bundle that can run, by name: shared libraries and effects of the user's own."""
    libraries: dict[str, tuple[Kind, str]] = {
        name: ("library", sha256) for name, sha256 in manifest.files.items() if ".so" in Path(name).suffixes
    }
    effects: dict[str, tuple[Kind, str]] = {
        name: ("effects", sha256) for name, sha256 in manifest.files.items() if Path(name).suffix == ENDING
    }
    return libraries | effects


def _require_approved(folder: Path, manifest: Manifest, sha256: str) -> None:
    """Raise RequestError for a bundle that the user has not approved; its files are approved with it."""
    code = code_of(manifest)
    if not is_approved("bundle", sha256):
        files = "\n".join(f"  sha256 {digest}  {printable(name)}" for name, (_, digest) in code.items())
        raise RequestError(
            f"{printable(str(folder))} is code that would run as you, and you have not approved it on this "
            f"machine:\n{files}\n  sha256 {sha256}  {MANIFEST}\n"
            f"Approve it, if you know who exported it: alula trust {quoted(folder)}"
        )
    approve_here(code.values())


def bundle_of(folder: Path, manifest: Manifest, vehicle: Vehicle, text: str) -> Bundle:
    """The bundle of a vehicle, which may have other limits and settings than the file's, of which the text is."""
    models = (KernelModel.of(vehicle, facts) for facts in (manifest.kernel_facts, manifest.vehicle_facts))
    return Bundle(folder, manifest, vehicle, text, *models)


def parse_manifest(text: str | bytes) -> Manifest:
    """A manifest. Raises MsgspecError for one of another version, or damaged."""
    return decode_json(text, Manifest)


def _read_manifest(path: Path) -> tuple[Manifest, str]:
    """A manifest and its sha256. Raises RequestError for a damaged one, or of another version."""
    try:
        content = path.read_bytes()
        head = decode_json(content, _Head)
        if (head.format, head.version) != (FORMAT, VERSION):
            raise RequestError(f"{path} is {head.format} {head.version}, required is {FORMAT} {VERSION}. Export again.")
        manifest = parse_manifest(content)
    except OSError as error:
        raise RequestError(f"{path.parent} is no bundle: {error}. Give a folder that `alula export` wrote.") from None
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise RequestError(
            f"{path} is damaged or of another alula: {described(error)}. Export the model again."
        ) from None
    return manifest, hashlib.sha256(content).hexdigest()


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise RequestError(f"the bundle misses {path}: {error}. Export the model again.") from None


def _require_machine(folder: Path, manifest: Manifest) -> None:
    processor = PROCESSORS.get(manifest.processor)
    if processor is None or not processor.runs_here:
        usable = [processor.name for processor in PROCESSORS.values() if processor.runs_here]
        raise RequestError(
            f"the kernel in {folder} was built for {manifest.processor}, which this processor does not have: it "
            "belongs on another computer. Export the model again here, or elsewhere with --processor "
            f"{usable[0] if usable else 'native'}."
        )
