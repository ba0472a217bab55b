"""The main job end to end on the embedded mock: fly the textbook model on a vehicle that hides an effect.

The mock is a process of its own, the link is UDP, the daemon is the one that flies a vehicle.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from alula.embedded_mock import embedded_mock
from alula.flight_setup import FlightSetup, prepare_flight
from alula.paper import TRACKING_NOMINAL
from dynamics.errors import RequestError, VehicleError
from dynamics.references import named_reference
from dynamics.vehicle_file import parse_effect, read_vehicle
from runtime.daemon import Daemon
from vehicles import vehicle_path

Announce = Callable[[str], None]


class DemoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the demo flies. effects: hidden from the controller. duration: s of each manoeuvre. folder: for output."""

    folder: Path
    vehicle: str = "arpl_250g"
    effects: tuple[str, ...] = ("rotor_drag:coefficient=2.2e-5", "parasitic_drag:coefficient=0.01")
    manoeuvres: tuple[str, ...] = ("Ellipse_2", "WarpedEllipse_2", "Lemniscate")
    duration: float = 20.0
    rate: float = 100.0
    seed: int = 1


class FlownManoeuvre(msgspec.Struct, frozen=True):
    """How one manoeuvre went. Position errors against the reference, m; paper: its nominal model's RMSE, m."""

    name: str
    speed_max: float
    position_rmse: float
    position_max: float
    paper_rmse: float | None
    recording: str


class DemoReport(msgspec.Struct, frozen=True):
    """What the demo measured, and where it wrote it."""

    vehicle: str
    hidden_effects: tuple[str, ...]
    seed: int
    nominal: tuple[FlownManoeuvre, ...]
    files: tuple[str, ...] = ()


def check_options(options: DemoOptions) -> None:
    """Refuse what cannot be flown before anything takes off. Raises RequestError."""
    vehicle = read_vehicle(vehicle_path(options.vehicle))
    for text in options.effects:
        parse_effect(text, vehicle.rotors.count)
    for name in options.manoeuvres:
        named_reference(name, vehicle)
    if not options.manoeuvres:
        raise RequestError("no manoeuvre was given; name at least one, such as Lemniscate.")


def run_demo(options: DemoOptions, announce: Announce, started: Callable[[str], None]) -> DemoReport:
    """Fly every manoeuvre with the textbook model. started: is told the name of each flight as it begins.

    Raises RequestError for options that make no sense, VehicleError when a flight does not end as it should.
    """
    check_options(options)
    flown = []
    hidden = [part for text in options.effects for part in ("--effect", text)]
    with embedded_mock(options.vehicle, [*hidden, "--seed", str(options.seed)]) as link:
        for name in options.manoeuvres:
            started(name)
            flown.append(_fly(name, link, options, announce))
    return DemoReport(options.vehicle, options.effects, options.seed, tuple(flown))


def _plain(name: str) -> str:
    """A reference's name without the signs that a file name cannot have."""
    return "".join(sign if sign.isalnum() or sign in "-._" else "_" for sign in name)


def _fly(name: str, link: str, options: DemoOptions, announce: Announce) -> FlownManoeuvre:
    setup = FlightSetup(
        link=link, reference=name, vehicle=options.vehicle, duration=options.duration, rate=options.rate,
        record=options.folder / "recordings", timeout=30.0,
    )  # fmt: skip
    flight = prepare_flight(setup)
    request = msgspec.structs.replace(flight.request, name=f"{time.strftime('%Y%m%d-%H%M%S')}_nominal_{_plain(name)}")
    report = Daemon(request, flight.vehicle, flight.reference, announce).fly()
    if not report.landed or report.landing_reason or not report.tracking.samples:
        raise VehicleError(f"the flight of {name} ended early: {report.outcome} {report.landing_reason}".strip() + ".")
    tracking = report.tracking
    paper = TRACKING_NOMINAL.get(named_reference(name, flight.vehicle).name)
    return FlownManoeuvre(
        name=name,
        speed_max=tracking.speed_max,
        position_rmse=tracking.position_rmse,
        position_max=tracking.position_max,
        paper_rmse=paper[0] if paper else None,
        recording=report.recording or "",
    )
