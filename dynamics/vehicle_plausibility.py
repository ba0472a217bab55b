"""Whether a vehicle's mass, lengths and constants fit each other: a number in another unit does not.

disc loading       m g / (n pi R^2), N/m^2, with the largest discs that rotors in these places can have: 20 to 200 of
                   most multirotors, 1 of the human-powered Atlas, 600 of a cinema lifter
inertia            over mass times arm^2: 0.27 about x and y by rule (`dynamics.vehicle_sizing`)
static thrust      coefficient C_T = 4 pi^2 k_f / (rho D^4): 0.06 to 0.2 of propellers
tip speed          of a rotor at full speed, below that of sound by far

The bounds lie far outside these, so that they refuse no vehicle that flies and every one whose grams, millimetres,
inches, g cm^2 or revolutions per minute were taken for SI.
"""

from __future__ import annotations

import math

import numpy as np

from dynamics.errors import RequestError
from dynamics.vehicle import GRAVITY, Rotors, Vehicle

AIR_DENSITY = 1.2  # kg/m^3, at 20 degrees C near sea level
RANGES = {  # of what a user gives, with its unit
    "mass": (0.01, 200.0, "kg; 1000 g are 1"),
    "arm": (0.02, 3.0, "m, from the centre to a motor's axis; 225 mm are 0.225"),
    "propeller": (0.02, 2.0, "m, the diameter; 10 inches are 0.254"),
}
DISC_LOADING = (0.1, 3000.0)  # N/m^2
USUAL_LOADING = (5.0, 1000.0)  # N/m^2, of a number in another unit when it is read as one
TILT_INERTIA_SHARE = (0.003, 30.0)  # inertia over mass times arm^2
THRUST_COEFFICIENT_RANGE = (0.002, 5.0)
MAX_TIP_SPEED = 600.0  # m/s
MAX_MARGIN = 100.0  # thrust over weight
COINCIDENT = 0.05  # of the arm, below which one rotor is above the other
UNITS_OF_MASS = {"g": 1e-3}
UNITS_OF_LENGTH = {"mm": 1e-3, "cm": 1e-2, "inches": 0.0254}


def require_in_range(**values: float | None) -> None:
    """Raise RequestError for a mass, arm or propeller, in SI, that no vehicle has; None is not given."""
    for name, value in values.items():
        low, high, unit = RANGES[name]
        if value is not None and not low <= value <= high:
            raise RequestError(f"{name} = {value:g}: give {low:g} to {high:g} {unit}.")


def require_plausible(vehicle: Vehicle) -> None:
    """Raise RequestError for a vehicle whose mass, lengths, inertia and rotors cannot be of one vehicle."""
    body, rotors = vehicle.body, vehicle.rotors
    require_carried(body.mass, rotors, vehicle.name)
    arm = _arm(rotors)
    share = max(body.inertia[:2]) / (body.mass * arm**2)
    low, high = TILT_INERTIA_SHARE
    if not low <= share <= high:
        raise RequestError(
            f"{vehicle.name}: inertia {list(body.inertia)} kg m^2 is {share:.2g} of mass times arm^2 "
            f"({body.mass:g} kg, {arm:g} m); {low:g} to {high:g} are possible, 0.3 is usual. "
            "Check inertia (kg m^2; 1e7 g cm^2 are 1), "
            "mass (kg) and rotors.position (m)."
        )
    if math.hypot(*body.centre_of_mass[:2]) > arm:
        raise RequestError(
            f"{vehicle.name}: centre_of_mass {list(body.centre_of_mass)} m lies outside the rotors, whose arm is "
            f"{arm:g} m: it would fall over. Check centre_of_mass (m)."
        )
    margin = rotors.thrust_max / vehicle.weight
    if margin > MAX_MARGIN:
        raise RequestError(
            f"{vehicle.name}: all rotors at speed_max give {rotors.thrust_max:.3g} N, {margin:.3g} times the "
            f"weight; at most {MAX_MARGIN:g} times are possible. Check thrust_constant (N s^2/rad^2), "
            "speed_max (rad/s, not rpm) and mass (kg)."
        )
    if rotors.radius is not None:
        _require_propeller(vehicle, rotors.radius)


