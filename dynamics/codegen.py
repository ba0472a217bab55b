"""C from CasADi functions: generated, compiled once, cached by the hash of its sources, flags, compiler and processor.

Two processes that need the same library at the same time wait for one compilation; a library has its name only when
it is complete. Generation and compilation happen at start-up, never in a control tick.
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import os
import platform
import shutil
import stat
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dynamics import symbolic as ca
from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.trust import load_own_library

if TYPE_CHECKING:
    from collections.abc import Iterator

WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
FLAGS = (
    "-O3",
    "-march=native",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fPIC",
    "-shared",
    "-Werror=implicit-function-declaration",
)


def cache_folder() -> Path:
    """The folder of compiled code: $ALULA_CACHE, or alula/ in the user's cache folder."""
    if folder := os.environ.get("ALULA_CACHE"):
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "alula"


def is_compiled_here(library: Path) -> bool:
    """Whether a library is one that `build_library` keeps."""
    return library.parent.resolve() == cache_folder().resolve() and _is_own(library)


def require_own_folder(folder: Path) -> None:
    """Close the cache folder to others. Raises RequestError where it is theirs, who could put code there."""
    status = folder.stat()
    if status.st_uid not in (os.geteuid(), 0):
        raise RequestError(
            f"the folder of compiled code {folder} belongs to another user, who could put code there. Set ALULA_CACHE "
            "to a folder of yours."
        )
    if status.st_mode & WRITABLE_BY_OTHERS and status.st_uid == os.geteuid():
        folder.chmod(0o700)
    elif status.st_mode & WRITABLE_BY_OTHERS:
        raise RequestError(
            f"others may write the folder of compiled code {folder}. Set ALULA_CACHE to a folder of yours."
        )


def _is_own(library: Path) -> bool:
    """Whether a library is there that nobody but this user, or root, can have written."""
    try:
        status = library.lstat()
    except FileNotFoundError:
        return False
    mine = status.st_uid in (os.geteuid(), 0) and not status.st_mode & WRITABLE_BY_OTHERS
    return stat.S_ISREG(status.st_mode) and mine


def generate_c(functions: Sequence[ca.Function]) -> str:
    """C source of CasADi functions, each callable under its name with CasADi's calling convention."""
    generator = ca.CodeGenerator("alula_generated.c", {"with_header": False, "casadi_int": "long long int"})
    for function in functions:
        generator.add(function)
    return str(generator.dump())


def build_library(
    sources: Mapping[str, str],
    *,
    flags: Sequence[str] = FLAGS,
    libraries: Sequence[str] = (),
    entry: str,
    compiler: str | None = None,
) -> Path:
    """Path of a shared library compiled from sources (file name -> text), taken from the cache when it is there.

    entry: the file to compile; the others are for it to include.
    libraries: arguments for the linker.
    compiler: instead of this machine's.

    Raises RequestError when there is no C compiler or it refuses the code.
    """
    compiler = compiler or find_compiler()
    recipe = [_identity(compiler), entry, *flags, *libraries]
    digest = hashlib.sha256(
        "\0".join([*recipe, *(f"{k}\0{v}" for k, v in sorted(sources.items()))]).encode()
    ).hexdigest()
    folder = cache_folder()
    library = folder / f"{Path(entry).stem}-{digest[:24]}.so"
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        require_own_folder(folder)
        if _is_own(library):
            return library
        with _locked(folder / f"{library.name}.lock"):
            if not _is_own(library):
                _compile(compiler, sources, entry, [*flags], [*libraries], library)
    except OSError as error:
        raise RequestError(
            f"cannot write compiled code to {folder}: {error}. Set ALULA_CACHE to another folder."
        ) from error
    return library


def find_compiler() -> str:
    """The C compiler: $CC, or the first of cc, gcc, clang. Raises RequestError when there is none."""
    if path := _compiler():
        return path
    raise RequestError("no C compiler was found (looked for $CC, cc, gcc, clang). Install one, such as Debian's gcc.")


