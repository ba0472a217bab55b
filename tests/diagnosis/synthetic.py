"""Effects and segments made of a few arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.selection.candidates import Candidate
from dynamics.effect import Effect, Parameter, Prior, Wrench
from dynamics.vehicle import GRAVITY, Vehicle

CHANNELS = 12


def effect(
    name: str, *, bound: float = 10.0, lowest: float | None = None, parameters: Sequence[str] = ("size",)
) -> Effect:
    """An effect of parameters between plus and minus a bound, or a lowest value and the bound; usually 1."""
    low = -bound if lowest is None else lowest
    made = tuple(Parameter(p, "1", "", low, bound, lambda vehicle: Prior(1.0, 1.0)) for p in parameters)
    return Effect(name, "", "", made, wrench=lambda conditions, values, states: Wrench(0, 0))


def candidate(of: Effect) -> Candidate:
    """The effect at its neutral values, linear in all of them."""
    names = tuple(p.name for p in of.parameters)
    return Candidate(of, None, {p.name: p.neutral for p in of.parameters}, names)


def hovering(
    vehicle: Vehicle, *, mass_ratio: float, seed: int, count: int = 1, duration: float = 12.0
) -> tuple[Segment, ...]:
    """Segments with changing thrust and without rotation, as accelerometer and gyro read them; no pose was logged.

    mass_ratio: true mass over the vehicle file's.
    """
    rate, random = 50.0, np.random.default_rng(seed)
    n = round(duration * rate)
    time = np.arange(n) / rate
    segments = []
    for i in range(count):
        waves = sum(0.1 * np.sin(2 * np.pi * f * time + random.uniform(0, 6)) for f in (0.4, 0.9, 1.7, 2.6))
        speed = vehicle.hover_speed * np.sqrt(1 + waves)[:, None] * np.ones(vehicle.rotors.count)
        force = np.zeros((n, 3))
        force[:, 2] = GRAVITY * (1 + waves) / mass_ratio
        segments.append(
            Segment(
                flight=f"flight_{i}",
                start=0.0,
                rate=rate,
                position=np.zeros((n, 3)),
                velocity=np.zeros((n, 3)),
                attitude=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
                gyro=0.01 * random.standard_normal((n, 3)),
                specific_force=force + 0.1 * random.standard_normal((n, 3)),
                rotor_speed=speed + 0.5 * random.standard_normal(speed.shape),
                rotor_source="measured",
                battery_ratio=None,
                lacks=frozenset({"position", "velocity", "attitude"}),
            )
        )
    return tuple(segments)
