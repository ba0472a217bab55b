"""Flights of the demo's manoeuvres on the mock: in simulated time, or over a link against the clock."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec

from dynamics.errors import RequestError, VehicleError
from dynamics.references import named_reference
from dynamics.vehicle_file import find_vehicle, read_vehicle
from runtime.control.controller import Controller
from runtime.daemon import Daemon
from runtime.flight.composition import Controllers
from runtime.flight.health import HealthLimits
from runtime.flight.mission import Plan
from runtime.flight_request import FlightReport
from runtime.flight_setup import FlightSetup, PreparedFlight, prepare_flight
from simulation.daemon_flight import EPOCH, fly_in_simulated_time
from simulation.mock_process import mock_process
from simulation.starvation import StarvationMeter
from sitl_mock.mock import MockOptions
from studies.demo.result import FlownManoeuvre
from studies.paper import TRACKING_LEARNED, TRACKING_NOMINAL

Announce = Callable[[str], None]
# on the way to and from a manoeuvre
BRISK = Plan(height=1.2, speed=2.5, acceleration=3.0, settle=0.5, descent=1.0, origin="takeoff")
PX4_HEIGHT = 2.5  # m, of the lowest point on an estimate whose height is a metre off (benchmarks landing start_height)
FINDING_PATIENCE = 30.0  # s for the vehicle's first heartbeat
NOWHERE = "udpin:127.0.0.1:14540"  # the link in a recording of a flight without one
STARVED = HealthLimits().stale  # s without the processor from which on the flight logic misses estimates
NOMINAL, LEARNED = "nominal", "learned"  # the model of a flight, part of its file name
OWN_RECORDING = re.compile(rf"\d{{8}}-\d{{6}}_({NOMINAL}|{LEARNED})_")
PAPER: Mapping[str, Mapping[str, tuple[float, float]]] = {NOMINAL: TRACKING_NOMINAL, LEARNED: TRACKING_LEARNED}


class DemoOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of the demo.

    folder: for output.
    effects: hidden from the controller.
    duration: of each manoeuvre, s.
    rate: of control, Hz.
    realtime: fly over a link against the clock, not in simulated time.
    learn: whether to continue after the flights with the nominal model.
    jobs: processes that fly in simulated time.
    """

    folder: Path
    vehicle: str = "arpl_250g"
    effects: tuple[str, ...] = ("rotor_drag:coefficient=2.2e-5", "parasitic_drag:coefficient=0.01")
    manoeuvres: tuple[str, ...] = ("Ellipse_2", "WarpedEllipse_2", "Lemniscate")
    duration: float = 10.0
    rate: float = 100.0
    seed: int = 1
    realtime: bool = False
    learn: bool = True
    jobs: int = 2


class FlightTask(msgspec.Struct, frozen=True):
    """One flight of the demo in simulated time.

    manoeuvre: its name.
    vehicle: the controller's file.
    model: NOMINAL or LEARNED, the kind of that file.
    file: name of the recording; empty for the flight on PX4's estimate, which has none.
    """

    options: DemoOptions
    manoeuvre: str
    vehicle: str
    model: str
    file: str = ""

    @property
    def title(self) -> str:
        """The flight in words."""
        return f"{self.manoeuvre}, {self.model}{'' if self.file else ', PX4 estimate'}"


class TaskOutcome(msgspec.Struct, frozen=True):
    """The outcome of a task.

    flown: of a flight with a recording.
    px4_rmse: of a flight on PX4's estimate.
    lines: that the flight announced.
    error: why it did not end as it should, empty if it did.
    """

    flown: FlownManoeuvre | None = None
    px4_rmse: float | None = None
    lines: tuple[str, ...] = ()
    error: str = ""


def tasks_of(options: DemoOptions, vehicle: str, model: str, stamp: str) -> list[FlightTask]:
    """The flights in simulated time with one model: the manoeuvres, and the same on PX4's estimate.

    stamp: date and time of the demo, for the recordings' names.
    """
    tasks = []
    if not options.realtime:
        for number, name in enumerate(options.manoeuvres):
            file = recording_name(stamp, model, number, name)
            tasks.append(FlightTask(options, name, vehicle, model, file))
    return tasks + [FlightTask(options, name, vehicle, model) for name in options.manoeuvres]


