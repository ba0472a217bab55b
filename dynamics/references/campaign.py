"""The paper's data set as a list: 68 flights by name, 60 to train and 8 to test (PI-TCN section IV-A).

The paper names its eight test manoeuvres; the rest, it writes, range from straight lines to circles,
parabolas and lemniscates, in every combination of axes, with different speeds, 58 min in all, up to 6 m/s, 18 m/s^2,
54 rad/s^2 and 16,628 rpm. The eight were drawn from the 68 at random, so that the others are of their kind and as
fast. The test flights here are its eight; the training flights never repeat one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

import numpy as np

from dynamics.errors import RequestError
from dynamics.references import MANOEUVRES, PAPER
from dynamics.spelling import unknown

Split = Literal["train", "test"]

PAPER_DURATION = 58 * 60 + 3.0  # s, all flights together
TRAINING_DURATION = 53.4  # s of one training flight, in whole laps, so that all flights last as long as the paper's
RAMP = 3.0  # s, a reference's usual one
SPEEDS = (60, 100)  # per cent of the manoeuvre's own
BELOW = {"WarpedEllipse_2_xz": 95, "WarpedEllipse_2_yz": 95}  # at their own they pass the paper's 54 rad/s^2 by far
SMALL = "size=0.92,speed=1.03"  # a test flight's accelerations (0.98) and jerks (1.01) on another path
PLANES = ("xy", "xz", "yz")
SHAPES = (
    "Ellipse_2",
    "WarpedEllipse_2",
    "Lemniscate",
    "ExtendedLemniscate",
    "Parabola",
    "TransposedParabola",
    "circle",
)
PLAINER = {
    "TransposedParabola_wide": "TransposedParabola:size=1.15,speed=0.92",  # 17 m/s^2
    "WarpedEllipse_1_xz": "WarpedEllipse_1:plane=xz",
    "WarpedEllipse_1_yz": "WarpedEllipse_1:plane=yz",
    "line_x_60": "line:speed=0.6",
    "line_x_100": "line",
    "line_x_wide": "line:size=2.4",  # 6 m/s
    "line_y_60": "line:plane=yx,speed=0.6",
    "line_y_100": "line:plane=yx",
    "line_y_wide": "line:plane=yx,size=1.8",
    "line_z_100": "bob",
    "line_z_130": "bob:speed=1.3",
    "line_z_wide": "bob:size=2.0",
    "circle_xy_wide": "circle:size=1.3,speed=1.3",
    "yaw_spin_70": "yaw_spin:speed=0.7",
    "yaw_spin_130": "yaw_spin:speed=1.3",
    "low_flight_70": "low_flight:speed=0.7",
    "low_flight_130": "low_flight:speed=1.3",
    "hover": "hover",
}
# Effects that stand for what the paper's real vehicle had and its nominal model lacks: drags, flapping and inflow of
# usual size, thrust and inertia a few per cent off the vehicle file's, and moving air.
REAL_WORLD = (
    "motor_lag:time_constant=0.035",
    "rotor_drag:coefficient=2.2e-5",
    "parasitic_drag:coefficient=0.01",
    "blade_flapping:coefficient=-3e-7",
    "axial_inflow:coefficient=1e-5",
    "translational_lift:coefficient=4e-4",
    "thrust_constant:ratio=0.96",
    "inertia:ratio_x=1.08,ratio_y=1.05,ratio_z=0.94",
    "gust:intensity=0.25,correlation_time=1.0",
)


@dataclass(frozen=True)
class CampaignFlight:
    """One flight of a campaign.

    name: of its file.
    reference: for `dynamics.references.named_reference`.
    split: whether it trains or tests.
    """

    name: str
    reference: str
    split: Split


def paper_campaign() -> tuple[CampaignFlight, ...]:
    """The 68 flights, test flights first."""
    tests = [CampaignFlight(name, name, "test") for name in PAPER]
    shaped = [_shaped(shape, plane, speed) for shape in SHAPES for plane in PLANES for speed in SPEEDS]
    plainer = [CampaignFlight(name, _in_laps(reference), "train") for name, reference in PLAINER.items()]
    return (*tests, *shaped, *plainer)


def chosen_flights(flights: Sequence[CampaignFlight], patterns: Sequence[str]) -> tuple[CampaignFlight, ...]:
    """Flights whose name or split matches one of the patterns, such as `Lemniscate*` or `test`; all without a pattern.

    Raises RequestError for a pattern that matches none.
    """
    if not patterns:
        return tuple(flights)
    for pattern in patterns:
        if not any(_matches(flight, pattern) for flight in flights):
            names = ("test", "train", *(flight.name for flight in flights))
            raise RequestError(f"no flight of the campaign is called {pattern!r}{unknown(pattern, names)}")
    return tuple(flight for flight in flights if any(_matches(flight, pattern) for pattern in patterns))


def _matches(flight: CampaignFlight, pattern: str) -> bool:
    return fnmatchcase(flight.name, pattern) or flight.split == pattern


def _shaped(shape: str, plane: str, speed: int) -> CampaignFlight:
    """A training flight of a shape in a plane; where that is a test flight, a smaller and faster one."""
    if speed == 100 and shape in PAPER and plane == PAPER[shape].plane:
        return CampaignFlight(f"{shape}_{plane}_small", _in_laps(f"{shape}:plane={plane},{SMALL}"), "train")
    speed = min(speed, BELOW.get(f"{shape}_{plane}", speed))
    return CampaignFlight(f"{shape}_{plane}_{speed}", _in_laps(f"{shape}:plane={plane},speed={speed / 100}"), "train")


def _in_laps(reference: str) -> str:
    """The reference with the whole number of laps that lasts nearest to a training flight."""
    name, _, rest = reference.partition(":")
    speed = next((float(pair.split("=")[1]) for pair in rest.split(",") if pair.startswith("speed=")), 1.0)
    lap = 2 * np.pi / (MANOEUVRES[name].rate * speed)
    laps = max(1, round((TRAINING_DURATION - RAMP) / lap))
    return f"{name}:{rest},laps={laps}" if rest else f"{name}:laps={laps}"
