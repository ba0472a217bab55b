"""A vehicle file from logs: the autopilot's parameters give the layout, the flights the constants."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from diagnosis.data.dataset import read_flights
from diagnosis.one_thread import one_thread
from diagnosis.thresholds import DEFAULT
from diagnosis.vehicle_identification import Constant, Identification, identify_vehicle, with_yaw_inertia
from dynamics.autopilot_frames import FRAMES
from dynamics.errors import DataError, RequestError
from dynamics.progress import Progress, no_progress, part_of
from dynamics.vehicle import GRAVITY, Body, Rotors, Vehicle
from dynamics.vehicle_draft import Draft, Entry
from dynamics.vehicle_plausibility import require_carried, require_in_range
from dynamics.vehicle_sizing import YAW_INERTIA, YAW_SPREAD, inertia_by_rule, inertia_entry
from flights import Flight
from flights.rotor_layout import RotorLayout, rotor_layout, states_rotors
from flights.stated_frame import stated_layout

LIMITS = DEFAULT.vehicle
MAX_TURN = math.radians(20.0)  # of a rotor's place about the centre from that of a frame


@dataclass(frozen=True)
class LogVehicle:
    """A draft made from logs.

    layout: by the autopilot's parameters.
    identified: from the flights, None where these hold too little.
    """

    draft: Draft
    layout: RotorLayout
    identified: Identification | None


@one_thread
def vehicle_from_logs(
    logs: Sequence[str | Path],
    *,
    name: str,
    mass: float | None = None,
    arm: float | None = None,
    propeller: float | None = None,
    speed_max: float | None = None,
    frame: str | None = None,
    autopilot: str | None = None,
    mapping: str | Path | None = None,
    command: str = "",
    progress: Progress = no_progress,
) -> LogVehicle:
    """A draft of the vehicle that flew some logs.

    mass: kg, as flown; None leaves it open. arm: from the centre to the outermost motor's axis, m; None: by the
    parameters. propeller: diameter, m. speed_max: of a rotor at full signal, rad/s, for logs without rotor speeds.
    frame: name in `dynamics.autopilot_frames.FRAMES`, for logs whose parameters state no layout. autopilot: whose motor
    numbers the file has; by default that of the logs.

    Raises RequestError for logs that cannot be used, DataError where they state no layout or hold no flight.
    """
    _require_positive({"mass": mass, "arm": arm, "propeller": propeller, "speed_max": speed_max})
    require_in_range(mass=mass, arm=arm, propeller=propeller)
    flights = read_flights(logs, mapping=mapping, progress=part_of(progress, 0.0, 0.4))
    layout = layout_of(flights, frame, autopilot)
    position = _positions(layout, arm)
    start = _start(name, mass or 1.0, position, layout, speed_max)
    require_carried(start.body.mass, start.rotors, name)
    identified, refusal = _identified(flights, start, part_of(progress, 0.4, 1.0))
    draft = Draft(
        name,
        tuple(_entries(layout, position, start, identified, mass=mass, arm=arm, propeller=propeller, speed=speed_max)),
        tuple(_open(layout, identified, refusal, mass=mass, speed=speed_max)),
        (*layout.notes, *(identified.notes if identified is not None else ())),
        command,
    )
    return LogVehicle(draft, layout, identified)


def layout_of(flights: Sequence[Flight], frame: str | None = None, autopilot: str | None = None) -> RotorLayout:
    """The layout that all of these flights' parameters state, or else that of a frame.

    Raises DataError where they state none and no frame is given, RequestError where they differ.
    """
    if frame is not None:
        of_frame = stated_layout(flights, frame, autopilot)
        if not any(states_rotors(flight.parameters) for flight in flights):
            return of_frame
    elif autopilot is not None:
        raise RequestError("--autopilot numbers the motors of a --frame. Give both, or neither.")
    layouts = {f.provenance.path: rotor_layout(f.parameters, _vehicle_type(f.metadata)) for f in flights}
    stated = {path: layout for path, layout in layouts.items() if layout is not None}
    if not stated:
        raise DataError(
            f"{next(iter(layouts))}: its parameters state no layout of rotors (PX4: CA_ROTORn_PX, PY, KM; ArduPilot: "
            f"FRAME_CLASS and FRAME_TYPE of a plus, X or H frame). Give --frame ({', '.join(FRAMES)}) and --arm; or "
            "make a file with `alula vehicle new`, and compare it with the logs by `alula vehicle check`."
        )
    first = next(iter(stated))
    for path, layout in stated.items():
        if (layout.position, layout.spin) != (stated[first].position, stated[first].spin):
            raise RequestError(f"{first} and {path} are of vehicles with other rotors. Give the logs of one vehicle.")
    if frame is not None and not _same_shape(stated[first], of_frame):
        raise RequestError(
            f"{first}: {stated[first].origin} state other rotors than a {frame}. "
            "Leave --frame out: the parameters count."
        )
    return stated[first]


def _same_shape(layout: RotorLayout, other: RotorLayout) -> bool:
    """Whether rotors turn the same way and stand in the same directions from the centre, within 20 degrees."""
    if layout.spin != other.spin:
        return False
    bearings = (
        (math.atan2(y, x), math.atan2(v, u))
        for (x, y, _), (u, v, _) in zip(layout.position, other.position, strict=True)
    )
    return all(abs(math.remainder(a - b, math.tau)) < MAX_TURN for a, b in bearings)


def _vehicle_type(metadata: Mapping[str, str]) -> int | None:
    text = metadata.get("vehicle_type", "")
    return int(text) if text.isdigit() else None


def _positions(layout: RotorLayout, arm: float | None) -> tuple[tuple[float, float, float], ...]:
    if arm is not None:
        return layout.scaled(arm)
    if not layout.in_metres:
        raise RequestError(
            f"{layout.origin} state the frame's shape and no length. Measure from the centre to a motor's axis and "
            "give it: --arm 0.25 (m)."
        )
    return layout.position


def _start(
    name: str,
    mass: float,
    position: tuple[tuple[float, float, float], ...],
    layout: RotorLayout,
    speed_max: float | None,
) -> Vehicle:
    """Where the estimation begins: inertia by rule, thrust that carries the weight twice."""
    speed, count = speed_max or LIMITS.assumed_speed, len(position)
    thrust_constant = 2 * mass * GRAVITY / (count * speed**2)
    arm = max(math.hypot(x, y) for x, y, _ in position)
    inertia = inertia_by_rule(mass, arm)
    curve = min(max(layout.thrust_curve or 0.0, 0.0), 1.0)
    rotors = Rotors(
        position=position,
        spin=layout.spin,
        thrust_constant=thrust_constant,
        torque_constant=(layout.torque_ratio or LIMITS.torque_ratio) * thrust_constant,
        speed_max=speed,
        thrust_curve=curve,
        motor=layout.motor,
    )
    return Vehicle(name, Body(mass, inertia), rotors)


def _identified(flights: Sequence[Flight], start: Vehicle, progress: Progress) -> tuple[Identification | None, str]:
    """Vehicle's numbers by the flights, or None and the reason."""
    try:
        identified = identify_vehicle(flights, start, progress=progress)
    except DataError as error:
        return None, str(error)
    if identified.yaw_inertia is not None:
        return identified, ""
    tilt = identified.vehicle.body.inertia[:2]
    return with_yaw_inertia(identified, YAW_INERTIA * sum(tilt)), ""


