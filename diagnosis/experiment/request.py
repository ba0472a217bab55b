"""Request of an identification flight: `identify:duration=60,box=4x4x2.5,speed=5,for=drag+inertia+lag`."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.errors import RequestError
from dynamics.references.catalogue import IDENTIFY
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import nearest

KEYS = ("duration", "box", "speed", "for", "seed")
EXAMPLE = "Write identify or identify:key=value,..., as in identify:duration=40,box=4x4x2.5,speed=5,for=drag+inertia"
BOX = (4.0, 4.0, 2.5)  # m: a small room
MIN_HEIGHT = 0.5  # m above the ground, below which nothing is planned
MIN_SIDE = 0.6  # m of the volume that is left
MIN_DURATION, MAX_DURATION = 10.0, 60.0  # s


class ExperimentRequest(msgspec.Struct, frozen=True):
    """An identification flight as requested.

    duration: of the reference, s.
    box: width along x, depth along y, height of its top above the ground, m, about the place of take-off; None for the
        vehicle file's box, or 4 x 4 x 2.5 m.
    speed: limit, m/s; None for the vehicle file's.
    effects: words for what it is to show, as drag, inertia, lag; none for the whole catalogue.
    seed: of the search.
    """

    duration: float = MAX_DURATION
    box: tuple[float, float, float] | None = None
    speed: float | None = None
    effects: tuple[str, ...] = ()
    seed: int = 0

    @property
    def text(self) -> str:
        """The request as it is written."""
        values = {
            "duration": f"{self.duration:g}" if self.duration != MAX_DURATION else "",
            "box": "x".join(f"{side:g}" for side in self.box) if self.box is not None else "",
            "speed": f"{self.speed:g}" if self.speed is not None else "",
            "for": "+".join(self.effects),
            "seed": str(self.seed) if self.seed else "",
        }
        keys = ",".join(f"{key}={value}" for key, value in values.items() if value)
        return f"{IDENTIFY}:{keys}" if keys else IDENTIFY


def parse_request(text: str) -> ExperimentRequest:
    """A request from its text. Raises RequestError for an unknown key or an impossible value."""
    values: dict[str, str] = {}
    for pair in filter(None, text.partition(":")[2].split(",")):
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not equals or key not in KEYS:
            close = nearest(key, KEYS) if equals else ""
            problem = f"unknown key {key!r}{close}" if equals else f"{pair!r} is not key=value"
            raise RequestError(f"reference {text!r}: {problem}. Known: {', '.join(KEYS)}. {EXAMPLE}.")
        values[key] = value
    return ExperimentRequest(
        duration=_number(text, "duration", values.get("duration", f"{MAX_DURATION:g}"), MIN_DURATION, MAX_DURATION),
        box=_box(text, values["box"]) if "box" in values else None,
        speed=_number(text, "speed", values["speed"], 0.3, 50.0) if "speed" in values else None,
        effects=tuple(filter(None, (word.strip() for word in values.get("for", "").split("+")))),
        seed=int(_number(text, "seed", values.get("seed", "0"), 0, 1e9)),
    )


def named_effects(words: tuple[str, ...], catalogue: Mapping[str, Effect]) -> tuple[str, ...]:
    """The catalogue's effects for some words: an effect's name, or a part of several names, as drag or lag.

    Raises RequestError for a word that names none, or an effect that no flight can be planned for.
    """
    names: dict[str, None] = {}
    for word in words:
        written = word.lower().replace("-", "_")
        matching = [written] if written in catalogue else [n for n in catalogue if written in n.split("_")]
        if not matching:
            raise RequestError(
                f"no effect is called {word!r}{nearest(word, tuple(catalogue))}. Known: {', '.join(catalogue)}, and "
                "parts of these names, as in for=drag+inertia+lag."
            )
        names |= dict.fromkeys(matching)
    return tuple(names)


def volume(request: ExperimentRequest, vehicle: Vehicle) -> tuple[Floats, Floats]:
    """Lower and upper corner (3,) of where the vehicle's centre may be planned, m.

    Raises RequestError where the box and the vehicle file's leave too little.
    """
    own = vehicle.limits.box
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    if own is not None:
        low, high = np.array(own[0], dtype=float), np.array(own[1], dtype=float)
    if request.box is not None or own is None:
        width, depth, top = BOX if request.box is None else request.box
        low = np.maximum(low, [-width / 2, -depth / 2, 0.0])
        high = np.minimum(high, [width / 2, depth / 2, top])
    low[2] = max(low[2], MIN_HEIGHT)
    if np.any(high - low < MIN_SIDE):
        sides = " x ".join(f"{side:.2f}" for side in high - low)
        raise RequestError(
            f"an identification flight has no room: of the box {sides} m are left above {MIN_HEIGHT:g} m"
            f"{' and within the vehicle file' if own is not None else ''}. At least {MIN_SIDE:g} m are needed along "
            "each axis: give box=WIDTHxDEPTHxTOP in m, as in identify:box=4x4x2.5."
        )
    return low, high


def _number(text: str, key: str, value: str, lower: float, upper: float) -> float:
    try:
        number = float(value)
    except ValueError:
        raise RequestError(f"reference {text!r}: {key} = {value!r} is not a number. {EXAMPLE}.") from None
    if not lower <= number <= upper:
        raise RequestError(f"reference {text!r}: {key} = {value} is outside of {lower:g} to {upper:g}.")
    return number


def _box(text: str, value: str) -> tuple[float, float, float]:
    sides = [_number(text, "box", side, 0.1, 1000.0) for side in value.lower().split("x")]
    if len(sides) != 3:
        raise RequestError(f"reference {text!r}: box = {value!r} is not WIDTHxDEPTHxTOP in m. {EXAMPLE}.")
    return sides[0], sides[1], sides[2]
