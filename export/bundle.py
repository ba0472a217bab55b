"""`alula export`: all files of a bundle, the proof that they agree, and the manifest that ties them together."""

from __future__ import annotations

import datetime
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import casadi as ca
import msgspec
import tomlkit

from dynamics.approvals import approve
from dynamics.arrays import Floats
from dynamics.decoding import editable_toml
from dynamics.effect_source import KEY
from dynamics.errors import RequestError
from dynamics.model import Model, build_model
from dynamics.state import RIGID_BODY_STATES
from dynamics.trust import approve_here
from dynamics.version import VERSION_KEY, __version__
from export.c_files import build_c_files, c_files, compiled
from export.compiler import compiler_for
from export.integrator import cautions
from export.kernel import KernelRecipe, Precision, build_kernel, kernel_recipe
from export.onnx_file import OPSET, onnx_model
from export.parity import Backends, Parity, prove
from export.physics_field import field_function
from export.symbolic import column_names, column_units, jacobian_function, model_function, weighted_function
from export.tick_files import FOLDER, tick_files
from export.trained import ExportedModel
from export.windows import random_windows, recorded_windows, reference_windows
from runtime.control.bundle import (
    KERNEL,
    LAST_LAYER,
    MANIFEST,
    ONNX,
    PHYSICS,
    TICKS,
    VEHICLE,
    InputRange,
    Manifest,
    with_digest,
)
from runtime.control.kernel_model import kernel_facts
from runtime.control.network_features import last_layer_file
from runtime.control.rti.compilation import solver_recipe
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import PROCESSORS, Processor, native_processor
from runtime.control.rti.solver import RtiSolver
from runtime.control.verification import record_ticks

PARITY, SOURCES = "parity.json", "kernel"
WINDOWS = 1000
MIN_WINDOWS = 10  # of each kind, for an error in the mean of which a difference shows
MIN_NODES, MIN_HORIZON = 2, 0.1  # of a controller's problem; s
LIBRARIES = ("alula", "numpy", "casadi", "onnx", "onnxruntime", "torch")


@dataclass(frozen=True)
class ExportOptions:
    """How a model is exported.

    problem: the controller's.
    processor: that the kernel is compiled for.
    logs: flights to compare backends on, the paper's references without any.
    windows: to compare backends on, of each kind.
    seed: of the random windows.
    overwrite: whether a bundle that exists may be replaced.
    command: that is noted in the manifest.
    """

    problem: Problem
    processor: Processor
    logs: tuple[Path, ...] = ()
    windows: int = WINDOWS
    seed: int = 0
    overwrite: bool = False
    command: str = "alula export"

    def __post_init__(self) -> None:
        """Refuse what no bundle can be proven or flown with."""
        for name, value, minimum in (
            ("windows", self.windows, MIN_WINDOWS),
            ("seed", self.seed, 0),
            ("nodes", self.problem.nodes, MIN_NODES),
            ("horizon", self.problem.horizon, MIN_HORIZON),
        ):
            if not value >= minimum:
                raise RequestError(f"{name} = {value}: wanted is {minimum:g} or more. Give another, or leave it out.")


@dataclass(frozen=True)
class Exported:
    """A bundle that was written."""

    folder: Path
    manifest: Manifest
    parity: Parity


