"""The kernel also builds for the computers that ride on vehicles."""

import shutil
import subprocess
from pathlib import Path

import pytest

from dynamics.model import build_model
from dynamics.vehicle import Vehicle
from export.kernel import ENTRY, kernel_recipe
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import PROCESSORS
from tests.support.networks import random_network

COMPILER = shutil.which("aarch64-linux-gnu-gcc")
AARCH64 = 183  # e_machine of an ELF file


@pytest.mark.skipif(COMPILER is None, reason="no aarch64-linux-gnu-gcc; Debian: gcc-aarch64-linux-gnu")
@pytest.mark.parametrize("residual", [False, True], ids=["network", "residual"])
def test_the_kernel_builds_for_aarch64(tmp_path: Path, arpl_250g: Vehicle, residual: bool) -> None:
    network = random_network(residual=residual)
    recipe = kernel_recipe(network, build_model(arpl_250g, effects=[]), Problem(), PROCESSORS["neon"])
    for name, text in recipe.sources.items():
        (tmp_path / name).write_text(text)
    flags = [*recipe.flags, "-Wall", "-Werror"]
    assert COMPILER is not None
    built = subprocess.run(
        [COMPILER, *flags, ENTRY, "-o", "kernel.so"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr[-2000:]
    head = (tmp_path / "kernel.so").read_bytes()[:20]
    assert int.from_bytes(head[18:20], "little") == AARCH64
