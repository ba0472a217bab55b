"""Instruction sets that kernels are compiled for, and which of them this processor has."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from dynamics.codegen import FLAGS
from dynamics.errors import RequestError
from dynamics.spelling import unknown


@dataclass(frozen=True)
class Processor:
    """An instruction set.

    machine: as `platform.machine` names it.
    flags: of the compiler.
    vector: bytes of a register.
    needs: flags of /proc/cpuinfo.
    """

    name: str
    machine: str
    flags: tuple[str, ...]
    vector: int
    needs: tuple[str, ...]

    @property
    def compiler_flags(self) -> tuple[str, ...]:
        """The project's flags for code that runs on every such processor."""
        return (*(flag for flag in FLAGS if not flag.startswith("-march")), *self.flags)

    @property
    def runs_here(self) -> bool:
        """Whether this machine's processor has the instructions."""
        return platform.machine() == self.machine and set(self.needs) <= _instructions()


# best first
PROCESSORS = {
    processor.name: processor
    for processor in (
        Processor(
            "avx512", "x86_64", ("-march=x86-64-v4", "-mprefer-vector-width=512"), 64,
            ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"),
        ),
        Processor("avx2", "x86_64", ("-march=x86-64-v3",), 32, ("avx2", "fma", "bmi2")),
        Processor("sse2", "x86_64", ("-march=x86-64",), 16, ("sse2",)),
        Processor("neon", "aarch64", ("-march=armv8-a",), 16, ("asimd",)),
    )
}  # fmt: skip


def native_processor() -> Processor:
    """The best that this machine has. Raises RequestError where there is none."""
    for processor in PROCESSORS.values():
        if processor.runs_here:
            return processor
    raise RequestError(f"no kernel for this processor ({platform.machine()}); supported: {', '.join(PROCESSORS)}.")


def named_processor(name: str) -> Processor:
    """The instruction set of a name; "native" is the best of this machine. Raises RequestError for an unknown name."""
    if name == "native":
        return native_processor()
    if name not in PROCESSORS:
        raise RequestError(f"unknown processor {name!r}{unknown(name, ('native', *PROCESSORS))}")
    return PROCESSORS[name]


@cache
def _instructions() -> frozenset[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return frozenset()
    listed = next((line for line in lines if line.startswith(("flags", "Features"))), ":")
    return frozenset(listed.split(":", 1)[1].split())