def require_carried(mass: float, rotors: Rotors, name: str) -> None:
    """Raise RequestError for a mass that rotors in these places cannot carry. mass: kg."""
    loading, (low, high) = disc_loading(mass, rotors), DISC_LOADING
    if low <= loading <= high:
        return
    raise RequestError(
        f"{name}: mass = {mass:g} kg on {rotors.count} rotors {_gap(rotors):.3g} m apart loads their discs with "
        f"{loading:.3g} N/m^2; {low:g} to {high:g} are possible, 20 to 200 usual. {_advice(mass, rotors, loading)}"
    )


def disc_loading(mass: float, rotors: Rotors) -> float:
    """Weight over the area of the largest discs that the rotors' places allow, N/m^2. mass: kg."""
    return mass * GRAVITY / (len(_places(rotors)) * math.pi * (_gap(rotors) / 2) ** 2)


def _advice(mass: float, rotors: Rotors, loading: float) -> str:
    """Advice on what to check, and on the other unit that would explain the number."""
    low, high = USUAL_LOADING
    for unit, factor in UNITS_OF_MASS.items():
        if low <= loading * factor <= high:
            return f"Give the mass in kg: {mass:g} {unit} are {mass * factor:g} kg."
    for unit, factor in UNITS_OF_LENGTH.items():
        if low <= loading / factor**2 <= high:
            arm = _arm(rotors)
            return f"Give lengths in m: an arm of {arm:.4g} {unit} is {arm * factor:.3g} m."
    return "Check the mass (kg) and the arm or rotors.position (m)."


def _require_propeller(vehicle: Vehicle, radius: float) -> None:
    """Raise RequestError for a propeller that does not fit the rotors. radius: m."""
    rotors = vehicle.rotors
    subject = f"{vehicle.name}: propellers of a radius of {radius:g} m"
    advice = "Check rotors.radius (m, half of the diameter; an inch is 0.0254)"
    if radius > _gap(rotors):
        raise RequestError(f"{subject} on rotors {_gap(rotors):.3g} m apart reach each other's axes. {advice}.")
    coefficient = 4 * math.pi**2 * rotors.thrust_constant / (AIR_DENSITY * (2 * radius) ** 4)
    low, high = THRUST_COEFFICIENT_RANGE
    if not low <= coefficient <= high:
        raise RequestError(
            f"{subject} have a thrust coefficient of {coefficient:.3g} by thrust_constant "
            f"{rotors.thrust_constant:.3g} N s^2/rad^2; {low:g} to {high:g} are possible, 0.1 is usual. "
            f"{advice}, thrust_constant and mass (kg)."
        )
    tip_speed = radius * rotors.speed_max
    if tip_speed > MAX_TIP_SPEED:
        raise RequestError(
            f"{subject} at speed_max {rotors.speed_max:g} rad/s have tips of {tip_speed:.0f} m/s; up to "
            f"{MAX_TIP_SPEED:g} are possible. {advice} and speed_max (rad/s, not rpm)."
        )


def _arm(rotors: Rotors) -> float:
    return max(math.hypot(x, y) for x, y, _ in rotors.position)


def _places(rotors: Rotors) -> list[tuple[float, float]]:
    """Where rotors are seen from above, those above each other once, m."""
    places: list[tuple[float, float]] = []
    for x, y, _ in rotors.position:
        if all(math.dist((x, y), other) > COINCIDENT * _arm(rotors) for other in places):
            places.append((x, y))
    return places


def _gap(rotors: Rotors) -> float:
    """Smallest distance of two rotors seen from above, m."""
    places = np.array(_places(rotors))
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1)
    return float(np.min(gaps[gaps > 0]))