def export_bundle(model: ExportedModel, folder: Path, options: ExportOptions) -> Exported:
    """Write a bundle, under a temporary name until it is whole and proven.

    A kernel for a processor that this machine does not have is proven by one for its own, from the same sources;
    `alula export --verify` then compares the two where the bundle flies.

    Raises RequestError when the folder exists already or there is no compiler, DataError when the backends disagree.
    """
    _require_free(folder, options)
    compiler = compiler_for(options.processor)
    here = options if options.processor.runs_here else replace(options, processor=native_processor())
    proto = onnx_model(model, _onnx_metadata(model, options)).SerializeToString()
    texts = c_files(model)
    proven = _kernels(model, here)
    flown = proven if here is options else _kernels(model, options)
    double = _kernel_recipe(model, here, "double")
    _compile([*proven.values(), double], texts)
    single = RtiSolver(model.flight_model, options.problem, build_kernel(proven[KERNEL]))
    parity = _prove(model, options, proto, texts, single, build_kernel(double))
    parity.require()
    solvers = {KERNEL: single}
    if PHYSICS in proven:
        solvers[PHYSICS] = RtiSolver(build_model(model.vehicle), options.problem, build_kernel(proven[PHYSICS]))
    with _appearing(folder) as part:
        _write_files(
            part, model, proto, {**texts, **_kernel_texts(flown[KERNEL]), **_tick_texts(model, here, proven)}, parity
        )
        (part / TICKS).write_bytes(record_ticks(solvers))
        if model.moment is not None and model.network is not None:
            (part / LAST_LAYER).write_bytes(last_layer_file(model.moment, body=model.network.outputs == "body"))
        for name, recipe in flown.items():
            shutil.copyfile(build_kernel(recipe, compiler), part / name)
        manifest = with_digest(_manifest(model, options, part))
        content = msgspec.json.format(msgspec.json.encode(manifest), indent=1) + b"\n"
        (part / MANIFEST).write_bytes(content)
    _approve(hashlib.sha256(content).hexdigest(), folder)
    return Exported(folder, manifest, parity)


def _approve(sha256: str, folder: Path) -> None:
    """Approve a bundle that was compiled here; where the list cannot be kept, for this process alone."""
    approve_here([("bundle", sha256)])
    with suppress(RequestError):
        approve([("bundle", sha256, str(folder.resolve()))])


def _kernels(model: ExportedModel, options: ExportOptions) -> dict[str, KernelRecipe]:
    """Of a bundle's kernels, by file name."""
    kernels = {KERNEL: _kernel_recipe(model, options, "float")}
    if model.network is not None:
        kernels[PHYSICS] = _physics_recipe(build_model(model.vehicle), options)
    return kernels


def _compile(recipes: Sequence[KernelRecipe], texts: dict[str, str]) -> None:
    """Compile all machine code of a bundle into the cache, several files at a time: this is most of an export."""
    with ThreadPoolExecutor() as pool:
        files = pool.submit(build_c_files, texts)
        list(pool.map(build_kernel, recipes))
        files.result()


def _require_free(folder: Path, options: ExportOptions) -> None:
    """Raises RequestError for a folder that must not be overwritten."""
    if not folder.exists():
        return
    if not options.overwrite:
        raise RequestError(f"{folder} exists already. Give another --out, or --overwrite.")
    if not (folder / MANIFEST).is_file():
        raise RequestError(f"{folder} exists already and is no bundle, so it is not overwritten. Give another --out.")


@contextmanager
def _appearing(folder: Path) -> Iterator[Path]:
    """A folder under a temporary name, renamed when the block succeeds and deleted when it fails.

    Raises RequestError when it cannot be written.
    """
    part: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        yield part
        part.chmod(0o755)
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(part, folder)
    except OSError as error:
        raise RequestError(f"cannot write {folder}: {error}. Free some space or give another --out.") from error
    finally:
        if part is not None:
            shutil.rmtree(part, ignore_errors=True)


def _kernel_recipe(model: ExportedModel, options: ExportOptions, precision: Precision) -> KernelRecipe:
    if model.network is None:
        return _physics_recipe(model.flight_model, options)
    if model.integrator == "rk4":
        return _physics_recipe(model.flight_model, options, field_function(model))
    return kernel_recipe(
        model.network,
        model.flight_model,
        options.problem,
        options.processor,
        precision,
        mean=model.mean,
        extrapolated=model.extrapolated,
        ensemble=model.ensemble,
    )


def _physics_recipe(model: Model, options: ExportOptions, field: ca.Function | None = None) -> KernelRecipe:
    """The solver of a model that RK4 integrates. field: instead of the model's own."""
    sources, flags = solver_recipe(model, options.problem, options.processor, field)
    return KernelRecipe(sources, flags, "rti.c")


