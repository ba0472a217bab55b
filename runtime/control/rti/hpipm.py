"""Where HPIPM and BLASFEO are: beside a kernel, in CasADi's own folder, or in a faster build named by $ALULA_HPIPM.

CasADi's wheel carries both with headers, BLASFEO for any processor. $ALULA_HPIPM names a folder with include/ and
lib/ of another build, such as the install/ folder inside acados' wheel, whose BLASFEO is optimised for the processor.
Headers and libraries always come from the same build: their structs differ between versions. A bundle therefore
carries the libraries that its kernel was built against.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from importlib import util
from pathlib import Path

from dynamics import symbolic
from dynamics.codegen import is_compiled_here
from dynamics.errors import RequestError
from dynamics.trust import Library, load_given_library, load_own_library
from dynamics.workbench_install import workbench_install

HPIPM = "libhpipm.so"
BLASFEO = ("libblasfeo.so.0", "libblasfeo.so")  # the first that exists


@dataclass(frozen=True)
class HpipmBuild:
    """Headers and libraries of one build."""

    includes: tuple[Path, ...]
    hpipm: Path
    blasfeo: Path

    @property
    def compiler_flags(self) -> tuple[str, ...]:
        """Flags of the compiler."""
        return tuple(f"-I{folder}" for folder in self.includes)

    @property
    def libraries(self) -> tuple[Path, Path]:
        """In the order in which they are loaded."""
        return self.blasfeo, self.hpipm

    @property
    def linker_flags(self) -> tuple[str, ...]:
        """Flags of the linker; at run time the libraries are loaded from beside the kernel, or from the same folder."""
        path = f"-Wl,--disable-new-dtags,-rpath,$ORIGIN:{self.hpipm.parent}"
        return ("-Wl,--no-as-needed", str(self.hpipm), str(self.blasfeo), path)


def find_hpipm() -> HpipmBuild:
    """The build to use. Raises RequestError when $ALULA_HPIPM names a folder without one, or there is no CasADi."""
    chosen = os.environ.get("ALULA_HPIPM")
    return hpipm_in(Path(chosen), "ALULA_HPIPM") if chosen else casadi_hpipm()


def hpipm_in(root: Path, variable: str) -> HpipmBuild:
    """The build in a folder that an environment variable names. Raises RequestError when there is none."""
    build = _build_in(root / "include", root / "lib")
    if build is None:
        raise RequestError(
            f"{variable} is {root}, but there is no include/ with hpipm_d_dense_qp.h and lib/ with libhpipm.so "
            "and libblasfeo.so in it. Name the folder that holds both, or unset it to use CasADi's."
        )
    return build


def casadi_hpipm() -> HpipmBuild:
    """CasADi's build. Raises RequestError where CasADi is not installed."""
    casadi = util.find_spec("casadi") if symbolic.is_installed() else None
    if casadi is None or casadi.origin is None:
        raise RequestError(
            "compiling a kernel needs CasADi's HPIPM, which the flight computer's install leaves out: "
            f"{workbench_install()}, or `alula export` the model on a workbench and give `--bundle B` here."
        )
    root = Path(casadi.origin).parent
    build = _build_in(root / "include", root)
    if build is None:
        raise RequestError(f"the casadi in {root} has no HPIPM; install casadi >= 3.7 from PyPI or set ALULA_HPIPM.")
    return build


def libraries_in(folder: Path) -> tuple[Path, Path] | None:
    """BLASFEO and HPIPM in a folder, None where one is missing."""
    blasfeo = next((folder / name for name in BLASFEO if (folder / name).exists()), None)
    return (blasfeo, folder / HPIPM) if blasfeo is not None and (folder / HPIPM).exists() else None


def load_kernel(library: Path, *, own: bool = False) -> Library:
    """A compiled kernel, with HPIPM loaded before it: its own from beside it, else this machine's.

    own: whether it is one of this installation's; one that was compiled here is so anyway.

    Raises RequestError when it does not fit this machine, when another HPIPM is loaded in this process already, or for
    a kernel of a bundle that the user has not approved.
    """
    load = load_own_library if own or is_compiled_here(library) else load_given_library
    bundled = libraries_in(library.parent)
    try:
        for dependency in bundled or find_hpipm().libraries:
            _require_same(dependency)
            (load if bundled else load_own_library)(dependency)
        return load(library)
    except OSError as error:
        raise RequestError(f"cannot load {library}: {error}. Export the model again on this machine.") from None


_loaded: dict[str, tuple[Path, str]] = {}  # path and sha256 by the library's name, which a process can load once


def _require_same(library: Path) -> None:
    digest = hashlib.sha256(library.read_bytes()).hexdigest()
    path, before = _loaded.setdefault(library.name.partition(".")[0], (library, digest))
    if before != digest:
        raise RequestError(
            f"{library} is another build than {path}, which this process has loaded already. Use the two kernels in "
            "processes of their own, or export the model again here."
        )


def _build_in(include: Path, library: Path) -> HpipmBuild | None:
    folders = (include, include / "hpipm" / "include", include / "blasfeo" / "include")
    headers = tuple(folder for folder in folders if folder.is_dir())
    libraries = libraries_in(library)
    if libraries is None or not any((h / "hpipm_d_dense_qp.h").exists() for h in headers):
        return None
    return HpipmBuild(headers, libraries[1], libraries[0])
