"""Flights of the demo's manoeuvres: over MAVLink on the mock in real time, or in lockstep without a link."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import msgspec
import numpy as np

from dynamics.errors import RequestError, VehicleError
from dynamics.own_effects import catalogue_of
from dynamics.references import check_feasibility, named_reference
from dynamics.vehicle_file import find_vehicle, parse_effect, read_vehicle
from runtime.control.controller import Controller
from runtime.daemon import Daemon
from runtime.flight.composition import Controllers
from runtime.flight.mission import Plan
from runtime.flight_setup import FlightSetup, prepare_flight
from simulation.mock_process import mock_process
from sitl_mock.mock import MockOptions
from studies.demo.result import FlownManoeuvre
from studies.paper import TRACKING_LEARNED, TRACKING_NOMINAL

Announce = Callable[[str], None]
# on the way to and from a manoeuvre
BRISK = Plan(height=1.2, speed=2.5, acceleration=3.0, settle=0.5, descent=1.0, origin="takeoff")
PX4_HEIGHT = 2.5  # m, of the lowest point on an estimate whose height is a metre off (benchmarks/start_height.py)
FINDING_PATIENCE = 30.0  # s for the vehicle's first heartbeat
OVER_LINK, IN_LOCKSTEP = 10.0, 24.0  # s of a manoeuvre by default
NOMINAL, LEARNED = "nominal", "learned"  # the model of a flight, part of its file name
OWN_RECORDING = re.compile(rf"\d{{8}}-\d{{6}}_({NOMINAL}|{LEARNED})_")
PAPER: Mapping[str, Mapping[str, tuple[float, float]]] = {NOMINAL: TRACKING_NOMINAL, LEARNED: TRACKING_LEARNED}


class DemoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the demo.

    folder: for output.
    effects: hidden from the controller.
    duration: s of each manoeuvre; None for as many as diagnosis needs, in lockstep more, because the way to and from
        the manoeuvre is not recorded there.
    rate: of control, Hz.
    lockstep: fly in simulated time, without a link.
    learn: whether to continue after the flights with the nominal model.
    """

    folder: Path
    vehicle: str = "arpl_250g"
    effects: tuple[str, ...] = ("rotor_drag:coefficient=2.2e-5", "parasitic_drag:coefficient=0.01")
    manoeuvres: tuple[str, ...] = ("Ellipse_2", "WarpedEllipse_2", "Lemniscate")
    duration: float | None = None
    rate: float = 100.0
    seed: int = 1
    lockstep: bool = False
    learn: bool = True

    @property
    def seconds(self) -> float:
        """Duration of each manoeuvre, s."""
        if self.duration is not None:
            return self.duration
        return IN_LOCKSTEP if self.lockstep else OVER_LINK


class Pilot(Protocol):
    """Flies one manoeuvre with the model of a vehicle file."""

    def __call__(self, name: str, vehicle: str, model: str) -> FlownManoeuvre:
        """Fly a manoeuvre.

        name: of the manoeuvre.
        vehicle: the controller's file.
        model: NOMINAL or LEARNED, the kind of that file.

        Raises VehicleError when the flight does not end as it should.
        """
        ...


@contextmanager
def pilot(options: DemoOptions, announce: Announce) -> Iterator[Pilot]:
    """The pilot of a simulated vehicle with the hidden effects. Raises VehicleError when the vehicle's process ends."""
    if options.lockstep:
        yield lambda name, vehicle, model: _in_lockstep(name, vehicle, model, options)
        return
    hidden = [part for text in options.effects for part in ("--effect", text)]
    with mock_process(*hidden, "--seed", str(options.seed), vehicle=options.vehicle) as mock:
        yield lambda name, vehicle, model: _over_link(name, vehicle, model, mock.url, options, announce)


def _over_link(
    name: str, vehicle: str, model: str, link: str, options: DemoOptions, announce: Announce
) -> FlownManoeuvre:
    setup = FlightSetup(
        link=link,
        reference=name,
        vehicle=vehicle,
        duration=options.seconds,
        rate=options.rate,
        record=_recordings(options),
        timeout=FINDING_PATIENCE,
    )
    flight = prepare_flight(setup, flown_before=model == LEARNED)
    plan = msgspec.structs.replace(BRISK, duration=options.seconds)
    request = msgspec.structs.replace(flight.request, name=_file_name(name, model), plan=plan)
    report = Daemon(request, flight.vehicle, flight.reference, announce).fly()
    if not report.landed or report.landing_reason or not report.tracking.samples:
        why = f"{report.outcome} {report.landing_reason}".strip()
        raise VehicleError(f"the flight of {name} with the {model} model ended early: {why}. {_too_much(options)}")
    tracking = report.tracking
    errors = (tracking.speed_max, tracking.position_rmse, tracking.position_max)
    return FlownManoeuvre(name, *errors, _paper(flight.reference.name, model), report.recording or "")