def _prove(
    model: ExportedModel,
    options: ExportOptions,
    proto: bytes,
    texts: dict[str, str],
    single: RtiSolver,
    double_kernel: Path,
) -> Parity:
    double = RtiSolver(model.flight_model, options.problem, double_kernel)
    backends = Backends(
        model,
        proto,
        model_function(model),
        jacobian_function(model),
        weighted_function(model),
        compiled(model, texts),
        single,
        double,
    )
    windows: dict[str, Floats] = {}
    if options.logs:
        windows["recorded"] = recorded_windows(model, options.logs, options.windows, options.seed)
    else:
        windows["reference"] = reference_windows(model, options.windows, options.seed)
    windows["random"] = random_windows(model, options.windows, options.seed)
    return prove(backends, windows, options.seed)


def _kernel_texts(recipe: KernelRecipe) -> dict[str, str]:
    """The kernel's sources, and the command that compiles them, to rebuild or read them."""
    command = f"cc {' '.join(recipe.flags)} {recipe.entry} -o kernel.so -lm\n"
    texts = {**recipe.sources, "BUILD": command}
    return {f"{SOURCES}/{name}": text for name, text in texts.items()}


def _tick_texts(model: ExportedModel, options: ExportOptions, kernels: Mapping[str, KernelRecipe]) -> dict[str, str]:
    """The tick in C for the solver without a network: beside one, of the vehicle file's model."""
    name, flown = (KERNEL, model.flight_model) if model.network is None else (PHYSICS, build_model(model.vehicle))
    texts = tick_files(flown, options.problem, build_kernel(kernels[name]), name)
    return {f"{FOLDER}/{file}": text for file, text in texts.items()}


def _write_files(part: Path, model: ExportedModel, proto: bytes, texts: Mapping[str, str], parity: Parity) -> None:
    (part / SOURCES).mkdir()
    (part / FOLDER).mkdir()
    for name, text in {**texts, **_vehicle_texts(model)}.items():
        (part / name).write_bytes(text.encode())
    (part / ONNX).write_bytes(proto)
    (part / PARITY).write_bytes(msgspec.json.format(msgspec.json.encode(parity), indent=1) + b"\n")


def _vehicle_texts(model: ExportedModel) -> dict[str, str]:
    """The vehicle file, and beside it the effect files that it names, by name.

    Raises RequestError where two of these have one name.
    """
    files = model.vehicle.effect_files
    if not files:
        return {VEHICLE: model.vehicle_text}
    names = [file.name for file in files]
    if len(set(names)) < len(names):
        raise RequestError(f"two effect files have one name ({', '.join(names)}). Rename one of them.")
    document = editable_toml(model.vehicle_text)
    document.pop(KEY, None)
    document[KEY] = names
    return {VEHICLE: tomlkit.dumps(document)} | {file.name: file.text for file in files}


