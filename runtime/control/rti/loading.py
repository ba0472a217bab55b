"""Loading of a compiled kernel: a bundle's own, once the user has approved it, or one that was compiled here."""

from __future__ import annotations

from pathlib import Path

from dynamics.codegen import is_compiled_here
from dynamics.errors import RequestError
from dynamics.trust import Library, load_given_library, load_own_library


def load_kernel(library: Path, *, own: bool = False) -> Library:
    """A compiled kernel, which needs no library but the C library's own.

    own: whether it is one of this installation's; one that was compiled here is so anyway.

    Raises RequestError when it does not fit this machine, or for a kernel of a bundle that the user has not approved.
    """
    load = load_own_library if own or is_compiled_here(library) else load_given_library
    try:
        return load(library)
    except OSError as error:
        raise RequestError(f"cannot load {library}: {error}. Export the model again on this machine.") from None
