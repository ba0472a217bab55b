"""The search for the manoeuvre that shows most, and the flight that comes out of it.

Random proportions first, then an evolution strategy from the best of them: separable CMA-ES (Ros and Hansen, "A Simple
Modification in CMA-ES Achieving Linear Time and Space Complexity", 2008). Same request, same seed, same flight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cmaes import SepCMA

from diagnosis.experiment.expectation import Expectation, ExpectedInterval, lap_times
from diagnosis.experiment.multisine import Family, Lap
from diagnosis.experiment.request import ExperimentRequest, named_effects, volume
from diagnosis.one_thread import one_thread
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.errors import RequestError
from dynamics.model import build_model
from dynamics.references.feasibility import check_feasibility
from dynamics.references.reference import Reference
from dynamics.references.table import as_read_back, write_table
from dynamics.trim import find_trim
from dynamics.vehicle import Vehicle

START_SHARE = 0.25  # of the trials that are random proportions
CHILDREN = 12  # of a generation
MAX_TRIES = 60  # random proportions that are tried for any that can be flown
STEP = 0.15  # of the strategy at its start, over a leading sine
THRUST_MARGIN = 0.055  # of the rotors' range at either end, a little more than a flight requires
SLOWER, MAX_SLOWER = 0.95, 14  # pace of a lap whose ramps exceed a limit that it keeps itself
Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class PlannedFlight:
    """An identification flight.

    request: what was asked for.
    reference: to fly, on the vehicle's trim. lap: that it repeats.
    effects: names of what it is to show.
    expected: intervals of their parameters after it.
    gain: mean of ln(prior / expected standard deviation) over the effects.
    family, expectation: that it was chosen from, and by.
    """

    request: ExperimentRequest
    reference: Reference
    lap: Lap
    effects: tuple[str, ...]
    expected: tuple[ExpectedInterval, ...]
    gain: float
    family: Family
    expectation: Expectation

    def at_pace(self, pace: float) -> PlannedFlight:
        """Path at another factor of the speed, with its expected intervals."""
        return _planned(self.request, self.family, self.expectation, self.lap.at_pace(pace), self.effects)

    def write_csv(self, path: str | Path) -> Path:
        """Write the reference as a table that `alula fly --reference` takes. Raises RequestError."""
        vehicle = self.reference.vehicle.name
        notes = [f"alula fly --reference {self.request.text} for {vehicle}"]
        notes += [f"{one.name}: {one.usual:.4g} +- {one.std:.2g} {one.unit} expected" for one in self.expected]
        return write_table(self.reference, Path(path), notes)


@one_thread
def plan_flight(
    vehicle: Vehicle,
    request: ExperimentRequest,
    catalogue: Mapping[str, Effect],
    progress: Progress = lambda _: None,
) -> PlannedFlight:
    """The manoeuvre of the family that shows the most of the effects. progress: called with the share that is done.

    Raises RequestError for unknown effects, and where the vehicle cannot fly anything in its volume.
    """
    effects = named_effects(request.effects, catalogue)
    low, high = volume(request, vehicle)
    limit = vehicle.limits.speed if request.speed is None else request.speed
    trim = find_trim(build_model(vehicle, catalogue=catalogue)).vehicle
    family = Family(trim, low, high, request.duration, limit)
    search = _Search(family, request.seed)
    example = search.example()
    expectation = Expectation(vehicle, catalogue, effects, family.motion(example, lap_times(example.duration)))
    best: Lap | None = None
    for done, lap in search.run(expectation):
        best = lap
        progress(done)
    if best is None:
        raise _impossible(family)
    return _planned(request, family, expectation, best, effects)


def _planned(
    request: ExperimentRequest, family: Family, expectation: Expectation, lap: Lap, effects: tuple[str, ...]
) -> PlannedFlight:
    lap, reference = _within_limits(family, lap, request.text)
    motion, laps = family.motion(lap, lap_times(lap.duration)), family.laps(lap)
    intervals, gain = expectation.intervals(motion, laps), expectation.gain(motion, laps)
    names = effects or tuple(dict.fromkeys(one.effect for one in intervals))
    return PlannedFlight(request, reference, lap, names, intervals, gain, family, expectation)


class _Search:
    """The best lap of a family so far, from random proportions and an evolution strategy."""

    def __init__(self, family: Family, seed: int) -> None:
        self._family, self._random = family, np.random.default_rng(seed)

    def example(self) -> Lap:
        """Any lap that the vehicle can fly. Raises RequestError where there is none."""
        random = np.random.default_rng(0)
        for _ in range(MAX_TRIES):
            lap = self._family.lap(self._family.drawn(random))
            if lap is not None:
                return lap
        raise _impossible(self._family)

    def run(self, expectation: Expectation) -> Iterator[tuple[float, Lap | None]]:
        """(share that is done, best lap) after every trial."""
        starts = round(START_SHARE * expectation.trials)
        generations = (expectation.trials - starts) // CHILDREN
        total = starts + generations * CHILDREN
        best, best_gain, mean = None, -np.inf, np.zeros(self._family.size)
        for trial in range(starts):
            drawn = self._family.drawn(self._random)
            lap, value = self._evaluated(drawn, expectation)
            if value > best_gain:
                best, best_gain, mean = lap, value, drawn
            yield (trial + 1) / total, best
        strategy = SepCMA(mean, STEP, population_size=CHILDREN, seed=int(self._random.integers(2**31)))
        for generation in range(generations):
            judged: list[tuple[Floats, float]] = []
            for place in range(CHILDREN):
                child = strategy.ask()
                lap, value = self._evaluated(child, expectation)
                judged.append((child, -value))
                if value > best_gain:
                    best, best_gain = lap, value
                yield (starts + generation * CHILDREN + place + 1) / total, best
            strategy.tell(judged)

    def _evaluated(self, proportions: Floats, expectation: Expectation) -> tuple[Lap | None, float]:
        lap = self._family.lap(proportions)
        if lap is None:
            return None, -np.inf
        return lap, expectation.gain(self._family.motion(lap, lap_times(lap.duration)), self._family.laps(lap))


def _within_limits(family: Family, lap: Lap, name: str) -> tuple[Lap, Reference]:
    """The reference of a lap, slower where it exceeds a limit as it is flown, which is from the table that is written.

    Raises RequestError where that does not help.
    """
    for _ in range(MAX_SLOWER):
        reference = family.reference(lap, name)
        if check_feasibility(as_read_back(reference), family.vehicle, margin=THRUST_MARGIN).is_feasible:
            return lap, reference
        lap = lap.at_pace(SLOWER)
    reference = family.reference(lap, name)
    check_feasibility(as_read_back(reference), family.vehicle).require()
    return lap, reference


def _impossible(family: Family) -> RequestError:
    sides = " x ".join(f"{side:.2f}" for side in family.high - family.low)
    limits = family.vehicle.limits
    return RequestError(
        f"{family.vehicle.name} can fly no identification flight in {sides} m at {family.speed:g} m/s with body rates "
        f"up to {limits.rate} rad/s and rotors up to {family.vehicle.rotors.speed_max:g} rad/s. Give a larger box or "
        "speed, or check the limits in the vehicle file."
    )