def _manifest(model: ExportedModel, options: ExportOptions, part: Path) -> Manifest:
    config = model.config
    files = {
        str(path.relative_to(part)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(part.rglob("*"))
        if path.is_file()
    }
    size = RIGID_BODY_STATES + config.rotors
    shapes: dict[str, tuple[int | str, ...]] = {
        "history": ("batch", size, model.history),
        "acceleration": ("batch", 6),
    }
    if model.hidden_count:
        shapes |= {"hidden": ("batch", model.hidden_count), "hidden_rate": ("batch", model.hidden_count)}
    if model.ensemble is not None:
        shapes["uncertainty"] = ("batch", 1)
    return Manifest(
        kind=config.kind,
        learned=model.network is not None,
        physics={"none": "none", "nominal": "nominal", "grey_box": "vehicle"}[config.base],  # type: ignore[arg-type]
        motors=config.motors,
        label=config.label,
        filtered_inputs=config.filtered_inputs,
        integrator=model.integrator,
        rotors=config.rotors,
        history=model.history,
        dt=config.dt,
        frame=config.inputs,
        ranges=_ranges(model),
        errors=_errors(model),
        members=len(model.trained.networks) if model.ensemble is not None and model.trained is not None else 1,
        fades=model.ensemble is not None and model.ensemble.fades,
        shapes=shapes,
        units=dict(zip(column_names(config.rotors), column_units(config.rotors), strict=True)),
        problem=options.problem,
        kernel_facts=kernel_facts(model.flight_model),
        vehicle_facts=kernel_facts(build_model(model.vehicle)),
        processor=options.processor.name,
        precision="double" if model.integrator == "rk4" else "float",
        files=files,
        command=options.command,
        date=datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        versions={name: metadata.version(name) for name in LIBRARIES},
        provenance=_provenance(model, options),
        notes=cautions(config, model.integrator),
    )


def _ranges(model: ExportedModel) -> tuple[InputRange, ...]:
    """The inputs' ranges in training."""
    if model.trained is None or model.network is None:
        return ()
    names, ranges = model.config.input_names, model.trained.ranges
    return tuple(
        InputRange(name, _unit(name), float(low), float(high))
        for name, low, high in zip(names, ranges.lowest, ranges.highest, strict=True)
    )


def _unit(name: str) -> str:
    if name.startswith("velocity"):
        return "m/s"
    return "rad/s" if name.startswith(("rate", "motor")) else "1"


def _errors(model: ExportedModel) -> dict[str, float]:
    """Errors on the validation flights, all rows counting alike."""
    errors = () if model.trained is None else model.trained.card.errors
    rows = sum(error.rows for error in errors)
    return {
        name: float((sum(error.rows * getattr(error, name) ** 2 for error in errors) / rows) ** 0.5)
        for name in (("linear", "angular", "combined", "nominal") if rows else ())
    }


def _provenance(model: ExportedModel, options: ExportOptions) -> dict[str, str]:
    provenance = {
        VERSION_KEY: __version__,
        "vehicle_sha256": hashlib.sha256(model.vehicle_text.encode()).hexdigest(),
        "windows": ", ".join(map(str, options.logs)) or "the paper's references",
        "seed": str(options.seed),
        "opset": str(OPSET),
    }
    if model.source:
        provenance["model_sha256"] = model.source
    if model.trained is not None:
        card = model.trained.card
        provenance |= {
            "trained": card.date,
            "training": card.command,
            "member": f"{model.member} of {len(model.trained.networks)}",
            "seeds": ", ".join(map(str, card.seeds)),
            "recipe": card.recipe.name,
            "flights_sha256": hashlib.sha256(repr(sorted(card.flights.items())).encode()).hexdigest(),
        }
    return provenance


def _onnx_metadata(model: ExportedModel, options: ExportOptions) -> dict[str, str]:
    config = model.config
    names, units = column_names(config.rotors), column_units(config.rotors)
    metadata = {
        "kind": config.kind,
        "history": "columns oldest first; rows: " + ", ".join(f"{n} [{u}]" for n, u in zip(names, units, strict=True)),
        "acceleration": "world x, y, z [m/s^2], body angular x, y, z [rad/s^2]; "
        + ("mean over the next dt" if model.mean else "at the newest column"),
        "T": str(model.history),
        "dt": repr(config.dt),
        "vehicle": model.vehicle.name,
        "command": options.command,
    }
    if model.hidden_count:
        metadata["hidden"] = "of the physics, in hover: " + ", ".join(
            map(repr, model.flight_model.hidden_initial.tolist())
        )
    return metadata | _provenance(model, options)


def summary(exported: Exported) -> Sequence[str]:
    """Lines for the terminal: what was compared and how well it agrees."""
    manifest = exported.manifest
    head = f"{exported.folder}: {manifest.kind}, {manifest.integrator}, kernel for {manifest.processor}"
    compared = (
        f"  {c.backend} against {c.against}, {c.count} {c.windows} windows: {c.error:.1e} (<= {c.tolerance:g})"
        for c in exported.parity.comparisons
    )
    if manifest.processor not in {processor.name for processor in PROCESSORS.values() if processor.runs_here}:
        head += ", compared here by one for this processor; run `alula export --verify` where it flies"
    return [head, *compared, *(f"note: {note}" for note in exported.manifest.notes)]
