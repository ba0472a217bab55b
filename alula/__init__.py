"""Alula makes a quadrotor's flight model true and flies with it.

What needs the desk's packages (`alula[workbench]`) is imported when it is first asked for, so that a flight computer
with the base install can import this package.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dynamics.errors import RequestError
from dynamics.version import __version__

if TYPE_CHECKING:
    from flights import Flight, read_folder, read_log

__all__ = ["Flight", "__version__", "read_folder", "read_log"]

_HOMES: Mapping[str, str] = {"Flight": "flights", "read_folder": "flights", "read_log": "flights"}


def __getattr__(name: str) -> Any:
    """What lives in another room, imported now. Raises RequestError where the desk's packages are not installed."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(importlib.import_module(_HOMES[name]), name)
    except ModuleNotFoundError as error:
        raise RequestError(
            f"alula.{name} needs the package {error.name}, which the base install lacks: "
            "python -m pip install 'alula[workbench]'."
        ) from error
