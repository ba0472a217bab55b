"""A vehicle file beside its logs: which of its numbers these contradict, and by how much."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import msgspec

from diagnosis.data.dataset import read_flights
from diagnosis.thresholds import DEFAULT
from diagnosis.vehicle_from_logs import layout_of
from diagnosis.vehicle_identification import Constant, Identification, identify_vehicle
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.effects.motor_lag import EFFECT as MOTOR_LAG
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from flights.rotor_layout import RotorLayout

LIMITS = DEFAULT.vehicle
Answer = Literal["agrees", "disagrees", "open"]


class CheckedNumber(msgspec.Struct, frozen=True):
    """One number of the file beside the logs.

    file: in the vehicle file. logs: by the logs, None where they cannot tell. half_width: of the interval of 95 %.
    answer: "open" where the logs cannot tell.
    text: the same in words.
    """

    name: str
    file: float | None
    logs: float | None
    half_width: float | None
    unit: str
    answer: Answer
    text: str


class VehicleCheck(msgspec.Struct, frozen=True):
    """A vehicle file beside its logs.

    agrees: whether no number disagrees.
    numbers: each of them.
    notes: to the user.
    """

    vehicle: str
    agrees: bool
    numbers: tuple[CheckedNumber, ...]
    notes: tuple[str, ...] = ()


def check_vehicle(
    logs: Sequence[str | Path],
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    *,
    mapping: str | Path | None = None,
) -> VehicleCheck:
    """Compare a vehicle file with logs of that vehicle. Raises RequestError for logs that cannot be used."""
    flights = read_flights(logs, mapping=mapping)
    numbers: list[CheckedNumber] = []
    notes: tuple[str, ...] = ()
    try:
        layout = layout_of(flights)
        numbers += _layout_numbers(layout, vehicle)
        notes = layout.notes
    except DataError as error:
        numbers.append(_open("layout", str(error)))
    counts = {f[name].shape[1] for f in flights for name in ("rotor_speed", "rotor_command") if f.has(name)}
    if not counts or counts == {vehicle.rotors.count}:
        try:
            identified = identify_vehicle(flights, vehicle, catalogue, fit_curve=False)
            numbers += _constants(identified, vehicle)
            notes = (*notes, *identified.notes)
        except DataError as error:
            numbers.append(_open("thrust, inertia and lag", str(error)))
    elif not any(n.name == "rotors" for n in numbers):
        numbers.append(_number("rotors", float(vehicle.rotors.count), float(max(counts)), 0.0, ""))
    return VehicleCheck(vehicle.name, all(n.answer != "disagrees" for n in numbers), tuple(numbers), notes)


def _layout_numbers(layout: RotorLayout, vehicle: Vehicle) -> Iterator[CheckedNumber]:
    rotors, count = vehicle.rotors, len(layout.position)
    if rotors.count != count:
        yield _number("rotors", float(rotors.count), float(count), 0.0, "")
        return
    wrong = [*_places(layout, vehicle), *_spins(layout, vehicle)]
    text = f"{count} rotors stand and turn as {layout.origin} of {layout.autopilot} state"
    yield from wrong or [CheckedNumber("layout", None, None, None, "", "agrees", text)]


def _places(layout: RotorLayout, vehicle: Vehicle) -> Iterator[CheckedNumber]:
    """Rotors that stand elsewhere in the file."""
    positions = vehicle.rotors.position
    scale = 1.0 if layout.in_metres else max(math.hypot(x, y) for x, y, _ in positions) / layout.arm
    for number, ((own_x, own_y, _), place) in enumerate(zip(positions, layout.position, strict=True)):
        x, y = scale * place[0], scale * place[1]
        angle = math.degrees(math.atan2(own_y, own_x) - math.atan2(y, x))
        length = math.hypot(own_x, own_y) / max(math.hypot(x, y), 1e-9) - 1
        if abs((angle + 180) % 360 - 180) > LIMITS.max_angle or abs(length) > LIMITS.max_length:
            text = f"({own_x:.3g}, {own_y:.3g}) m in the file, ({x:.3g}, {y:.3g}) m by {layout.origin}"
            yield CheckedNumber(f"position of {_rotor(number, layout)}", None, None, None, "m", "disagrees", text)


def _spins(layout: RotorLayout, vehicle: Vehicle) -> Iterator[CheckedNumber]:
    """Rotors that turn the other way in the file."""
    for number, (own, spin) in enumerate(zip(vehicle.rotors.spin, layout.spin, strict=True)):
        if own != spin:
            turns = "counter-clockwise" if spin < 0 else "clockwise"
            text = f"{own:+d} in the file, {spin:+d} by {layout.origin}, {turns} seen from above"
            yield CheckedNumber(
                f"spin of {_rotor(number, layout)}", float(own), float(spin), None, "", "disagrees", text
            )


def _rotor(number: int, layout: RotorLayout) -> str:
    return f"rotor {number} ({layout.autopilot} motor {layout.motor[number]})"


def _constants(identified: Identification, vehicle: Vehicle) -> Iterator[CheckedNumber]:
    """The constants, those of the commands at the file's curve and speed_max."""
    rotors, body = vehicle.rotors, vehicle.body
    mass = f" at the file's mass of {body.mass:g} kg"
    heavier = body.mass * rotors.thrust_constant / identified.thrust_constant.value
    either = f"{mass}, or a mass of {heavier:.3g} kg at the file's thrust constant"
    yield _compared("rotors.thrust_constant", rotors.thrust_constant, identified.thrust_constant, either)
    for axis, own, constant in zip("xy", body.inertia, identified.inertia, strict=False):
        yield _compared(f"body.inertia about {axis}", own, constant, mass)
    yield _compared(
        "rotors.torque_constant over body.inertia about z",
        rotors.torque_constant / body.inertia[2],
        identified.yaw_gain,
        "",
    )
    if identified.yaw_inertia is not None:
        yield _compared("body.inertia about z", body.inertia[2], identified.yaw_inertia, mass)
    lags = [use.parameters.get("time_constant") for use in vehicle.effects if use.name == MOTOR_LAG.name]
    if identified.motor_lag is not None:
        own_lag = next((lag for lag in lags if lag is not None), 0.0)
        yield _compared("effects.motor_lag.time_constant", own_lag, identified.motor_lag, "")
    if identified.speed_max is not None:
        yield _compared("rotors.speed_max", rotors.speed_max, identified.speed_max, "")
    if identified.thrust_curve is not None and identified.is_measured:
        yield _compared(
            "rotors.thrust_curve", rotors.thrust_curve, identified.thrust_curve, "", margin=LIMITS.curve_tolerance
        )


