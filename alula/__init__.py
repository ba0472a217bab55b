"""Alula identifies what a quadrotor's dynamics model is missing, and flies the better model.

    import alula
    vehicle = alula.load_vehicle("arpl_250g")
    print(alula.diagnose(alula.read_flights("logs"), vehicle).sentence)

Everything is imported when it is first used: importing this package takes milliseconds and needs nothing else, and a
flight computer with the base install can fly. `docs/api.md` describes every function.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from alula.rooms import require_own_rooms

if TYPE_CHECKING:
    from alula.api.diagnosis import add_effect, add_from_flight, compare, compare_hover, diagnose, prove
    from alula.api.fleet import diagnose_fleet
    from alula.api.flights import assess_health, describe_effects, inspect, load_vehicle, read_flight, read_flights
    from alula.api.flying import fly, simulate, verify
    from alula.api.learning import evaluate, export, train
    from alula.api.planning import plan_flight
    from alula.api.trusting import trust
    from alula.api.vehicles import check_vehicle, new_vehicle, vehicle_from_logs
    from dynamics.effect import Effect
    from dynamics.errors import AlulaError, DataError, RequestError, VehicleError
    from dynamics.vehicle import EffectUse, Vehicle
    from dynamics.vehicle_file import write_vehicle
    from dynamics.version import __version__
    from flights import Flight, Log, read_folder, read_log

__all__ = [
    "AlulaError",
    "DataError",
    "Effect",
    "EffectUse",
    "Flight",
    "Log",
    "RequestError",
    "Vehicle",
    "VehicleError",
    "__version__",
    "add_effect",
    "add_from_flight",
    "assess_health",
    "check_vehicle",
    "compare",
    "compare_hover",
    "describe_effects",
    "diagnose",
    "diagnose_fleet",
    "evaluate",
    "export",
    "fly",
    "inspect",
    "load_vehicle",
    "new_vehicle",
    "plan_flight",
    "prove",
    "read_flight",
    "read_flights",
    "read_folder",
    "read_log",
    "simulate",
    "train",
    "trust",
    "vehicle_from_logs",
    "verify",
    "write_vehicle",
]

_HOMES: Mapping[str, tuple[str, ...]] = {
    "alula.api.diagnosis": ("add_effect", "add_from_flight", "compare", "compare_hover", "diagnose", "prove"),
    "alula.api.fleet": ("diagnose_fleet",),
    "alula.api.flights": (
        "assess_health",
        "describe_effects",
        "inspect",
        "load_vehicle",
        "read_flight",
        "read_flights",
    ),
    "alula.api.flying": ("fly", "simulate", "verify"),
    "alula.api.learning": ("evaluate", "export", "train"),
    "alula.api.planning": ("plan_flight",),
    "alula.api.trusting": ("trust",),
    "alula.api.vehicles": ("check_vehicle", "new_vehicle", "vehicle_from_logs"),
    "dynamics.effect": ("Effect",),
    "dynamics.errors": ("AlulaError", "DataError", "RequestError", "VehicleError"),
    "dynamics.vehicle": ("EffectUse", "Vehicle"),
    "dynamics.vehicle_file": ("write_vehicle",),
    "dynamics.version": ("__version__",),
    "flights": ("Flight", "Log", "read_folder", "read_log"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

if getattr(sys, "argv", [""])[:1] != ["-m"]:  # `python -m alula` takes the working directory off the path first
    require_own_rooms()


def __getattr__(name: str) -> Any:
    """A public name, imported now. Raises RequestError where the workbench's packages are not installed."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from alula.workbench import workbench

    with workbench(f"alula.{name}"):
        value = getattr(importlib.import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
