"""Rotors of a frame that the user states, for logs whose parameters do not."""

from __future__ import annotations

from collections.abc import Sequence

from dynamics.autopilot_frames import AUTOPILOTS, FRAMES, OWN_NUMBERS, QUAD_X_ORDER, Frame, ardupilot_frame
from dynamics.errors import RequestError
from dynamics.spelling import unknown
from flights.flight import Flight
from flights.quantities import ROTORS
from flights.readers.px4_rotors import rotor_order
from flights.rotor_layout import RotorLayout

PX4, ARDUPILOT, CRAZYFLIE, BETAFLIGHT = AUTOPILOTS
# autopilots by the format of their logs
AUTOPILOT_OF_FORMAT = {
    "PX4 ULog": PX4,
    "ArduPilot DataFlash log": ARDUPILOT,
    "Crazyflie micro-SD log": CRAZYFLIE,
    "CSV of Crazyflie log variables": CRAZYFLIE,
    "Betaflight blackbox log": BETAFLIGHT,
    "Betaflight blackbox CSV": BETAFLIGHT,
}
_IN_QUADRANTS = ("MAVLink tlog", "Alula's recording (MCAP)")  # whose four motors are read as a quad x's
_AS_SENT = ("ROS bag",)  # whose motors are left in the autopilot's order


def stated_layout(flights: Sequence[Flight], frame: str, autopilot: str | None = None) -> RotorLayout:
    """The layout of a frame in the order in which the logs were read, in units of the arm.

    frame: name in `FRAMES`; octo_ is read as octa_. autopilot: whose motor numbers the file has, of `AUTOPILOTS` in any
    case; None for that of the logs, and PX4's where they do not tell.

    Raises RequestError for an unknown frame or autopilot, and for logs of another number of rotors.
    """
    name = frame.lower().replace("-", "_").replace("octo_", "octa_")
    if name not in FRAMES:
        raise RequestError(f"unknown frame {frame!r}{unknown(name, FRAMES)}")
    stated, count = FRAMES[name], len(FRAMES[name].angle)
    for flight in flights:
        logged = {flight[q].shape[1] for q in ROTORS if flight.has(q)}
        if logged and logged != {count}:
            raise RequestError(
                f"{flight.provenance.path} has {min(logged)} rotors, and a {name} has {count}. Give the frame of the "
                f"vehicle that flew: {', '.join(other for other in FRAMES if len(FRAMES[other].angle) in logged)}."
            )
    named = _autopilot(flights, autopilot)
    if named in OWN_NUMBERS and name != "quad_x":
        raise RequestError(f"the motor numbers of {named} are known for a quad_x, and not for {name}. Give quad_x, or "
                           f"--autopilot {PX4} where {PX4} numbers the motors.")  # fmt: skip
    numbers = OWN_NUMBERS.get(named, stated.motor)
    columns = {_places_read(flight, stated, numbers) for flight in flights}
    if len(columns) > 1:
        raise RequestError("the logs hold the rotors in different orders. Give logs of one format.")
    (places,) = columns
    return RotorLayout(
        autopilot=named,
        position=tuple(stated.direction[place] for place in places),
        spin=tuple(stated.spin[place] for place in places),
        motor=tuple(numbers[place] for place in places),
        in_metres=False,
        torque_ratio=None,
        thrust_curve=None,
        hover=None,
        origin=f"the frame {name} that was given",
        notes=(
            f"places, turning directions and motor numbers are those of {named}'s {name.replace('_', ' ')}: turn each "
            "motor on the bench by its number, without propellers",
        ),
        is_given=True,
    )


def _autopilot(flights: Sequence[Flight], stated: str | None) -> str:
    if stated is not None:
        by_name = {name.lower(): name for name in AUTOPILOTS}
        if stated.lower() not in by_name:
            raise RequestError(f"unknown autopilot {stated!r}{unknown(stated.lower(), by_name)}")
        return by_name[stated.lower()]
    names = {AUTOPILOT_OF_FORMAT[f.provenance.format] for f in flights if f.provenance.format in AUTOPILOT_OF_FORMAT}
    names |= {PX4 for flight in flights if flight.metadata.get("messages") == "px4_msgs"}
    if len(names) > 1:
        raise RequestError(f"the logs are of {' and '.join(sorted(names))}. Give the logs of one vehicle.")
    return names.pop() if names else PX4


def _places_read(flight: Flight, frame: Frame, numbers: tuple[int, ...]) -> tuple[int, ...]:
    """For each rotor of a log, as it was read, its place in `frame.direction`.

    numbers: the autopilot's motor numbers of these places.
    """
    in_place = tuple(range(len(numbers)))
    as_numbered = tuple(numbers.index(place + 1) for place in in_place)
    if len(numbers) != len(QUAD_X_ORDER):
        return as_numbered
    form, parameters = flight.provenance.format, flight.parameters
    if form == "PX4 ULog" or flight.metadata.get("messages") == "px4_msgs":
        vehicle_type = flight.metadata.get("vehicle_type", "")
        order = rotor_order(parameters, int(vehicle_type) if vehicle_type.isdigit() else None)[0]
    elif form == "ArduPilot DataFlash log":
        logged = ardupilot_frame(int(parameters.get("FRAME_CLASS", 0)), int(parameters.get("FRAME_TYPE", -1)))
        order = None if logged is None else FRAMES[logged].order
    elif form in _AS_SENT:
        order = None
    elif form in _IN_QUADRANTS:
        order = QUAD_X_ORDER
    else:
        return in_place
    return as_numbered if order is None else tuple(frame.motor.index(motor + 1) for motor in order)
