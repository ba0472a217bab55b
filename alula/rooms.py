"""The top-level packages beside `alula` (rooms), which a user's own folder or file of the same name can hide.

A room is hidden when Python would import something of its name from elsewhere: from the folder of the script that runs,
from the working directory, from PYTHONPATH. Imports nothing but the standard library.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from importlib import util
from importlib.machinery import ModuleSpec

ROOMS = (
    "diagnosis",
    "dynamics",
    "export",
    "flights",
    "runtime",
    "simulation",
    "sitl_mock",
    "studies",
    "studio",
    "training",
    "vehicles",
)
ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
REQUEST_ERROR = 2  # exit code of dynamics.errors.RequestError, which a hidden `dynamics` would not hold


def leave_working_directory() -> None:
    """Take the working directory off the path where `python -m alula` has put it, unless Alula itself lies there."""
    if not sys.flags.safe_path and sys.path and not _is_same(sys.path[0], ROOT):
        del sys.path[0]


def hidden_rooms() -> Iterator[tuple[str, str]]:
    """(room, place of what hides it) of every room that Python would not import from beside `alula`."""
    for room in ROOMS:
        spec = _spec(room)
        places = [] if spec is None else _places(spec)
        if spec is not None and not any(_is_same(place, os.path.join(ROOT, room)) for place in places):
            yield room, places[0] if places else room


def require_own_rooms() -> None:
    """End with exit code 2 and what to do where a room is hidden. Raises ImportError in an interactive session."""
    hidden = list(hidden_rooms())
    if not hidden:
        return
    lines = [f"{place} hides Alula's own package {room!r}." for room, place in hidden]
    advice = (
        "Rename it, or keep it off Python's path: start in another folder, take it out of PYTHONPATH, or set "
        "PYTHONSAFEPATH=1."
    )
    message = "\n".join([*lines, advice])
    if hasattr(sys, "ps1"):
        raise ImportError(message)
    print(f"alula: {message}", file=sys.stderr)
    raise SystemExit(REQUEST_ERROR)


def _spec(room: str) -> ModuleSpec | None:
    try:
        return util.find_spec(room)
    except ValueError:  # a module in sys.modules without a spec, as tests put there
        return None


def _places(spec: ModuleSpec) -> list[str]:
    """Folders of a package, or the file of a module."""
    return list(spec.submodule_search_locations or ([spec.origin] if spec.origin else []))


def _is_same(first: str, second: str) -> bool:
    return os.path.realpath(first) == os.path.realpath(second)
