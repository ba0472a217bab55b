"""One flight of Table II: a manoeuvre with one model on the mock that hides what the campaign's vehicle hides."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import VehicleError
from dynamics.references import named_reference
from dynamics.references.campaign import REAL_WORLD
from dynamics.state import POSITION, VELOCITY
from dynamics.state import RATE as RATE_BODY
from dynamics.vehicle_file import find_vehicle, parse_effect, read_vehicle
from flights import Flight, filters
from runtime.control.controller import Controller, ControllerOptions
from runtime.daemon import Daemon
from runtime.flight.composition import build_controllers
from runtime.flight.events import Event
from runtime.flight.phases import Phase
from runtime.flight_setup import FlightSetup, exported_bundle, prepare_flight
from runtime.record.recording import FlightRecording, read_recording
from simulation.lockstep import fly_reference
from simulation.mock_process import mock_process
from simulation.whole_flight import fly_whole
from sitl_mock.mock import MockOptions
from sitl_mock.vehicle.estimator import Estimator
from studies.demo.flights import BRISK, FINDING_PATIENCE
from studies.demo.report import tracked
from training.data.labels import RATE_CUTOFF, VELOCITY_CUTOFF

VEHICLE = "arpl_250g"
DURATION, RAMP = 15.0, 3.0  # s of the reference that are flown, and of its beginning that do not count
RATE = 100.0  # Hz
HEIGHT = 2.0  # m of the lowest point, on an estimate whose height wanders by a metre
PRIORITY, MOCKS_PRIORITY = 50, 30  # of SCHED_FIFO for the control thread and the mock, where it is granted
MAX_REPEATS = 3  # of a flight during which the machine held up the mock's estimates
LINEAR_BINS = np.linspace(0.0, 24.0, 49)  # m/s^2
ANGULAR_BINS = np.linspace(0.0, 96.0, 49)  # rad/s^2
PATH_STEP = 4  # every so many rows of a path are kept


Pace = Literal["link", "lockstep", "mocap", "px4"]


class Run(msgspec.Struct, frozen=True):
    """A flight to be flown.

    pace: over the link; in lockstep from the reference's start; in lockstep from the ground on an estimator's errors.
    path: the model's vehicle file or bundle.
    key: of what the model came from.
    """

    pace: Pace
    model: str
    path: str
    key: str
    manoeuvre: str
    seed: int


class Flown(msgspec.Struct, frozen=True):
    """How it went, from the ramp's end on. ended: why it ended early, empty if it did not.

    Errors m; fallbacks: times that another model than its own flew, and seconds of it, and the events that were raised.
    late: setpoints by whose fault. Peaks and counts: norms of linear (m/s^2) and angular (rad/s^2) acceleration.
    path: (n, 3) flown and reference positions. repeats: flights before this one that the machine disturbed.
    """

    run: Run
    ended: str
    repeats: int = 0
    seconds: float = 0.0
    position_rmse: float = 0.0
    position_max: float = 0.0
    speed_max: float = 0.0
    fallbacks: int = 0
    fallback_seconds: float = 0.0
    events: dict[str, int] = {}
    late: dict[str, int] = {}
    ticks: int = 0
    model_ratio: float | None = None
    peak_linear: float = 0.0
    peak_angular: float = 0.0
    linear: tuple[int, ...] = ()
    angular: tuple[int, ...] = ()
    path: tuple[tuple[float, ...], ...] = ()
    reference_position: tuple[tuple[float, ...], ...] = ()


def fly(run: Run) -> Flown:
    """Fly it; an early end is a result like any other.

    The mock sends its estimates in time. Where they went stale all the same the machine did not let it, and nothing
    was learned about the model: the flight is repeated.
    """
    flown = _tried(run)
    while Event.ESTIMATE_STALE.value in flown.events and flown.repeats < MAX_REPEATS:
        flown = msgspec.structs.replace(_tried(run), repeats=flown.repeats + 1)
    return flown


def _tried(run: Run) -> Flown:
    try:
        if run.pace == "link":
            return _over_link(run)
        return in_lockstep(run) if run.pace == "lockstep" else from_the_ground(run, run.pace)
    except VehicleError as error:
        return Flown(run, str(error))


@contextlib.contextmanager
def ahead_of_others(priority: int) -> Iterator[None]:
    """Processes that are started meanwhile run under SCHED_FIFO, where it is granted."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    try:
        yield
    finally:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _over_link(run: Run) -> Flown:
    hidden = [part for effect in REAL_WORLD for part in ("--effect", effect)]
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        with ahead_of_others(MOCKS_PRIORITY):
            mock = stack.enter_context(mock_process(*hidden, "--seed", str(run.seed), vehicle=VEHICLE))
        bundled = Path(run.path).is_dir()
        setup = FlightSetup(
            link=mock.url,
            reference=run.manoeuvre,
            duration=DURATION,
            rate=RATE,
            record=Path(folder),
            timeout=FINDING_PATIENCE,
            priority=PRIORITY,
            vehicle=None if bundled else run.path,
            bundle=Path(run.path) if bundled else None,
        )
        flight = prepare_flight(setup, flown_before=run.model != "nominal")
        request = msgspec.structs.replace(flight.request, plan=msgspec.structs.replace(BRISK, duration=DURATION))
        daemon = Daemon(request, flight.vehicle, flight.reference, lambda _: None, bundle=flight.bundle)
        report = daemon.fly()
        if report.landing_reason or not report.landed:
            return Flown(run, f"{report.outcome} {report.landing_reason}".strip(), events=report.events)
        recording = read_recording(Path(report.recording or ""))
    return msgspec.structs.replace(
        _judged(run, *_of_recording(recording)),
        events=report.events,
        late=report.timing.missed,
        ticks=report.timing.ticks,
        **_fallbacks(recording),
    )


