"""A bundle agrees with its manifest and with the trained model, and is refused otherwise."""

import hashlib
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import onnx
import onnxruntime
import pytest
import torch

import alula
from dynamics import trust
from dynamics.codegen import find_compiler
from dynamics.errors import DataError, RequestError
from dynamics.model import build_model
from dynamics.trust import approve_here
from dynamics.vehicle import Vehicle
from export.bundle import Exported, ExportOptions, export_bundle
from export.onnx_file import OPSET
from export.parity import Comparison, Parity
from export.trained import exported, read_model
from runtime.control.bundle import MANIFEST, parse_manifest, read_bundle, with_digest
from runtime.control.rti.loading import load_kernel
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import PROCESSORS, native_processor
from runtime.control.rti.solver import RtiSolver
from tests.export.conftest import SHORT
from tests.support.trained import replaced, untrained_model
from training.checkpoint import save
from training.models import KINDS

EXPORT = Callable[[str], Exported]


@pytest.mark.parametrize("kind", ["pi_tcn", "mse_tcn", "grey_box", "nominal"])
def test_every_backend_agrees_with_what_was_trained(export_kind: EXPORT, kind: str) -> None:
    made = export_kind(kind)
    backends = {comparison.backend for comparison in made.parity.comparisons}
    learned = {"torch, double", "torch, float", "kernel, double", "kernel, float", "kernel, float: gradient"}
    assert {"ONNX Runtime, float", "CasADi C, double", "CasADi C, double: Jacobian"} <= backends
    assert (learned <= backends) == (kind != "nominal")
    assert all(comparison.holds for comparison in made.parity.comparisons)
    stored = msgspec.json.decode((made.folder / "parity.json").read_bytes(), type=Parity)
    assert stored == made.parity


def test_a_difference_is_an_error_that_names_it() -> None:
    bad = Comparison("kernel, float", "CasADi interpreted, double", "recorded", 1000, 3e-4, 1e-5)
    with pytest.raises(DataError, match=r"kernel, float differs from CasADi.*recorded.*0\.0003"):
        Parity((bad,)).require()
    with pytest.raises(DataError):
        Parity((msgspec.structs.replace(bad, error=float("nan")),)).require()


def test_weights_that_changed_under_the_export_are_found(lagging: Vehicle, tmp_path: Path) -> None:
    trained = untrained_model(replaced(KINDS["pi_mlp"].config, hidden=(16,)), lagging)
    model = exported(trained)
    with torch.no_grad():
        trained.networks[0].decoder[0].weight += 0.01
    with pytest.raises(DataError, match="torch, double differs"):
        export_bundle(model, tmp_path / "b", ExportOptions(SHORT, native_processor(), windows=20))
    assert list(tmp_path.iterdir()) == []


def test_the_onnx_file_says_what_goes_in_and_out(bundle_folder: Path) -> None:
    proto = onnx.load(bundle_folder / "model.onnx")
    assert [(opset.domain, opset.version) for opset in proto.opset_import] == [("", OPSET)]
    metadata = {entry.key: entry.value for entry in proto.metadata_props}
    assert metadata["T"] == "20"
    assert metadata["dt"] == "0.01"
    assert "rotor_speed_3 [rad/s]" in metadata["history"]
    session = onnxruntime.InferenceSession(bundle_folder / "model.onnx")
    for batch in (1, 7):
        windows = np.random.default_rng(0).normal(size=(batch, 17, 20)).astype(np.float32)
        assert session.run(None, {"history": windows})[0].shape == (batch, 6)


@pytest.mark.parametrize("kind", ["pi_tcn", "grey_box"])
def test_the_c_files_compile_by_themselves_and_their_example_runs(
    export_kind: EXPORT, kind: str, tmp_path: Path
) -> None:
    folder = export_kind(kind).folder
    sources = [str(folder / name) for name in ("example.c", "model.c")]
    subprocess.run([find_compiler(), "-O0", *sources, "-o", str(tmp_path / "example"), "-lm"], check=True)
    printed = subprocess.run([tmp_path / "example"], capture_output=True, text=True, check=True).stdout
    bundle = read_bundle(folder)
    solver = RtiSolver(bundle.model, bundle.manifest.problem, bundle.kernel)
    hover = np.array([*[0.0] * 6, 1.0, *[0.0] * 6, *[bundle.vehicle.hover_speed] * 4])
    solver.history[:] = hover
    expected = solver.accelerations(bundle.model.initial_state(hover[:13]), hover[13:])
    np.testing.assert_allclose([float(line) for line in printed.split()], expected, atol=1e-4)


