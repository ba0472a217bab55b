"""The C compiler for a processor: this machine's, or a cross compiler for a kernel that another computer will fly."""

from __future__ import annotations

import platform
import shutil

from dynamics.codegen import find_compiler
from dynamics.errors import RequestError
from runtime.control.rti.processor import Processor

CROSS_COMPILERS = {"aarch64": ("aarch64-linux-gnu-gcc", "Debian's gcc-aarch64-linux-gnu")}  # and what brings it


def compiler_for(processor: Processor) -> str:
    """The compiler for a processor. Raises RequestError where it is missing, with what to install."""
    if processor.machine == platform.machine():
        return find_compiler()
    name, package = CROSS_COMPILERS.get(processor.machine, ("", ""))
    if path := shutil.which(name):
        return path
    advice = f"{name}: install {package}, or" if name else "a cross compiler that Alula does not know:"
    raise RequestError(
        f"a kernel for {processor.name} ({processor.machine}) needs, on this {platform.machine()}, {advice} export the "
        "model on that computer."
    )