def _entries(
    layout: RotorLayout,
    position: tuple[tuple[float, float, float], ...],
    start: Vehicle,
    identified: Identification | None,
    *,
    mass: float | None,
    arm: float | None,
    propeller: float | None,
    speed: float | None,
) -> Iterator[Entry]:
    vehicle = start if identified is None else identified.vehicle
    rotors = vehicle.rotors
    per_mass = "" if mass is not None else " of 1 kg"
    yield Entry(
        "body.mass", mass, "kg", "given" if mass is not None else "assumed", "given" if mass else "open: weigh it"
    )
    yield _inertia(identified, start, per_mass)
    source: Literal["given", "parameters"] = "given" if layout.is_given else "parameters"
    places = f"{layout.origin} of {layout.autopilot}" if source == "parameters" else layout.origin
    scaling = f", scaled to the arm of {arm:g} m that was given" if arm is not None else ""
    yield Entry("rotors.position", [list(p) for p in position], "m, body FLU", source, places + scaling)
    yield Entry("rotors.spin", list(layout.spin), "sign of the reaction torque about body z", source, places)
    yield Entry("rotors.motor", list(layout.motor), f"{layout.autopilot}'s motor numbers", source, places)
    yield from _thrust_entries(identified, rotors, per_mass)
    yield _speed_entry(identified, rotors, speed)
    if propeller is not None:
        yield Entry("rotors.radius", propeller / 2, "m", "given", "half of the diameter given")
    if identified is not None and identified.motor_lag is not None and identified.motor_lag.is_usable:
        yield _of(identified.motor_lag, "effects.motor_lag.time_constant", "rotors behind their commands")


def _inertia(identified: Identification | None, start: Vehicle, per_mass: str) -> Entry:
    if identified is None or not all(value.is_usable for value in identified.inertia):
        arm = max(math.hypot(x, y) for x, y, _ in start.rotors.position)
        rule = inertia_entry(start.body.mass, arm)
        return Entry(rule.key, rule.value, rule.unit, "rule", f"{rule.origin}{per_mass}", rule.uncertainty)
    (x, y), yaw = identified.inertia, identified.yaw_inertia
    ruled = identified.vehicle.body.inertia[2]
    widths = (x.half_width, y.half_width, YAW_SPREAD * ruled if yaw is None else yaw.half_width)
    by_rule = f"; about z {YAW_INERTIA:g} of the sum of the others, by rule" if yaw is None else ""
    values = [x.value, y.value, ruled]
    return Entry(
        "body.inertia", values, "kg m^2, diagonal", "flights", f"relative to the mass{per_mass}{by_rule}", widths
    )