def _compared(name: str, own: float, constant: Constant, remark: str, *, margin: float = 0.0) -> CheckedNumber:
    """A number beside an interval. least: difference that does not matter, in the unit."""
    if not (math.isfinite(constant.half_width) and (constant.is_usable or margin or own == 0.0)):
        width = f" +- {constant.half_width:.2g}" if math.isfinite(constant.half_width) else ""
        return _open(name, f"the flights say {constant.value:.4g}{width} {constant.unit}: too little of it was flown")
    return _number(name, own, constant.value, constant.half_width + margin, constant.unit, remark)


def _number(name: str, own: float, logs: float, half_width: float, unit: str, remark: str = "") -> CheckedNumber:
    difference = logs - own
    wrong = abs(difference) > max(half_width, LIMITS.tolerance * abs(own))
    percent = f", {100 * difference / own:+.0f} %" if own else ""
    width = f" +- {half_width:.2g}" if half_width else ""
    text = f"{own:.4g} in the file, {logs:.4g}{width} {unit} by the logs{percent}{remark}".replace("  ", " ")
    return CheckedNumber(name, own, logs, half_width, unit, "disagrees" if wrong else "agrees", text)


def _open(name: str, why: str) -> CheckedNumber:
    return CheckedNumber(name, None, None, None, "", "open", why)
