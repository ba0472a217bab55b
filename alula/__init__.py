"""Alula identifies what a quadrotor's dynamics model is missing, and flies the better model.

Everything is imported when it is first used: importing this package takes milliseconds and needs nothing else, and a
flight computer with the base install can fly.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from alula.rooms import ROOMS, require_own_rooms

if TYPE_CHECKING:
    from dynamics.effect import Effect
    from dynamics.errors import AlulaError, DataError, RequestError, VehicleError
    from dynamics.vehicle import EffectUse, Vehicle
    from dynamics.vehicle_file import write_vehicle
    from dynamics.version import __version__
    from flights import Flight, Log, read_folder, read_log

__all__ = [
    "AlulaError", "DataError", "Effect", "EffectUse", "Flight", "Log", "RequestError", "Vehicle", "VehicleError",
    "__version__", "read_folder", "read_log", "write_vehicle",
]  # fmt: skip

_HOMES: Mapping[str, tuple[str, ...]] = {
    "dynamics.effect": ("Effect",),
    "dynamics.errors": ("AlulaError", "DataError", "RequestError", "VehicleError"),
    "dynamics.vehicle": ("EffectUse", "Vehicle"),
    "dynamics.vehicle_file": ("write_vehicle",),
    "dynamics.version": ("__version__",),
    "flights": ("Flight", "Log", "read_folder", "read_log"),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

if getattr(sys, "argv", [""])[:1] != ["-m"]:  # `python -m alula` takes the working directory off the path first
    require_own_rooms()


def __getattr__(name: str) -> Any:
    """A public name, imported now. Raises RequestError where the workbench's packages are not installed."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        value = getattr(importlib.import_module(_HOME_OF[name]), name)
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.split(".")[0] in ("alula", *ROOMS):
            raise
        from dynamics.errors import RequestError

        raise RequestError(
            f"alula.{name} needs the package {error.name}, which the base install lacks: "
            "python -m pip install 'alula[workbench]'."
        ) from error
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
