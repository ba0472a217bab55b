"""A bundle is verified on the computer that flies it: here, and on aarch64 in an emulator, QEMU."""

import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import alula
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import vehicle_toml
from export.bundle import Exported, ExportOptions, export_bundle
from export.compiler import compiler_for
from export.trained import exported, read_model
from runtime.control.bundle import parse_manifest
from runtime.control.kernel_model import KernelModel
from runtime.control.rti.problem import Problem, fill_options
from runtime.control.rti.processor import PROCESSORS, native_processor
from runtime.control.verification import (
    ANSWERS,
    ARGUMENTS,
    TOLERANCES,
    Timing,
    Verification,
    difference,
    read_ticks,
)
from tests.support.trained import replaced, untrained_model
from training.models import KINDS

EXPORT = Callable[[str], Exported]
EMULATOR, SYSROOT = shutil.which("qemu-aarch64"), Path("/usr/aarch64-linux-gnu")
PROGRAM = Path(__file__).parents[1] / "support" / "bundle_program.c"
SHORT = Problem(nodes=5, horizon=0.25)


@pytest.mark.parametrize("kind", ["pi_tcn", "grey_box", "nominal"])
def test_a_bundle_answers_where_it_was_exported_as_at_its_export(export_kind: EXPORT, kind: str) -> None:
    verification = alula.verify(export_kind(kind).folder)
    kernels = {"kernel.so"} if kind == "nominal" else {"kernel.so", "physics.so"}
    assert {agreement.kernel for agreement in verification.agreements} == kernels
    assert all(agreement.error == 0 for agreement in verification.agreements)
    assert verification.ticks >= 6


def test_another_answer_is_found_and_named(export_kind: EXPORT, monkeypatch: pytest.MonkeyPatch) -> None:
    def changed(path: Path) -> dict[str, dict[str, dict[str, np.ndarray]]]:
        ticks = read_ticks(path)
        ticks["kernel.so"]["10"]["hessian"][3, 4] *= 1.01
        return ticks

    monkeypatch.setattr("runtime.control.verification.read_ticks", changed)
    verification = alula.verify(export_kind("nominal").folder)
    assert [agreement.answer for agreement in verification.agreements if not agreement.holds] == ["hessian"]
    with pytest.raises(DataError, match=r"hessian of kernel\.so differ.*Do not fly it"):
        verification.require()


def test_a_computer_that_is_too_slow_is_said() -> None:
    slow = Timing("kernel.so", median=0.006, p99=0.02, longest=0.03, period=0.01)
    with pytest.raises(DataError, match=r"too slow: kernel\.so takes 6\.00 ms.*--nodes"):
        Verification("neon", 6, (), (slow,)).require()


@pytest.fixture(scope="module")
def foreign(arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Bundles for aarch64 of the paper's vehicle, whose limits are soft rows, and of a small network on it."""
    try:
        compiler_for(PROCESSORS["neon"])
    except RequestError as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.mktemp("foreign")

    @cache
    def export(kind: str) -> Path:
        if kind == "vehicle":
            (folder / "v.toml").write_text(vehicle_toml(arpl_250g))
            model = read_model(folder / "v.toml")
        else:
            config = replaced(KINDS[kind].config, channels=8, hidden=(16,))
            model = exported(untrained_model(config, arpl_250g))
        options = ExportOptions(SHORT, PROCESSORS["neon"], windows=10)
        return export_bundle(model, folder / kind, options).folder

    return export


@pytest.mark.skipif(EMULATOR is None or not SYSROOT.exists(), reason="no qemu-aarch64; Debian: qemu-user")
@pytest.mark.parametrize("kind", ["vehicle", "res_tcn"])
def test_a_cross_compiled_bundle_answers_on_its_processor_as_at_its_export(
    foreign: Callable[[str], Path], arpl_250g: Vehicle, kind: str, tmp_path: Path
) -> None:
    bundle = foreign(kind)
    program = tmp_path / "program"
    link = [str(bundle / "kernel.so"), f"-Wl,-rpath,{bundle}", "-o", str(program)]
    compiler = compiler_for(PROCESSORS["neon"])
    subprocess.run([compiler, "-O1", str(PROGRAM), *link], check=True)
    manifest = parse_manifest((bundle / "manifest.json").read_bytes())
    options = fill_options(SHORT, KernelModel.of(arpl_250g, manifest.kernel_facts))
    for tick in read_ticks(bundle / "ticks.npz")["kernel.so"].values():
        stdin = bytes(options) + b"".join(tick[name].tobytes() for name in (*ARGUMENTS, "state"))
        assert EMULATOR is not None
        done = subprocess.run(
            [EMULATOR, "-L", str(SYSROOT), str(program)], input=stdin, capture_output=True, check=False
        )
        assert done.returncode == 0, done.stderr.decode()
        ends = np.cumsum([tick[name].size for name in ANSWERS])
        for name, answer in zip(ANSWERS, np.split(np.frombuffer(done.stdout), ends[:-1]), strict=True):
            assert difference(answer, tick[name].ravel()) <= TOLERANCES[manifest.precision][name], name


def test_a_bundle_for_another_processor_is_refused_with_the_reason(foreign: Callable[[str], Path]) -> None:
    if native_processor().name == "neon":
        pytest.skip("runs here")
    with pytest.raises(RequestError, match=r"built for neon, which this processor does not have.*another computer"):
        alula.verify(foreign("vehicle"))