@pytest.mark.parametrize("kind", ["pi_tcn", "grey_box", "nominal"])
def test_a_bundle_is_read_back_and_its_kernel_solves(export_kind: EXPORT, kind: str) -> None:
    bundle = read_bundle(export_kind(kind).folder)
    solver = RtiSolver(bundle.model, bundle.manifest.problem, bundle.kernel)
    state = bundle.model.initial_state(np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6]))
    solver.reset(state)
    solver.history[:] = [*state[:13], *[bundle.vehicle.hover_speed] * 4]
    solver.state_reference[:], solver.input_reference[:] = state, bundle.vehicle.hover_speed
    assert solver.prepare(state) == 0
    assert solver.feedback(state) in (0, 1)
    assert np.isfinite(solver.inputs).all()
    # the vehicle's file has a lag; a network that learned it has no states of it
    assert [len(state[place]) for place in solver.rotor_speed_places] == [4] * (bundle.model.hidden_count // 4)


def copied(folder: Path, to: Path) -> Path:
    return Path(shutil.copytree(folder, to / "bundle"))


def test_an_edited_file_is_refused(bundle_folder: Path, tmp_path: Path) -> None:
    folder = copied(bundle_folder, tmp_path)
    with (folder / "vehicle.toml").open("a") as file:
        file.write("# heavier\n")
    with pytest.raises(RequestError, match=r"vehicle\.toml is not the file that was exported.*export the model again"):
        read_bundle(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, "Export again"),
        ({"nonsense": 1}, "Export the model again"),
        ({"processor": "neon"}, "built for neon.*--processor"),
        ({"files": {}}, "lists no vehicle.toml"),
        ({"errors": {"linear": 99.0}}, "its digest does not fit"),
    ],
)
def test_an_edited_manifest_is_refused(
    bundle_folder: Path, tmp_path: Path, change: dict[str, object], message: str
) -> None:
    folder = copied(bundle_folder, tmp_path)
    manifest = json.loads((folder / "manifest.json").read_text()) | change
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(RequestError, match=message):
        read_bundle(folder)


def test_a_bundle_of_an_older_alula_is_refused_by_its_version(bundle_folder: Path, tmp_path: Path) -> None:
    folder = copied(bundle_folder, tmp_path)
    manifest = json.loads((folder / "manifest.json").read_text()) | {"version": 4}
    manifest["problem"]["row_iterations"] = 50
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(RequestError, match=r"is alula bundle 4, required is alula bundle 5\. Export again"):
        read_bundle(folder)


def test_a_kernel_needs_no_library_but_the_c_librarys(bundle_folder: Path) -> None:
    assert {path.name for path in bundle_folder.glob("*.so*")} == {"kernel.so", "physics.so"}
    for name in ("kernel.so", "physics.so"):
        read = subprocess.run(["readelf", "-d", name], cwd=bundle_folder, check=True, capture_output=True, text=True)
        needed = set(re.findall(r"\(NEEDED\).*\[(.*)\]", read.stdout))
        assert {library for library in needed if not library.startswith("ld-linux")} <= {"libc.so.6", "libm.so.6"}
        assert "RPATH" not in read.stdout
        assert "RUNPATH" not in read.stdout


