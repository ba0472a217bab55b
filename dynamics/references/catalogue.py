"""References by name: `lemniscate`, `Lemniscate:plane=yz,speed=1.2`, or a user's own CSV file."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np

from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.references.manoeuvres import PAPER, PLAIN, Manoeuvre
from dynamics.references.reference import Reference
from dynamics.references.table import read_table
from dynamics.references.time_law import TimeLaw
from dynamics.spelling import nearest
from dynamics.vehicle import Vehicle

MANOEUVRES = {**PAPER, **PLAIN}
IDENTIFY = "identify"
_EXAMPLE = "Write NAME or NAME:key=value,..., as in lemniscate:plane=yz,speed=0.8"
_SPELLINGS = {name.lower().replace("_", ""): name for name in MANOEUVRES}


class Shape(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The shape of a manoeuvre.

    plane: the world axes along which its first two axes lie, such as xy, xz, z-y.
    speed, size: factors on its own.
    height: of its lowest point, m.
    laps: times around.
    ramp: s from rest to full speed.
    """

    plane: str | None = None
    speed: float = 1.0
    size: float = 1.0
    height: float | None = None
    laps: int | None = None
    ramp: float = 3.0


def named_reference(text: str, vehicle: Vehicle, *, duration: float | None = None) -> Reference:
    """The reference of a name or file on a vehicle. duration: minimum, s, for manoeuvres.

    Raises RequestError for an unknown name or key, a value out of range, or a file that holds no trajectory.
    """
    if text.lower().endswith((".csv", ".csv.gz")) or Path(text).is_file():
        return read_table(Path(text), vehicle)
    if is_identification(text):
        raise RequestError(
            f"reference {text!r} is planned first, which `alula fly` does: give this command the file that it writes."
        )
    name, _, rest = text.partition(":")
    manoeuvre = _SPELLINGS.get(name.strip().lower().replace("_", "").replace("-", "").replace(" ", ""))
    if manoeuvre is None:
        names = ", ".join(MANOEUVRES)
        raise RequestError(
            f"unknown reference {name!r}{nearest(name, MANOEUVRES)}. Known: {names}, identify, or a .csv file."
        )
    return make_reference(manoeuvre, _parse_shape(text, rest), vehicle, duration=duration)


def is_identification(text: str) -> bool:
    """Whether a reference's name asks for an identification flight, which has to be planned first."""
    return text.partition(":")[0].strip().lower() == IDENTIFY


def make_reference(name: str, shape: Shape, vehicle: Vehicle, *, duration: float | None = None) -> Reference:
    """A manoeuvre of the catalogue in a shape. Raises RequestError for an impossible shape."""
    manoeuvre = MANOEUVRES[name]
    _check_shape(name, shape)
    rate = manoeuvre.rate * shape.speed
    laps = shape.laps or _laps(manoeuvre, shape, rate, duration)
    plane = shape.plane or manoeuvre.plane
    try:
        centred = manoeuvre.curve(plane, shape.size, np.zeros(3))
    except ValueError as error:
        raise RequestError(
            f"reference {name}: plane {shape.plane!r}: {error}. Give two axes, such as xy or z-x."
        ) from None
    lowest = float(centred.derivatives(np.linspace(0, 2 * np.pi, 721))[:, 0, 2].min())
    height = manoeuvre.height if shape.height is None else shape.height
    curve = manoeuvre.curve(plane, shape.size, np.array([0.0, 0.0, height - lowest]))
    law = TimeLaw(rate, shape.ramp, 2 * np.pi * laps / rate + shape.ramp)
    return Reference(name if shape == Shape() else f"{name}:{_describe(shape)}", curve, law, vehicle, shape.speed)


def _laps(manoeuvre: Manoeuvre, shape: Shape, rate: float, duration: float | None) -> int:
    """Enough laps for the duration, or the manoeuvre's own number; a ramp covers as much as half its time would."""
    if duration is None or not math.isfinite(duration):
        return manoeuvre.laps
    return max(1, math.ceil((duration - shape.ramp) * rate / (2 * np.pi)))


def _parse_shape(text: str, rest: str) -> Shape:
    values: dict[str, str | float] = {}
    for pair in filter(None, rest.split(",")):
        key, equals, value = pair.partition("=")
        if not equals:
            raise RequestError(f"reference {text!r}: {pair!r} is not key=value. {_EXAMPLE}.")
        if key.strip() not in Shape.__struct_fields__:
            keys = ", ".join(Shape.__struct_fields__)
            close = nearest(key, Shape.__struct_fields__)
            raise RequestError(f"reference {text!r}: unknown key {key!r}{close}. Known: {keys}.")
        values[key.strip()] = value if key.strip() == "plane" else _number(text, key.strip(), value)
    try:
        return msgspec.convert(values, Shape, strict=False)
    except msgspec.ValidationError as error:
        raise RequestError(f"reference {text!r}: {described(error)}. {_EXAMPLE}.") from None


def _number(text: str, key: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise RequestError(f"reference {text!r}: {key} = {value!r} is not a number. {_EXAMPLE}.") from None


def _check_shape(name: str, shape: Shape) -> None:
    limits = {
        "speed": (0.01, 5.0),
        "size": (0.01, 20.0),
        "ramp": (0.2, 60.0),
        "laps": (1, 1000),
        "height": (0.0, 1000.0),
    }
    for key, (lower, upper) in limits.items():
        value = getattr(shape, key)
        if value is not None and not lower <= value <= upper:
            raise RequestError(f"reference {name}: {key} = {value} is outside of {lower} to {upper}.")


def _describe(shape: Shape) -> str:
    values = {key: getattr(shape, key) for key in Shape.__struct_fields__}
    usual = Shape()
    return ",".join(f"{key}={value}" for key, value in values.items() if value != getattr(usual, key))