def _in_lockstep(name: str, vehicle: str, model: str, options: DemoOptions) -> FlownManoeuvre:
    from flights import Flight
    from simulation.lockstep import fly_reference  # it imports the readers of logs, which a flight computer lacks

    body = read_vehicle(find_vehicle(options.vehicle))
    controller = Controller.build(read_vehicle(find_vehicle(vehicle)))
    reference = named_reference(name, controller.trim, duration=options.seconds)
    if model == NOMINAL:  # the identified model may call a manoeuvre infeasible that has just been flown
        check_feasibility(reference, controller.trim).require()
    effects = [parse_effect(text, body.rotors.count, catalogue=catalogue_of(body)) for text in options.effects]
    flown = fly_reference(body, reference, effects=effects, seed=options.seed, name=name, controller=controller)
    if flown.aborted:
        raise VehicleError(
            f"the flight of {name} with the {model} model ended early: {flown.aborted}. {_too_much(options)}"
        )
    flight = Flight.from_log(flown.log)
    folder = _recordings(options)
    folder.mkdir(parents=True, exist_ok=True)
    path = flight.to_csv(folder / f"{_file_name(name, model)}.csv")
    error = np.linalg.norm(flight["position"] - flight["position_setpoint"], axis=1)  # NaN where a row lacks one
    speed = float(np.nanmax(np.linalg.norm(flight["velocity"], axis=1)))
    errors = (speed, float(np.sqrt(np.nanmean(error**2))), float(np.nanmax(error)))
    return FlownManoeuvre(name, *errors, _paper(reference.name, model), str(path))


def rmse_on_px4_estimate(name: str, vehicle: str, options: DemoOptions) -> float | None:
    """Position RMSE by the estimate of a flight from the ground to the ground in lockstep, m; None if it ended early.

    The demo's own flights have the estimate that suits the vehicle; PX4's own errs by far more (docs/px4.md), by a
    metre in height, so that the manoeuvre is flown higher up unless it says how high.
    name: of the manoeuvre. vehicle: the controller's file.
    """
    from simulation.whole_flight import fly_whole

    model = read_vehicle(find_vehicle(vehicle))
    mock = MockOptions(find_vehicle(options.vehicle), effects=options.effects, estimator="px4", seed=options.seed)
    flight = fly_whole(
        mock,
        named_reference(clear_of_the_ground(name), model, duration=options.seconds),
        plan=msgspec.structs.replace(BRISK, duration=options.seconds, height=PX4_HEIGHT),
        controllers=Controllers(Controller.build(model)),
    )
    return flight.tracking_error(flight.estimate) if flight.landed and not flight.landing_reason else None


def clear_of_the_ground(name: str) -> str:
    """A manoeuvre whose lowest point is `PX4_HEIGHT` up, unless its text gives a height."""
    return name if "height=" in name else f"{name}{',' if ':' in name else ':'}height={PX4_HEIGHT:g}"


def _paper(reference: str, model: str) -> float | None:
    """The paper's RMSE of a reference with its model of this kind, m, if it flew that one."""
    rmse = PAPER[model].get(reference)
    return rmse[0] if rmse else None


def _recordings(options: DemoOptions) -> Path:
    return options.folder / "recordings"


def clear_old_files(options: DemoOptions) -> None:
    """Delete what an earlier demo has left in the folder: its recordings and vehicle files, nothing else.

    Raises RequestError when a file cannot be deleted.
    """
    stem = find_vehicle(options.vehicle).stem
    recordings = (path for path in _recordings(options).glob("*") if OWN_RECORDING.match(path.name))
    try:
        for path in (*recordings, *options.folder.glob(f"{stem}.v*.toml")):
            path.unlink()
    except OSError as error:
        raise RequestError(f"cannot delete an earlier demo's {error.filename}: {error.strerror}.") from None


def _file_name(name: str, model: str) -> str:
    """Date, time, model and the reference's name, without characters that a file name cannot have."""
    plain = "".join(sign if sign.isalnum() or sign in "-._" else "_" for sign in name)
    return f"{time.strftime('%Y%m%d-%H%M%S')}_{model}_{plain}"


def _too_much(options: DemoOptions) -> str:
    hidden = ", ".join(options.effects) or "nothing"
    return (
        f"The vehicle hides {hidden}. Hide less, name gentler manoeuvres with --manoeuvre, or leave the machine more "
        "time."
    )