def _of_recording(recording: FlightRecording) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Times (n,) s since tracking began; position, its setpoint, velocity and body rates (n, 3)."""
    times, position, reference_position = tracked(recording)
    began = _tracking(recording)[0]
    estimate, imu = recording.table("/estimate"), recording.table("/imu")
    velocity = _at(times + began, estimate["time"], estimate["velocity_world"])
    return times, position, reference_position, velocity, _at(times + began, imu["time"], imu["rate_body"])


def _at(times: Floats, stamps: Floats, values: Floats) -> Floats:
    return np.column_stack([np.interp(times, stamps, axis) for axis in values.T])


def _tracking(recording: FlightRecording) -> tuple[float, float]:
    """When tracking began and ended, s."""
    phases = recording.table("/phase")
    first = int(np.flatnonzero(phases["phase"] == "track")[0])
    return float(phases["time"][first]), float(phases["time"][first + 1])


def _fallbacks(recording: FlightRecording) -> dict[str, float | int | None]:
    began, ended = _tracking(recording)
    ticks = recording.table("/tick")
    rows = (ticks["time"] >= began + RAMP) & (ticks["time"] < ended)
    away, ratio = ticks["fallback"][rows] != "none", ticks["model_ratio"][rows].astype(float)
    return {
        "fallbacks": int(np.count_nonzero(np.diff(away.astype(int), prepend=0) > 0)),
        "fallback_seconds": float(np.count_nonzero(away) / RATE),
        "model_ratio": float(np.nanmax(ratio)) if np.isfinite(ratio).any() else None,
    }


def in_lockstep(run: Run) -> Flown:
    body, bundle = read_vehicle(find_vehicle(VEHICLE)), exported_bundle(Path(run.path))
    controller = Controller.build(read_vehicle(Path(run.path))) if bundle is None else Controller.from_bundle(bundle)
    reference = named_reference(run.manoeuvre, controller.trim, duration=DURATION)
    flown = fly_reference(
        body,
        reference,
        effects=[parse_effect(text, body.rotors.count) for text in REAL_WORLD],
        seed=run.seed,
        controller=controller,
        nominal=None if bundle is None else Controller.fallback_from_bundle(bundle),
    )
    if flown.aborted:
        return Flown(run, flown.aborted)
    flight = Flight.from_log(flown.log, rate=RATE)
    parts = [flight[name] for name in ("position", "position_setpoint", "velocity", "rate")]
    finite = np.isfinite(np.hstack(parts)).all(axis=1) & (flight.time - flight.time[0] <= DURATION)
    result = _judged(run, flight.time[finite] - flight.time[0], *(part[finite] for part in parts))
    return msgspec.structs.replace(
        result, fallbacks=flown.fallbacks, fallback_seconds=flown.fallback_seconds, ticks=int(DURATION * RATE)
    )


def from_the_ground(run: Run, estimator: Estimator) -> Flown:
    """A whole flight in lockstep on an estimator's errors; its error is by the estimate."""
    file, bundle = find_vehicle(VEHICLE), exported_bundle(Path(run.path))
    options = None if bundle is not None else ControllerOptions.for_vehicle(read_vehicle(Path(run.path)))
    controllers = build_controllers(read_vehicle(file if bundle else Path(run.path)), bundle, options)
    flight = fly_whole(
        MockOptions(file, effects=tuple(REAL_WORLD), estimator=estimator, seed=run.seed),
        named_reference(f"{run.manoeuvre}:height={HEIGHT}", controllers.flying.trim, duration=DURATION),
        plan=msgspec.structs.replace(BRISK, duration=DURATION),
        controllers=controllers,
    )
    if not flight.landed or flight.landing_reason:
        return Flown(run, f"{flight.outcome} {flight.landing_reason}".strip())
    rows = np.array([phase is Phase.TRACK for phase in flight.phases])
    times, estimate = np.array(flight.time)[rows], np.array(flight.estimate)[rows]
    parts = (estimate[:, POSITION], np.array(flight.reference)[rows], estimate[:, VELOCITY], estimate[:, RATE_BODY])
    result = _judged(run, times - times[0], *parts)
    return msgspec.structs.replace(result, ticks=int(DURATION * RATE))


