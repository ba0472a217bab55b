"""Where HPIPM and BLASFEO are: CasADi's own copies, or a faster build named by $ALULA_HPIPM.

CasADi's wheel carries both with headers, BLASFEO for any processor. $ALULA_HPIPM names a folder with include/ and
lib/ of another build, such as the install/ folder inside acados' wheel, whose BLASFEO is optimised for the processor.
Headers and libraries always come from the same build: their structs differ between versions.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from dynamics.errors import RequestError


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
    def linker_flags(self) -> tuple[str, ...]:
        """Flags of the linker; at run time the libraries are loaded from the same folder."""
        folder = self.hpipm.parent
        return ("-Wl,--no-as-needed", str(self.hpipm), str(self.blasfeo), f"-Wl,--disable-new-dtags,-rpath,{folder}")


def find_hpipm() -> HpipmBuild:
    """The build to use. Raises RequestError when $ALULA_HPIPM names a folder without one."""
    if chosen := os.environ.get("ALULA_HPIPM"):
        root = Path(chosen)
        build = _build_in(root / "include", root / "lib")
        if build is None:
            raise RequestError(
                f"ALULA_HPIPM is {chosen}, but there is no include/ with hpipm_d_dense_qp.h and lib/ with libhpipm.so "
                "and libblasfeo.so in it. Name the folder that holds both, or unset it to use CasADi's."
            )
        return build
    root = Path(ca.__file__).parent
    build = _build_in(root / "include", root)
    if build is None:
        raise RequestError(f"the casadi in {root} has no HPIPM; install casadi >= 3.7 from PyPI or set ALULA_HPIPM.")
    return build


def _build_in(include: Path, library: Path) -> HpipmBuild | None:
    folders = (include, include / "hpipm" / "include", include / "blasfeo" / "include")
    headers = tuple(folder for folder in folders if folder.is_dir())
    hpipm, blasfeo = library / "libhpipm.so", library / "libblasfeo.so.0"
    if not blasfeo.exists():
        blasfeo = library / "libblasfeo.so"
    complete = hpipm.exists() and blasfeo.exists() and any((h / "hpipm_d_dense_qp.h").exists() for h in headers)
    return HpipmBuild(headers, hpipm, blasfeo) if complete else None