def test_a_bundle_of_another_machine_is_refused_until_it_is_approved(
    bundle_folder: Path, tmp_path: Path, nothing_approved: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = copied(bundle_folder, tmp_path)
    with pytest.raises(
        RequestError, match=r"is code that would run as you(.|\n)*kernel\.so(.|\n)*alula trust "
    ) as refusal:
        read_bundle(folder)
    assert hashlib.sha256((folder / "kernel.so").read_bytes()).hexdigest() in str(refusal.value)
    with pytest.raises(RequestError, match="machine code that would run as you"):
        load_kernel(folder / "kernel.so")
    alula.trust(folder)
    shutil.copytree(folder, tmp_path / "moved")
    bundle = read_bundle(tmp_path / "moved")
    assert RtiSolver(bundle.model, bundle.manifest.problem, bundle.kernel)
    with (folder / "kernel.so").open("ab") as file:  # and a manifest that agrees with it
        file.write(b"planted")
    manifest = parse_manifest((folder / MANIFEST).read_bytes())
    files = {**manifest.files, "kernel.so": hashlib.sha256((folder / "kernel.so").read_bytes()).hexdigest()}
    edited = with_digest(msgspec.structs.replace(manifest, files=files))
    (folder / MANIFEST).write_bytes(msgspec.json.encode(edited))
    monkeypatch.setattr(trust, "_approved", set())
    with pytest.raises(RequestError, match="you have not approved it on this machine"):
        read_bundle(folder)


def test_a_missing_file_and_a_folder_that_is_none_are_refused(bundle_folder: Path, tmp_path: Path) -> None:
    folder = copied(bundle_folder, tmp_path)
    (folder / "kernel.so").unlink()
    with pytest.raises(RequestError, match=r"misses .*kernel\.so"):
        read_bundle(folder)
    with pytest.raises(RequestError, match="is no bundle"):
        read_bundle(tmp_path)


def test_an_existing_folder_is_not_overwritten_without_the_option(bundle_folder: Path, lagging: Vehicle) -> None:
    model = exported(untrained_model(KINDS["nominal"].config, lagging))
    with pytest.raises(RequestError, match=r"exists already.*--overwrite"):
        export_bundle(model, bundle_folder, ExportOptions(Problem(), native_processor()))


def test_only_a_bundle_is_overwritten(export_kind: EXPORT, lagging: Vehicle, tmp_path: Path) -> None:
    model = exported(untrained_model(KINDS["nominal"].config, lagging))
    options = ExportOptions(SHORT, native_processor(), windows=20, overwrite=True)
    folder = copied(export_kind("nominal").folder, tmp_path)
    (folder / "kernel.so").write_bytes(b"damaged")
    export_bundle(model, folder, options)
    assert read_bundle(folder).vehicle == lagging
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    with pytest.raises(RequestError, match=r"is no bundle, so it is not overwritten.*another --out"):
        export_bundle(model, tmp_path / "thesis", options)
    assert (tmp_path / "thesis" / "chapter.tex").read_text() == "years of work"


def test_a_place_that_cannot_be_written_is_refused_and_nothing_is_left_of_it(lagging: Vehicle, tmp_path: Path) -> None:
    model = exported(untrained_model(KINDS["nominal"].config, lagging))
    (tmp_path / "file").write_text("")
    with pytest.raises(RequestError, match=r"cannot write .*file/b.*another --out"):
        export_bundle(model, tmp_path / "file" / "b", ExportOptions(SHORT, native_processor(), windows=20))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_an_export_that_ends_half_way_leaves_nothing(
    lagging: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("export.bundle.with_digest", interrupted)
    model = exported(untrained_model(KINDS["nominal"].config, lagging))
    with pytest.raises(KeyboardInterrupt):
        export_bundle(model, tmp_path / "b", ExportOptions(SHORT, native_processor(), windows=20))
    assert list(tmp_path.iterdir()) == []


def test_a_bundle_says_what_it_was_made_from(lagging: Vehicle, tmp_path: Path) -> None:
    save(untrained_model(KINDS["nominal"].config, lagging), tmp_path / "model.pt")
    options = ExportOptions(SHORT, native_processor(), windows=20, command="alula export model.pt")
    made = export_bundle(read_model(tmp_path / "model.pt"), tmp_path / "b", options)
    provenance = made.manifest.provenance
    assert provenance["model_sha256"] == hashlib.sha256((tmp_path / "model.pt").read_bytes()).hexdigest()
    assert provenance["vehicle_sha256"] == made.manifest.files["vehicle.toml"]
    proto = onnx.load(tmp_path / "b" / "model.onnx")
    assert provenance.items() <= {entry.key: entry.value for entry in proto.metadata_props}.items()


def test_weights_that_are_not_finite_are_refused_in_a_file_and_in_memory(lagging: Vehicle, tmp_path: Path) -> None:
    trained = untrained_model(KINDS["pi_tcn"].config, lagging)
    with torch.no_grad():
        trained.networks[0].decoder[2].weight[3, 4] = torch.nan
    save(trained, tmp_path / "model.pt")
    with pytest.raises(RequestError, match=r"model\.pt is a damaged model: weights that are not finite.*train it"):
        read_model(tmp_path / "model.pt")
    with pytest.raises(RequestError, match=r"not finite in dense 1.*Train again"):
        exported(trained)


@pytest.mark.parametrize("part", ["scaling", "ranges"])
def test_scaling_and_ranges_that_are_not_finite_are_refused(lagging: Vehicle, tmp_path: Path, part: str) -> None:
    trained = untrained_model(KINDS["pi_mlp"].config, lagging)
    (trained.scaling.input_std if part == "scaling" else trained.ranges.lowest)[2] = np.nan
    save(trained, tmp_path / "model.pt")
    with pytest.raises(RequestError, match=r"model\.pt is a damaged model: scaling or ranges that are not finite"):
        read_model(tmp_path / "model.pt")


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"channels": 24}, r"model\.pt is a damaged model: weights of another shape than that of its config"),
        ({"dilations": (1, 2, 4, 8)}, r"model\.pt is a damaged model: .*look back 31 columns, the history has 20"),
    ],
)
def test_a_checkpoint_whose_parts_do_not_fit_each_other_is_refused(
    lagging: Vehicle, tmp_path: Path, overrides: dict[str, object], message: str
) -> None:
    path = tmp_path / "model.pt"
    save(untrained_model(KINDS["pi_tcn"].config, lagging), path)
    content = torch.load(path, weights_only=True)
    content["config"] |= overrides
    torch.save(content, path)
    with pytest.raises(RequestError, match=message):
        read_model(path)