def _judged(
    run: Run, times: Floats, position: Floats, reference_position: Floats, velocity: Floats, rate: Floats
) -> Flown:
    """Figures of the rows after the ramp, on an even grid."""
    grid = np.arange(0.0, times[-1], 1.0 / RATE)
    position, reference_position, velocity, rate = (
        _at(grid, times, part) for part in (position, reference_position, velocity, rate)
    )
    rows = grid >= RAMP
    error = np.linalg.norm(position - reference_position, axis=1)[rows]
    linear, angular = (peaks[rows] for peaks in accelerations(velocity, rate))
    return Flown(
        run,
        "",
        seconds=float(grid[-1] - RAMP),
        position_rmse=float(np.sqrt(np.mean(error**2))),
        position_max=float(error.max()),
        speed_max=float(np.linalg.norm(velocity, axis=1).max()),
        peak_linear=float(linear.max()),
        peak_angular=float(angular.max()),
        linear=counts(linear, LINEAR_BINS),
        angular=counts(angular, ANGULAR_BINS),
        path=_thinned(position[rows]),
        reference_position=_thinned(reference_position[rows]),
    )


def accelerations(velocity: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """Norms (n,) of linear and angular acceleration at RATE, of velocity and rates (n, 3) filtered as for labels."""
    slow = filters.lowpass(velocity, RATE, VELOCITY_CUTOFF), filters.lowpass(rate, RATE, RATE_CUTOFF)
    linear, angular = (np.linalg.norm(filters.derivative(values, 1.0 / RATE), axis=1) for values in slow)
    return linear, angular


def counts(values: Floats, bins: Floats) -> tuple[int, ...]:
    """How many values lie in each bin; the last takes what is beyond it."""
    return tuple(int(count) for count in np.histogram(np.minimum(values, bins[-1]), bins)[0])


def _thinned(points: Floats) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in point) for point in np.round(points[::PATH_STEP], 4))
