"""The autopilot's parameters that setpoints depend on, read once before a flight and recorded for its replay."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping

from dynamics.autopilot_settings import CUTOFFS, GAINS, AutopilotSettings
from dynamics.errors import RequestError, VehicleError
from dynamics.vehicle import Vehicle
from runtime.flight.last_setpoint import LOSS_TIME, USUAL_LOSS_TIME
from runtime.flight.thrust import THRUST_CURVE
from runtime.link.parameters import read_parameter, read_parameters
from runtime.link.vehicle_link import VehicleLink
from runtime.record.recorder import Recorder
from runtime.record.records import ParameterRecord

NOTABLE = 1.25  # ratio of a gain to the vehicle file's that is worth a line


def read_thrust_curve(
    link: VehicleLink,
    recorder: Recorder | None,
    announce: Callable[[str], None],
    clock: Callable[[], float] = time.monotonic,
) -> float:
    """The autopilot's THR_MDL_FAC; 0 where it cannot be read, which is announced. clock: of the flight, s."""
    curve = read_parameter(link, THRUST_CURVE)
    if curve.value is None:
        announce(f"{THRUST_CURVE} could not be read ({curve.error}); 0 is assumed")
    factor = float(curve.value or 0.0)
    _record(recorder, {THRUST_CURVE: factor}, clock())
    return factor


def read_loss_time(
    link: VehicleLink,
    recorder: Recorder | None,
    announce: Callable[[str], None],
    clock: Callable[[], float] = time.monotonic,
) -> float:
    """The autopilot's COM_OF_LOSS_T, s; the usual one where it cannot be read, announced. clock: of the flight, s."""
    loss_time = read_parameter(link, LOSS_TIME)
    if loss_time.value is None:
        announce(f"{LOSS_TIME} could not be read ({loss_time.error}); {USUAL_LOSS_TIME:g} s are assumed")
    seconds = USUAL_LOSS_TIME if loss_time.value is None else float(loss_time.value)
    _record(recorder, {LOSS_TIME: seconds}, clock())
    return seconds


def read_rate_gains(
    link: VehicleLink,
    vehicle: Vehicle,
    recorder: Recorder | None,
    announce: Callable[[str], None],
    clock: Callable[[], float] = time.monotonic,
) -> AutopilotSettings | None:
    """The gains of the autopilot's rate loop; None where they cannot be read, which is announced.

    vehicle: whose file's gains are compared. clock: of the flight, s.

    Raises VehicleError for gains that hold no body rate.
    """
    values = _read(link, (*GAINS, *CUTOFFS))
    try:
        gains = AutopilotSettings.from_parameters(values)
    except RequestError as error:
        raise VehicleError(f"The vehicle is not armed: its {', '.join(GAINS)} give {error}") from None
    if gains is None:
        source = "the vehicle file's" if vehicle.autopilot is not None else "gains that suit the file's motors"
        announce(f"{GAINS[0]} and so on could not be read; {source} are assumed")
        return None
    _record(recorder, values, clock())
    if vehicle.autopilot is not None and _differ(gains, vehicle.autopilot):
        flown, filed = (", ".join(f"{g:.3g}" for g in s.rate_gain) for s in (gains, vehicle.autopilot))
        announce(f"the autopilot's rate gains are {flown}, those of the vehicle file {filed}: its own count")
    return gains


def recorded_rate_gains(records: Iterable[ParameterRecord]) -> AutopilotSettings | None:
    """The gains that a recording's flight was flown with; None where it read none."""
    return AutopilotSettings.from_parameters({record.name: record.value for record in records})


def _read(link: VehicleLink, names: Iterable[str]) -> dict[str, float]:
    """Values by name, without those that the vehicle does not have."""
    parameters = read_parameters(link, names, timeout=0.3, attempts=3)
    return {name: float(each.value) for name, each in parameters.items() if each.value is not None}


def _differ(one: AutopilotSettings, other: AutopilotSettings) -> bool:
    pairs = zip(one.rate_gain, other.rate_gain, strict=True)
    return any(not a / NOTABLE <= b <= a * NOTABLE for a, b in pairs)


def _record(recorder: Recorder | None, values: Mapping[str, float], now: float) -> None:
    if recorder is not None:
        for name, value in values.items():
            recorder.put(ParameterRecord(now, name, value), now)