def fly_task(task: FlightTask) -> TaskOutcome:
    """Fly one task, in any process. An error of the vehicle is part of the outcome: which one counts is not chance."""
    options, name = task.options, task.manoeuvre
    if not task.file:
        return TaskOutcome(px4_rmse=rmse_on_px4_estimate(name, task.vehicle, options))
    lines: list[str] = []
    mock = MockOptions(find_vehicle(options.vehicle), effects=options.effects, seed=options.seed, epoch=EPOCH)
    try:
        flight = _prepared(name, task.vehicle, task.model, NOWHERE, options, task.file)
        report = fly_in_simulated_time(flight, mock, lines.append)
        flown = _flown(name, task.model, flight, report, options)
    except VehicleError as error:
        return TaskOutcome(lines=tuple(lines), error=str(error))
    return TaskOutcome(flown=flown, lines=tuple(lines))


def fly_over_link(
    options: DemoOptions,
    vehicle: str,
    model: str,
    stamp: str,
    announce: Announce,
    started: Callable[[str, float], None],
) -> list[FlownManoeuvre]:
    """Every manoeuvre against the clock, on a vehicle with a full battery.

    started: called with the title of each flight as it begins, and the share of flights before it.

    Raises VehicleError for the first flight that does not end as it should; where the host withheld the processors, for
    that alone.
    """
    hidden = [part for text in options.effects for part in ("--effect", text)]
    flown = []
    with naming_starvation(), mock_process(*hidden, "--seed", str(options.seed), vehicle=options.vehicle) as mock:
        for number, name in enumerate(options.manoeuvres):
            started(f"{name}, {model}", number / len(options.manoeuvres))
            file = recording_name(stamp, model, number, name)
            flight = _prepared(name, vehicle, model, mock.url, options, file)
            report = Daemon(flight.request, flight.vehicle, flight.reference, announce).fly()
            flown.append(_flown(name, model, flight, report, options))
    return flown


@contextmanager
def naming_starvation(meter: StarvationMeter | None = None) -> Iterator[None]:
    """Where the host withheld the processors, that is the error in place of any other: such a flight shows nothing."""
    meter, start = meter or StarvationMeter(), time.monotonic()
    meter.start()
    try:
        yield
    except VehicleError as error:
        starvation = meter.since(start)
        if starvation.longest < STARVED:
            raise
        raise VehicleError(
            f"this machine was too busy for a flight in real time: {starvation}. Run it again when other programs take "
            "less, or without --realtime."
        ) from error
    finally:
        meter.stop()


def _prepared(name: str, vehicle: str, model: str, link: str, options: DemoOptions, file: str) -> PreparedFlight:
    setup = FlightSetup(
        link=link,
        reference=name,
        vehicle=vehicle,
        duration=options.duration,
        rate=options.rate,
        record=_recordings(options),
        timeout=FINDING_PATIENCE,
    )
    # the identified model may call a manoeuvre infeasible that has just been flown
    flight = prepare_flight(setup, flown_before=model == LEARNED)
    plan = msgspec.structs.replace(BRISK, duration=options.duration)
    return msgspec.structs.replace(flight, request=msgspec.structs.replace(flight.request, name=file, plan=plan))


def _flown(name: str, model: str, flight: PreparedFlight, report: FlightReport, options: DemoOptions) -> FlownManoeuvre:
    """The figures of a flight. Raises VehicleError for one that did not end as it should."""
    if not report.landed or report.landing_reason or not report.tracking.samples:
        why = f"{report.outcome} {report.landing_reason}".strip()
        hidden = ", ".join(options.effects) or "nothing"
        raise VehicleError(
            f"the flight of {name} with the {model} model ended early: {why}. The vehicle hides {hidden}. Hide less, "
            "or name gentler manoeuvres with --manoeuvre."
        )
    tracking = report.tracking
    errors = (tracking.speed_max, tracking.position_rmse, tracking.position_max)
    return FlownManoeuvre(name, *errors, _paper(flight.reference.name, model), report.recording or "")


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
        named_reference(clear_of_the_ground(name), model, duration=options.duration),
        plan=msgspec.structs.replace(BRISK, duration=options.duration, height=PX4_HEIGHT),
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


def recording_name(stamp: str, model: str, number: int, manoeuvre: str) -> str:
    """Date and time of the demo, model, number and manoeuvre, without characters that a file name cannot have.

    number: the manoeuvre's place, which keeps apart those that are flown twice.
    """
    plain = "".join(sign if sign.isalnum() or sign in "-._" else "_" for sign in manoeuvre)
    return f"{stamp}_{model}_{number + 1}_{plain}"


def first_error(outcomes: Sequence[TaskOutcome]) -> str:
    """The error of the first task that has one, whichever was finished first; empty without any."""
    return next((outcome.error for outcome in outcomes if outcome.error), "")