def _thrust_entries(identified: Identification | None, rotors: Rotors, per_mass: str) -> Iterator[Entry]:
    if identified is None:
        doubled = f"full thrust of twice the weight{per_mass}"
        ratio = f"{rotors.torque_constant / rotors.thrust_constant:.3g} m of torque over thrust"
        yield Entry("rotors.thrust_constant", rotors.thrust_constant, "N s^2/rad^2", "assumed", doubled)
        yield Entry("rotors.torque_constant", rotors.torque_constant, "N m s^2/rad^2", "assumed", ratio)
        return
    yield _of(identified.thrust_constant, "rotors.thrust_constant", f"carries the weight{per_mass} in hover")
    gain = identified.yaw_gain
    yaw = identified.vehicle.body.inertia[2]
    spread = YAW_SPREAD if identified.yaw_inertia is None else identified.yaw_inertia.half_width / yaw
    width = rotors.torque_constant * math.hypot(gain.half_width / gain.value, spread)
    origin = f"{gain.value:.4g} +- {gain.half_width:.2g} times the inertia about z of {yaw:.3g}"
    yield Entry("rotors.torque_constant", rotors.torque_constant, "N m s^2/rad^2", "flights", origin, (width,))
    if identified.thrust_curve is not None:
        own = abs(rotors.thrust_curve - min(max(identified.thrust_curve.value, 0.0), 1.0)) < 1e-9
        origin = f"{identified.thrust_curve.value:.2f} +- {identified.thrust_curve.half_width:.2f} by the flights"
        origin = origin if own else f"the autopilot's; {origin}"
        yield Entry("rotors.thrust_curve", rotors.thrust_curve, "share of the thrust that goes with the squared signal",
                    "flights" if own else "parameters", origin)  # fmt: skip


def _speed_entry(identified: Identification | None, rotors: Rotors, speed: float | None) -> Entry:
    key = "rotors.speed_max"
    if identified is not None and identified.speed_max is not None:
        return _of(identified.speed_max, key, "speed over motor signal, at full signal")
    if speed is not None:
        return Entry(key, speed, "rad/s", "given", "")
    return Entry(key, rotors.speed_max, "rad/s", "assumed", "a scale: the logs hold no rotor speeds")


def _of(constant: Constant, key: str, origin: str) -> Entry:
    return Entry(key, constant.value, constant.unit, "flights", origin, (constant.half_width,))


def _open(
    layout: RotorLayout, identified: Identification | None, refusal: str, *, mass: float | None, speed: float | None
) -> Iterator[str]:
    if mass is None:
        yield "the mass, with which thrust, torque and inertia scale: weigh the vehicle as flown and give --mass"
    if identified is None:
        yield f"inertia, thrust and torque constants and the motors' lag: {refusal}"
        return
    if not all(value.is_usable for value in identified.inertia):
        yield "the inertia: these flights turn too gently; fly rolls and pitches of 30 degrees back and forth"
    if not identified.yaw_gain.is_usable:
        yield "the torque constant: these flights yaw too gently; fly yaw steps of 90 degrees both ways"
    if identified.yaw_inertia is None:
        yield (
            "torque constant and yaw inertia apart: these flights show their ratio alone; fly rolls and pitches while "
            "the vehicle yaws fast, or measure one of them with a bifilar pendulum or a thrust stand"
        )
    if identified.speed_max is None and speed is None:
        yield (
            "the rotors' speed: log esc_status (DShot telemetry), or give --speed-max; until then speeds and the "
            "constants per squared speed are on a scale of their own"
        )
    if identified.motor_lag is None or not identified.motor_lag.is_usable:
        yield "the motors' lag: these flights show none; fly quick rolls and log the motor commands"
    curve = identified.thrust_curve
    if layout.thrust_curve is not None and curve is not None:
        difference = abs(curve.value - layout.thrust_curve)
        if difference > curve.half_width + LIMITS.curve_tolerance:
            yield (
                f"why the thrust's curve is {curve.value:.2f} +- {curve.half_width:.2f} by the flights and "
                f"{layout.thrust_curve:.2f} in the autopilot: the signal is followed as the flights say"
            )


def _require_positive(values: Mapping[str, float | None]) -> None:
    for name, value in values.items():
        if value is not None and not (math.isfinite(value) and value > 0):
            raise RequestError(f"{name} = {value:g}: give a number above 0, in SI units.")
