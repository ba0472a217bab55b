"""The family of manoeuvres: sums of sines in x, y, z and yaw, repeated lap by lap, as quick as the limits permit.

Multisines with harmonics of their own on every axis excite all axes at once with little correlation between them
(Morelli, "Multiple Input Design for Real-Time Parameter Estimation in the Frequency Domain", 2003).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.references.curve import FLAT, HarmonicCurve
from dynamics.references.feasibility import exceeded_limits
from dynamics.references.flatness import ReferenceSamples, flat_motion
from dynamics.references.reference import Reference
from dynamics.references.time_law import TimeLaw, travel
from dynamics.vehicle import Vehicle

HARMONICS = ((1, 2, 3, 4, 6), (1, 2, 3, 4, 6), (1, 2, 3, 5, 7), (1, 2, 3, 4, 5))  # of x, y, z, yaw
FULL = 3  # harmonic up to which amplitudes are alike; beyond it accelerations are
MIN_LAP, MAX_LAP = 1.5, 30.0  # s
RAMP = 3.0  # s from rest to full speed, and back
TURN = np.pi  # rad, greatest amplitude of yaw
MARGIN, MARGIN_SHARE = 0.3, 0.1  # m and share of a side that tracking errors may take
RATE_SHARE, SPEED_SHARE, THRUST_SHARE = 0.8, 0.95, 0.92  # of the vehicle's limits that are planned with
IDLE_SHARE = 0.02  # of a rotor's full thrust, below which none is planned
MAX_TILT = np.radians(70.0)
CHECKED = 160  # instants of a lap at which limits are checked
HALVINGS = 8  # of the interval in which the greatest rate is sought
LITTLE = 0.15  # of a leading sine, in random proportions


@dataclass(frozen=True, eq=False)
class Lap:
    """A closed curve that is flown over and over. rate: of its phase at full speed, rad/s."""

    curve: HarmonicCurve
    rate: float

    @property
    def duration(self) -> float:
        """Time around, s."""
        return 2 * np.pi / self.rate

    def at_pace(self, pace: float) -> Lap:
        """Curve at a factor of the speed."""
        return replace(self, rate=pace * self.rate)


@dataclass(frozen=True, eq=False)
class Family:
    """Manoeuvres of one vehicle in one volume.

    low, high: (3,) corners of the volume, m.
    duration: of a manoeuvre, ramps included, s.
    speed: limit, m/s.
    """

    vehicle: Vehicle
    low: Floats
    high: Floats
    duration: float
    speed: float

    @property
    def size(self) -> int:
        """Number of proportions: a cosine and a sine for every harmonic of every axis, and the share of the volume."""
        return 2 * sum(map(len, HARMONICS)) + 1

    def laps(self, lap: Lap) -> float:
        """How often a lap is flown, ramps as half of their time."""
        return (self.duration - RAMP) / lap.duration

    def drawn(self, random: np.random.Generator) -> Floats:
        """Random proportions (k,): a leading sine on every axis, and a little of all others."""
        parts = []
        for harmonics in HARMONICS:
            pairs = LITTLE * random.standard_normal((len(harmonics), 2))
            angle, leading = random.uniform(0, 2 * np.pi), random.integers(len(harmonics))
            pairs[leading] += random.uniform(0, 1.5) * np.array([np.cos(angle), np.sin(angle)])
            parts.append(pairs.ravel())
        return np.append(np.concatenate(parts), random.standard_normal())

    @cached_property
    def envelope(self) -> Floats:
        """(k,) usual size of the coefficients: alike up to the harmonic that fills the volume, beyond it of alike
        acceleration; of yaw, of alike acceleration."""
        position = [1.0 / np.maximum(1.0, np.array(h) / FULL) ** 2 for h in HARMONICS[:3]]
        yaw = 1.0 / np.array(HARMONICS[3]) ** 2
        return np.concatenate([np.repeat(part, 2) for part in (*position, yaw)])

    @cached_property
    def limited(self) -> Vehicle:
        """The vehicle with the limits that are planned with; the rest is for control and for what the model lacks."""
        limits, rotors = self.vehicle.limits, self.vehicle.rotors
        roll, pitch, yaw = (RATE_SHARE * rate for rate in limits.rate)
        speed = SPEED_SHARE * min(self.speed, limits.speed)
        tighter = msgspec.structs.replace(limits, rate=(roll, pitch, yaw), speed=speed, box=None)
        fastest = max(rotors.speed_max * THRUST_SHARE**0.5, self._hovering)
        slowest = max(rotors.speed_min, rotors.speed_max * IDLE_SHARE**0.5)
        weaker = msgspec.structs.replace(rotors, speed_min=slowest, speed_max=fastest)
        return msgspec.structs.replace(self.vehicle, limits=tighter, rotors=weaker)

    @property
    def _hovering(self) -> float:
        """Least speed of the rotors that a vehicle may have at all, rad/s: a little above hover's."""
        return 1.02 * self.vehicle.hover_speed

    def lap(self, proportions: Floats) -> Lap | None:
        """The quickest lap of these proportions within the limits, None if there is none. proportions: (k,)."""
        share = min(1.0, float(np.exp(0.5 * proportions[-1])))
        lap = Lap(self._fitted_into_volume(_tables(self.envelope * proportions[:-1]), share), 2 * np.pi / MIN_LAP)
        slow, quick = 2 * np.pi / MAX_LAP, lap.rate
        if not self.permits(replace(lap, rate=slow)):
            return None
        if self.permits(lap):
            return lap
        for _ in range(HALVINGS):
            middle = np.sqrt(slow * quick)
            slow, quick = (middle, quick) if self.permits(replace(lap, rate=middle)) else (slow, middle)
        return replace(lap, rate=float(slow))

    def permits(self, lap: Lap) -> bool:
        """Whether a lap at full speed keeps the limits that are planned with."""
        motion = self.motion(lap, np.linspace(0.0, lap.duration, CHECKED, endpoint=False))
        upright = 1 - 2 * np.sum(motion.attitude[:, 1:3] ** 2, axis=1)  # world z component of body z
        return bool(upright.min() > np.cos(MAX_TILT)) and not exceeded_limits(motion, self.limited, -np.inf)

    def motion(self, lap: Lap, times: Floats) -> ReferenceSamples:
        """The motion at times (n,) s of a lap at full speed; those before 0 belong to the preceding lap."""
        law = TimeLaw(lap.rate, 0.0, float(times[-1] - times[0]), lap.rate * float(times[0]))
        phase = law.phase(times - times[0])
        return flat_motion(times, travel(lap.curve.derivatives(phase[:, 0]), phase), self.vehicle)

    def reference(self, lap: Lap, name: str) -> Reference:
        """Lap after lap with ramps at both ends."""
        return Reference(name, lap.curve, TimeLaw(lap.rate, RAMP, self.duration), self.vehicle)

    @property
    def _centre(self) -> Floats:
        return (self.low + self.high) / 2

    def _fitted_into_volume(self, tables: tuple[Floats, Floats], share: float) -> HarmonicCurve:
        """A curve about the volume's centre whose x, y and z fill a share of it at most; yaw keeps within its turn."""
        shape = HarmonicCurve(*tables, np.zeros(FLAT))
        values = shape.derivatives(np.linspace(0, 2 * np.pi, 241))[:, 0]
        lowest, highest = values.min(axis=0), values.max(axis=0)
        side = self.high - self.low
        half = side / 2 - np.minimum(MARGIN, MARGIN_SHARE * side)
        extent = np.maximum((highest - lowest) / 2, 1e-9)
        factor = np.append(share * half * np.minimum(1.0, extent[:3]) / extent[:3], min(1.0, TURN / extent[3]))
        cosine, sine = tables[0] * factor, tables[1] * factor
        cosine[0] -= factor * (highest + lowest) / 2
        cosine[0, :3] += self._centre
        return HarmonicCurve(cosine, sine, np.zeros(FLAT))


def _tables(coefficients: Floats) -> tuple[Floats, Floats]:
    """Cosine and sine (harmonics + 1, 4) of a curve."""
    count = 1 + max(max(harmonics) for harmonics in HARMONICS)
    cosine, sine = np.zeros((count, FLAT)), np.zeros((count, FLAT))
    place = 0
    for axis, harmonics in enumerate(HARMONICS):
        pairs = coefficients[place : place + 2 * len(harmonics)].reshape(-1, 2)
        cosine[list(harmonics), axis], sine[list(harmonics), axis] = pairs.T
        place += 2 * len(harmonics)
    return cosine, sine
