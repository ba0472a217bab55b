"""Compiler and HPIPM for a processor: this machine's, or for a kernel that another computer will fly.

HPIPM for another machine comes out of CasADi's wheel for it, fetched once by pip into the cache, or from the folder
that $ALULA_HPIPM_AARCH64 names, with include/ and lib/ as in $ALULA_HPIPM.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from dynamics.codegen import cache_folder, find_compiler
from dynamics.errors import RequestError
from runtime.control.rti.hpipm import HPIPM, HpipmBuild, casadi_hpipm, find_hpipm, hpipm_in, libraries_in
from runtime.control.rti.processor import Processor

CROSS_COMPILERS = {"aarch64": ("aarch64-linux-gnu-gcc", "Debian's gcc-aarch64-linux-gnu")}  # and what brings it
TIMEOUT = 300.0  # s, of pip


@dataclass(frozen=True)
class Toolchain:
    """Compiler and linker of kernels."""

    compiler: str
    hpipm: HpipmBuild


def toolchain_for(processor: Processor) -> Toolchain:
    """Compiler and HPIPM for a processor. Raises RequestError when one is missing, with what to install."""
    if processor.machine == platform.machine():
        return Toolchain(find_compiler(), find_hpipm())
    return Toolchain(_cross_compiler(processor), _foreign_hpipm(processor.machine))


def _cross_compiler(processor: Processor) -> str:
    name, package = CROSS_COMPILERS.get(processor.machine, ("", ""))
    if path := shutil.which(name):
        return path
    advice = f"{name}: install {package}, or" if name else "a cross compiler that Alula does not know:"
    raise RequestError(
        f"a kernel for {processor.name} ({processor.machine}) needs, on this {platform.machine()}, {advice} export the "
        "model on that computer."
    )


def _foreign_hpipm(machine: str) -> HpipmBuild:
    variable = f"ALULA_HPIPM_{machine.upper()}"
    if chosen := os.environ.get(variable):
        return hpipm_in(Path(chosen), variable)
    version = metadata.version("casadi")
    folder = cache_folder() / f"hpipm-casadi-{version}-{machine}"
    if libraries_in(folder) is None:
        _fetch(version, machine, folder, variable)
    libraries, own = libraries_in(folder), casadi_hpipm()
    assert libraries is not None
    return HpipmBuild(own.includes, libraries[1], libraries[0])


def _fetch(version: str, machine: str, folder: Path, variable: str) -> None:
    """Put the libraries of CasADi's wheel for a machine into a folder."""
    with tempfile.TemporaryDirectory(prefix="alula-") as temporary:
        options = ["--no-deps", "--only-binary=:all:", f"--platform=manylinux2014_{machine}", f"--dest={temporary}"]
        command = [sys.executable, "-P", "-m", "pip", "download", "--quiet", *options, f"casadi=={version}"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
            wheels = list(Path(temporary).glob("*.whl"))
        except subprocess.TimeoutExpired:
            done, wheels = None, []
        if not wheels:
            reason = "pip took too long" if done is None else done.stderr.strip().rpartition("\n")[2]
            raise RequestError(
                f"HPIPM for {machine} could not be fetched: {reason}. Run `{' '.join(command[:4])} ...` where there is "
                f"a network, or name a folder with include/ and lib/ of an HPIPM for {machine} in {variable}."
            )
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f"{folder.name}-", dir=folder.parent))
        with zipfile.ZipFile(wheels[0]) as wheel:
            for name in (HPIPM, "libblasfeo.so.0"):
                (part / name).write_bytes(wheel.read(f"casadi/{name}"))
        shutil.rmtree(folder, ignore_errors=True)
        os.replace(part, folder)
