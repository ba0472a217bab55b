"""The compiled tick: built once, or the one that came with this install; its structs and functions."""

from __future__ import annotations

import ctypes
import platform
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from dynamics.codegen import build_library, has_compiler
from dynamics.errors import RequestError
from dynamics.trust import load_own_library, with_lock
from runtime.control.rti.state_header import STATE_HEADER, state_header
from runtime.tick.structs import reasons_of, structs_of

ENTRY, HEADER = "receiver.c", "tick.h"
SOURCES = (ENTRY, HEADER, "tick.c", "wire.h", "sha256.h")
# the same bits as Python's path on every processor: no contraction, no instructions beyond the machine's first ones
FLAGS = ("-O2", "-ffp-contract=off", "-fPIC", "-shared", "-pthread", "-Werror=implicit-function-declaration")
LIBRARIES = ("-lm",)
KERNELS = Path(str(resources.files("runtime.control.rti"))) / "kernels"


def tick_sources() -> dict[str, str]:
    """The sources by file name."""
    folder = resources.files("runtime.tick")
    texts = {name: folder.joinpath(name).read_text(encoding="utf-8") for name in SOURCES}
    return {**texts, STATE_HEADER: state_header()}


def prebuilt_tick(folder: Path, machine: str) -> Path:
    """Where the library for a machine, as `platform.machine` names it, is if it was built."""
    return folder / machine / "tick.so"


def build_tick(compiler: str | None = None) -> Path:
    """Path of the library, compiled unless cached. Raises RequestError without a compiler."""
    return build_library(tick_sources(), flags=FLAGS, libraries=LIBRARIES, entry=ENTRY, compiler=compiler)


class TickLibrary:
    """The loaded library.

    structs: of tick.h, by name.
    reasons: why a tick was left to its caller, by number.
    waiting: its functions as they are called without the interpreter's lock, for those that wait or compute.
    short: the same functions with the lock held, for those that take a microsecond.
    """

    def __init__(self, path: Path) -> None:
        """Raises RequestError for a library of another version."""
        sources = tick_sources()
        self.structs = structs_of(sources[HEADER], sources[ENTRY])
        self.reasons = reasons_of(sources[HEADER])
        self.waiting = load_own_library(path)
        self.short = with_lock(self.waiting)
        sizes = (ctypes.c_int32 * len(self.structs))()
        self.short.alula_sizes(sizes)
        if list(sizes) != [ctypes.sizeof(kind) for kind in self.structs.values()]:
            raise RequestError(f"{path} is of another version of Alula. Install Alula again.")
        for library in (self.waiting, self.short):
            _declare(library)


def _declare(library: Any) -> None:
    pointer, number = ctypes.c_void_p, ctypes.c_double
    library.alula_tick.argtypes = (pointer, pointer, ctypes.c_int, number, number, pointer)
    library.alula_read.argtypes = (pointer, pointer, ctypes.c_int, number, pointer)
    library.alula_answer.argtypes = (pointer, number, pointer)
    library.receiver_start.argtypes, library.receiver_start.restype = (ctypes.c_int,), pointer
    for name in ("context", "result"):
        function = getattr(library, f"receiver_{name}")
        function.argtypes, function.restype = (pointer,), pointer
    library.receiver_next.argtypes, library.receiver_next.restype = (pointer, number), pointer
    library.receiver_know.argtypes = (pointer, pointer)
    library.receiver_sequence.restype = ctypes.c_uint32
    for name in ("stop", "free", "waiting", "read", "arm", "claim", "try_claim", "disarm", "sequence"):
        getattr(library, f"receiver_{name}").argtypes = (pointer,)


@cache
def tick_library() -> TickLibrary | None:
    """The library, None where there is neither a compiler nor one that came with this install."""
    if has_compiler():
        return TickLibrary(build_tick())
    path = prebuilt_tick(KERNELS, platform.machine())
    return TickLibrary(path) if path.is_file() else None