def has_compiler() -> bool:
    """Whether `find_compiler` finds one."""
    return _compiler() is not None


def _compiler() -> str | None:
    names = filter(None, (os.environ.get("CC"), "cc", "gcc", "clang"))
    return next(filter(None, map(shutil.which, names)), None)


@cache
def _identity(compiler: str) -> str:
    """The compiler's version and the processor of -march=native, which decide the machine code as well."""
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False).stdout
    try:
        flags = next(
            line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith(("flags", "Feat"))
        )
    except (OSError, StopIteration):
        flags = platform.processor()
    return f"{version}\0{platform.machine()}\0{flags}"


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _compile(
    compiler: str, sources: Mapping[str, str], entry: str, flags: list[str], libraries: list[str], library: Path
) -> None:
    with tempfile.TemporaryDirectory(prefix="alula-") as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text)
        descriptor, temporary = tempfile.mkstemp(dir=library.parent, suffix=".so.part")
        os.close(descriptor)
        command = [compiler, *flags, entry, "-o", temporary, *libraries, "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            os.unlink(temporary)
            raise RequestError(f"the C compiler refused {entry}: {' '.join(command)}\n{done.stderr[-2000:]}")
        os.chmod(temporary, 0o755)
        os.replace(temporary, library)


class CompiledFunction:
    """A CasADi function as machine code with fixed arrays, so that a call costs one foreign call.

    inputs, outputs: by name, NumPy arrays that the code reads and writes in place; matrices are flattened by column,
    as CasADi stores them. An instance belongs to one thread.
    """

    def __init__(self, function: ca.Function, library: Path) -> None:
        self._code = load_own_library(library)
        self._call = getattr(self._code, function.name())
        self._call.restype = ctypes.c_int
        self.inputs = {function.name_in(i): np.zeros(function.numel_in(i)) for i in range(function.n_in())}
        self.outputs = {function.name_out(i): np.zeros(function.numel_out(i)) for i in range(function.n_out())}
        self._integers = np.zeros(max(1, function.sz_iw()), dtype=np.int64)
        self._work = np.zeros(max(1, function.sz_w()))
        self._arguments = (
            _pointers(list(self.inputs.values()), function.sz_arg()),
            _pointers(list(self.outputs.values()), function.sz_res()),
            ctypes.c_void_p(self._integers.ctypes.data),
            ctypes.c_void_p(self._work.ctypes.data),
            ctypes.c_int(0),
        )

    def run(self) -> None:
        """Evaluate the outputs at the present inputs."""
        self._call(*self._arguments)

    def __call__(self, **inputs: ArrayLike) -> dict[str, Floats]:
        """Set inputs by name (the others keep their values), run, return the outputs; the next call overwrites them."""
        for name, value in inputs.items():
            self.inputs[name][:] = value
        self.run()
        return self.outputs


def compile_functions(functions: Sequence[ca.Function]) -> dict[str, CompiledFunction]:
    """Functions as machine code, by name, out of one cached library.

    Functions must have dense inputs and outputs; a sparse one would be read as if it were dense.
    """
    for function in functions:
        dense = [function.sparsity_in(i).is_dense() for i in range(function.n_in())]
        dense += [function.sparsity_out(i).is_dense() for i in range(function.n_out())]
        if not all(dense):
            raise ValueError(f"{function.name()} has a sparse input or output; make it dense with casadi.densify")
    source = generate_c(functions)
    library = build_library({"functions.c": source}, entry="functions.c")
    return {function.name(): CompiledFunction(function, library) for function in functions}


def _pointers(arrays: Sequence[Floats], count: int) -> ctypes.Array[ctypes.c_void_p]:
    """CasADi's array of argument pointers, with the space behind them that its code works in."""
    addresses = [array.ctypes.data for array in arrays]
    return (ctypes.c_void_p * max(1, count))(*addresses, *([None] * (max(1, count) - len(addresses))))