def test_a_text_that_calls_itself_a_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "model.pt").write_text("hello")
    with pytest.raises(RequestError, match="no checkpoint, or a damaged one"):
        read_model(tmp_path / "model.pt")


def test_a_member_that_does_not_exist_is_refused(lagging: Vehicle, tmp_path: Path) -> None:
    save(untrained_model(KINDS["pi_mlp"].config, lagging, members=2), tmp_path / "model.pt")
    assert read_model(tmp_path / "model.pt", member=1).member == 1
    with pytest.raises(RequestError, match="has 2 members"):
        read_model(tmp_path / "model.pt", member=2)


def test_nodes_that_are_no_whole_number_of_columns_are_refused(lagging: Vehicle, tmp_path: Path) -> None:
    model = exported(untrained_model(KINDS["pi_mlp"].config, lagging))
    with pytest.raises(RequestError, match="no whole number of the network's steps"):
        export_bundle(model, tmp_path / "b", ExportOptions(Problem(nodes=19), native_processor()))


def test_without_a_compiler_it_says_what_to_install(
    lagging: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = exported(untrained_model(replaced(KINDS["pi_mlp"].config, hidden=(9,)), lagging))
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(RequestError, match="no C compiler"):
        export_bundle(model, tmp_path / "b", ExportOptions(Problem(), PROCESSORS["sse2"]))


def test_a_kernel_that_cannot_be_loaded_is_refused(lagging: Vehicle, tmp_path: Path) -> None:
    (tmp_path / "kernel.so").write_bytes(b"no library")
    approve_here([("library", hashlib.sha256(b"no library").hexdigest())])
    with pytest.raises(RequestError, match="cannot load"):
        RtiSolver(build_model(lagging), Problem(), tmp_path / "kernel.so")


def test_without_a_cross_compiler_it_says_what_to_install(
    lagging: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine = next(processor for processor in PROCESSORS.values() if processor.machine != native_processor().machine)
    monkeypatch.setenv("PATH", str(tmp_path))
    model = exported(untrained_model(KINDS["nominal"].config, lagging))
    with pytest.raises(RequestError, match=r"install Debian's gcc-|that Alula does not know"):
        export_bundle(model, tmp_path / "b", ExportOptions(Problem(), machine))
