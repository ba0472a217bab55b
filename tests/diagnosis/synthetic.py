"""Regressions and segments made of a few arrays, with known solutions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.noise import NoiseModel
from diagnosis.selection.regression import Regression, marginal
from diagnosis.selection.regression_of_flights import flight_equations
from diagnosis.selection.sensor_errors import Biases
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect, Parameter, Prior, Wrench
from dynamics.vehicle import GRAVITY, Vehicle

CHANNELS = 12
RATE = 25.0
NO_BIASES = Biases((), np.zeros(0))


def white(active: Sequence[int] = range(CHANNELS)) -> NoiseModel:
    """Noise that is white and of unit size already."""
    count = len(active)
    floor = np.zeros(CHANNELS)
    floor[list(active)] = 1.0
    return NoiseModel(tuple(active), np.ones((count, 1)), np.ones(count), np.eye(count), floor)


def effect(
    name: str, *, bound: float = 10.0, lowest: float | None = None, parameters: Sequence[str] = ("size",)
) -> Effect:
    """An effect of parameters between plus and minus a bound, or a lowest value and the bound; usually 1."""
    low = -bound if lowest is None else lowest
    made = tuple(Parameter(p, "1", "", low, bound, lambda vehicle: Prior(1.0, 1.0)) for p in parameters)
    return Effect(name, "", "", made, wrench=lambda conditions, values, states: Wrench(0, 0))


def candidate(of: Effect, *columns: int) -> Candidate:
    """The effect with one column for each of its parameters."""
    names = tuple(p.name for p in of.parameters)
    return Candidate(of, None, {p.name: p.neutral for p in of.parameters}, names, columns)


def regression(
    vehicle: Vehicle,
    candidates: Sequence[Candidate],
    columns: Sequence[Floats],
    rows: Sequence[Floats],
    *,
    biases: Biases = NO_BIASES,
    segments: Sequence[Segment] = (),
    catalogue: Mapping[str, Effect] | None = None,
    thresholds: Thresholds = DEFAULT,
) -> Regression:
    """A regression of rows (m, 12) on columns (m, 12, k), a flight each, under white noise of unit size."""
    noise = white()
    flights = [
        flight_equations([(noise.whiten(x), noise.whiten(y), np.zeros_like(x), np.zeros_like(y))])
        for x, y in zip(columns, rows, strict=True)
    ]
    free = [marginal(one.gram, one.product, biases) for one in flights]
    grams, products = [gram for gram, _ in free], [product for _, product in free]
    return Regression(
        vehicle=vehicle,
        catalogue=catalogue or {c.effect.name: c.effect for c in candidates},
        segments=segments,
        flight_of=tuple(range(len(rows))),
        candidates=tuple(candidates),
        noise=noise,
        rows=list(rows),
        columns=list(columns),
        gram=grams,
        product=products,
        plain_gram=grams,
        plain_product=products,
        joint_gram=[one.gram for one in flights],
        joint_product=[one.product for one in flights],
        observations=[y.size for y in rows],
        rate=RATE,
        biases=biases,
        design=None,  # type: ignore[arg-type]
        everything=np.zeros(columns[0].shape[2]),
        equations=flights,
        thresholds=thresholds,
    )


def planted(
    vehicle: Vehicle, theta: Sequence[float], *, seed: int, flights: int = 6, rows: int = 80, **more: object
) -> Regression:
    """Effects a, b, c.. with one random column each, of which theta is in the rows, with unit white noise."""
    random = np.random.default_rng(seed)
    columns = [random.standard_normal((rows, CHANNELS, len(theta))) for _ in range(flights)]
    residuals = [x @ np.array(theta) + random.standard_normal((rows, CHANNELS)) for x in columns]
    candidates = [candidate(effect(chr(ord("a") + i)), i) for i in range(len(theta))]
    return regression(vehicle, candidates, columns, residuals, **more)  # type: ignore[arg-type]


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
