"""Whether a vehicle can fly a reference; if not, which limit it exceeds, when, and the speed at which it could."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dynamics.errors import RequestError
from dynamics.references.flatness import ReferenceSamples
from dynamics.references.reference import Reference
from dynamics.vehicle import Vehicle

MARGIN = 0.05  # of the rotors' thrust range that is reserved for control at either end
STEP = 0.01  # s between the instants that are checked
BISECTIONS = 12


@dataclass(frozen=True)
class Excess:
    """A limit that a reference exceeds.

    quantity: what is limited.
    time: of the worst instant, s.
    value, limit: in unit.
    """

    quantity: str
    time: float
    value: float
    limit: float
    unit: str

    def __str__(self) -> str:
        """Excess: quantity, time and size."""
        word = "below" if self.value < self.limit else "above"
        return f"{self.quantity} {self.value:.3g} {self.unit} at {self.time:.2f} s, {word} {self.limit:.3g} {self.unit}"


@dataclass(frozen=True)
class Feasibility:
    """The verdict on one reference.

    excesses: the worst instant of every limit that is exceeded.
    feasible_speed: the greatest factor of speed without one, None where slower does not help.
    advice: what would be feasible, empty where all is.
    """

    reference: str
    excesses: tuple[Excess, ...]
    feasible_speed: float | None
    advice: str = ""

    @property
    def is_feasible(self) -> bool:
        """Whether every limit is kept."""
        return not self.excesses

    def require(self) -> None:
        """Raise a RequestError with the limits that are exceeded and the speed that would be feasible."""
        if self.is_feasible:
            return
        listed = "; ".join(map(str, self.excesses))
        raise RequestError(f"the vehicle cannot fly {self.reference}: {listed}; {self.advice}.")


def check_feasibility(
    reference: Reference, vehicle: Vehicle, *, ground: float = 0.0, margin: float = MARGIN
) -> Feasibility:
    """Check a reference every 10 ms: rotor thrusts, body rates, speed, height over ground (m), position box.

    margin: share of the rotors' thrust range that is reserved at either end.
    """
    excesses = exceeded_limits(_samples(reference), vehicle, ground, margin)
    slower = _feasible_speed(reference, vehicle, ground) if excesses else None
    return Feasibility(reference.name, excesses, slower, _advise(reference, slower) if excesses else "")


def _advise(reference: Reference, slower: float | None) -> str:
    """How to ask for the same at a factor of its speed."""
    if slower is None:
        return "slower does not help: change its place or shape"
    advice = f"at {slower:.2f} of its speed it would be feasible"
    if reference.speed is None:
        return f"{advice}: stretch its times by {1 / slower:.2f}"
    ramp = math.ceil(10 * reference.law.ramp / slower) / 10
    return f"{advice} (speed={math.floor(100 * slower * reference.speed) / 100:.2f},ramp={ramp:.1f})"


def slowed(reference: Reference, speed: float) -> Reference:
    """Path at a factor of the speed, ramps stretched with it."""
    law = reference.law
    law = replace(law, rate=law.rate * speed, ramp=law.ramp / speed, duration=law.duration / speed)
    return replace(reference, law=law, speed=None if reference.speed is None else reference.speed * speed)


def _samples(reference: Reference) -> ReferenceSamples:
    return reference.sample(np.arange(0.0, reference.duration + STEP, STEP))


def _feasible_speed(reference: Reference, vehicle: Vehicle, ground: float) -> float | None:
    """The greatest factor of speed at which every limit is kept, None when it is below a twentieth."""

    def fits(speed: float) -> bool:
        return not exceeded_limits(_samples(slowed(reference, speed)), vehicle, ground)

    return _bisect(fits, 0.05, 1.0)


def _bisect(fits: Callable[[float], bool], low: float, high: float) -> float | None:
    """The greatest value between low and high that fits, rounded down to 0.01; None when low does not."""
    if not fits(low):
        return None
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return int(100 * low) / 100


def exceeded_limits(
    motion: ReferenceSamples, vehicle: Vehicle, ground: float, margin: float = MARGIN
) -> tuple[Excess, ...]:
    """The worst instant of every limit of a vehicle that a motion exceeds. ground: height, m. margin: see above."""
    rotors, limits = vehicle.rotors, vehicle.limits
    full = rotors.thrust_constant * rotors.speed_max**2
    idle = rotors.thrust_constant * rotors.speed_min**2
    reserve = margin * (full - idle)
    thrust_min, thrust_max = vehicle.thrust_limits
    rows = [
        ("rotor thrust", motion.rotor_thrust, idle + reserve, full - reserve, "N"),
        ("collective thrust", motion.collective_thrust, thrust_min, thrust_max, "N"),
        ("speed", np.linalg.norm(motion.velocity, axis=1), -np.inf, limits.speed, "m/s"),
        ("height", motion.position[:, 2], ground, np.inf, "m"),
    ]
    for axis, rate, limit in zip(("roll", "pitch", "yaw"), motion.rate_body.T, limits.rate, strict=True):
        rows.append((f"{axis} rate", rate, -limit, limit, "rad/s"))
    if limits.box is not None:
        for axis, place, low, high in zip("xyz", motion.position.T, *limits.box, strict=True):
            rows.append((f"position {axis}", place, low, high, "m"))
    worst = (_worst(motion.time, name, np.asarray(values), low, high, unit) for name, values, low, high, unit in rows)
    return tuple(excess for excess in worst if excess is not None)


def _worst(time: np.ndarray, name: str, values: np.ndarray, low: float, high: float, unit: str) -> Excess | None:
    """The instant at which values (n,) or (n, k) are furthest outside of low to high, if they are at all."""
    values = values.reshape(len(time), -1)
    beyond = np.maximum(values - high, low - values)
    row, column = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
    if beyond[row, column] <= 1e-9:
        return None
    value = float(values[row, column])
    return Excess(name, float(time[row]), value, high if value > high else low, unit)
