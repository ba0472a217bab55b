"""Cases of planted truth: which effects are hidden, how large, and the flights, flown once and kept in build/."""

from __future__ import annotations

import os
import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from diagnosis.data.dataset import Dataset, make_dataset
from diagnosis.data.segment import Segment
from diagnosis.estimation.evaluation import floor_norms
from diagnosis.models import channels
from diagnosis.selection.candidates import Candidate, make_predictor
from diagnosis.selection.design_matrix import DesignMatrix
from diagnosis.selection.regression import Regression
from diagnosis.selection.regression_of_flights import make_regression
from dynamics.arrays import Floats
from dynamics.effect import Parameter
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.compiled_flights import compiled_flights
from fixtures.foreign_effects import FOREIGN
from fixtures.planted import noisy, planted_flights
from fixtures.rotorpy_flights import MADE, PLACED, rotorpy_flights
from fixtures.rotorpy_sensors import READ_HERE
from flights import Flight
from vehicles import FOLDER

FLOWN = Path("build/planted_truth")
EVERYTHING = {**CATALOGUE, **FOREIGN}
BY_COMMAND = ("motor_lag", "battery_sag")  # not observable with measured rotor speeds
BY_SPEED = (
    "rotor_speed_fault",
    "rotor_gyroscopic",
)  # not observable from commands: a reading, and the rotors' acceleration
COMMANDS_SHARE = 0.15  # of the other cases whose logs hold commands only
# Effects that no data can separate cannot be a fair pair.
INSEPARABLE = (
    {"thrust_constant", "mass", "inertia", "battery_sag", "slung_load"}, {"torque_constant", "inertia"},
    {"weak_rotor", "centre_of_mass", "rotor_speed_fault"}, {"wind", "gust"}, {"rotor_drag", "linear_drag"},
)  # fmt: skip
INSIDE = 0.1  # of a parameter's range that keeps away from its bounds
MIN_MOTORS = 0.045  # s of lag with which the controllers are stable
MOCK_CANNOT = ("motor_lag", "rotor_speed_fault")  # it always has a lag; its speed sensors fail by option only
ROTORPY_CANNOT_SIZE = ("wind", "gust")  # they need a drag in the vehicle file


@dataclass(frozen=True)
class Case:
    """Hidden effect (nothing if empty), times the noise floor that it makes, factor on the noise, seed, simulator."""

    kind: str
    effects: tuple[str, ...]
    strength: float
    noise: float
    seed: int
    source: str

    @property
    def key(self) -> str:
        """Unique name."""
        return f"{self.source} {self.kind} {'+'.join(self.effects)} {self.strength:g} {self.noise:g} {self.seed}"

    @property
    def random(self) -> np.random.Generator:
        """Numbers that depend on the case alone."""
        return np.random.default_rng([*self.key.encode()])

    @property
    def commands(self) -> bool:
        """Whether the logs hold the motors' commands instead of their speeds."""
        if self.source == "mock":
            return False
        if any(name in BY_COMMAND for name in self.effects):
            return True
        return bool(self.random.random() < COMMANDS_SHARE) and not set(self.effects) & set(BY_SPEED)


@cache
def vehicle() -> Vehicle:
    """The vehicle that is flown; its file names no effect."""
    return read_vehicle(FOLDER / "arpl_250g.toml")


def names(source: str) -> list[str]:
    """Effects that a simulator can hide."""
    if source == "rotorpy":
        return [n for n in CATALOGUE if n in (*MADE, *READ_HERE, *PLACED) and n not in ROTORPY_CANNOT_SIZE]
    return [n for n in CATALOGUE if source != "mock" or n not in MOCK_CANNOT]


def pairs(source: str, count: int, seed: int) -> list[tuple[str, str]]:
    """Pairs of effects that flights can tell apart, drawn at random."""
    random = np.random.default_rng(seed)
    usable = [n for n in names(source) if n not in ("gust", "time_delay")]
    chosen: list[tuple[str, str]] = []
    while len(chosen) < count:
        first, second = sorted(random.choice(usable, 2, replace=False).tolist())
        if fair((first, second)) and (first, second) not in chosen:
            chosen.append((first, second))
    return chosen


def fair(pair: Sequence[str]) -> bool:
    """Whether one kind of log shows both effects and tells them apart."""
    alike = any(set(pair) <= group for group in INSEPARABLE)
    return (
        not alike
        and "rotor_speed_fault" not in pair
        and not (set(pair) & set(BY_COMMAND) and set(pair) & set(BY_SPEED))
    )


def fly(source: str, uses: Sequence[EffectUse], noise: float, seed: int, *, commands: bool = False) -> list[Flight]:
    """Nine flights by one of the simulators."""
    if source == "mock":
        return planted_flights(vehicle(), uses, seed=seed, options=noisy(noise))
    if source == "rotorpy":
        return rotorpy_flights(vehicle(), uses, seed=seed, noise=noise, commands=commands)
    return compiled_flights(vehicle(), uses, catalogue=EVERYTHING, seed=seed, noise=noise, commands=commands)


def flown(case: Case) -> tuple[Dataset, list[EffectUse]]:
    """The data of a case and what is hidden in it, flown or taken from the disk."""
    path = FLOWN / f"{case.key}.pickle"
    if path.exists():
        uses, parts = pickle.loads(path.read_bytes())
        flights = [Flight(*part) for part in parts]
    else:
        uses = [planted(name, case) for name in case.effects]
        seed = int(case.random.integers(2**31))
        flights = fly(case.source, uses, case.noise, seed, commands=case.commands)
        FLOWN.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_bytes(pickle.dumps((uses, [_parts(f) for f in flights])))
        part.replace(path)
    return make_dataset(flights, vehicle()), uses


def _parts(flight: Flight) -> tuple[object, ...]:
    """Parts that make the flight, for pickle, which knows no read-only dictionaries."""
    columns, origins = dict(flight.columns), dict(flight.origins)
    return (flight.time, columns, flight.provenance, origins, dict(flight.parameters), dict(flight.metadata))


@cache
def yardstick(source: str, noise: float, commands: bool) -> Regression:
    """A regression on flights that hide nothing, against which the size of an effect is measured."""
    data = make_dataset(fly(source, [], noise, 9000, commands=commands), vehicle())
    regression = make_regression(vehicle(), CATALOGUE, data.fitted, data.flight_of)
    design = DesignMatrix(vehicle(), CATALOGUE, regression.candidates, data.fitted[0])
    regression.columns = [design.evaluate(s, instrumented=False)[1] for s in data.fitted]  # what really shows
    return regression


def planted(name: str, case: Case) -> EffectUse:
    """The effect at the size that makes `strength` times the noise floor at its best channel."""
    regression = yardstick(case.source, case.noise, case.commands)
    random = case.random
    if name in FOREIGN:
        candidate = Candidate(FOREIGN[name], None, {"amplitude": 0.0}, ("amplitude",), (0,))
        return EffectUse(name, {"amplitude": case.strength / shown(regression, candidate, np.ones(1))})
    if name == "gust":
        wind = next(c for c in regression.candidates if c.effect.name == "wind")
        size = case.strength / shown(regression, wind, np.full(len(wind.free), 1.0))
        return EffectUse("gust", {"intensity": min(size, 14.0), "correlation_time": float(random.uniform(0.6, 2.0))})
    mine = [c for c in regression.candidates if c.effect.name == name]
    candidate = mine[int(random.integers(len(mine)))]
    if candidate.fixed_shape:
        size = case.strength / shown(regression, candidate, np.ones(1))
        values = {k: float(v * size) for k, v in candidate.at.items()}
        if name == "motor_lag":
            values = {k: float(np.clip(v, 0.004, MIN_MOTORS)) for k, v in values.items()}
        return EffectUse(name, values, candidate.rotor)
    parameters = {p.name: p for p in candidate.effect.parameters}
    towards = np.array([direction(parameters[n], random) for n in candidate.free])
    size = case.strength / shown(regression, candidate, towards)
    values = {n: candidate.at[n] + size * t for n, t in zip(candidate.free, towards, strict=True)}
    inside = {n: INSIDE * (parameters[n].upper - parameters[n].lower) for n in values}  # a bound is where guesses end
    clipped = {
        n: float(np.clip(v, parameters[n].lower + inside[n], parameters[n].upper - inside[n]))
        if parameters[n].lower != parameters[n].neutral
        else float(np.clip(v, parameters[n].lower, parameters[n].upper - inside[n]))
        for n, v in values.items()
    }
    return EffectUse(name, {**candidate.at, **clipped}, candidate.rotor)


def direction(parameter: Parameter, random: np.random.Generator) -> float:
    """From neutral towards the usual value, more or less, or to either side where there is no side."""
    prior = parameter.prior(vehicle())
    usual = prior.mean - parameter.neutral
    return float(usual * random.uniform(0.6, 1.4) if usual else prior.std * random.normal())


def shown(regression: Regression, candidate: Candidate, towards: Floats) -> float:
    """RMS that a change of the candidate's coefficients makes, over the floor, at the kind that shows it best."""
    if candidate.effect.name in FOREIGN:
        columns = [_foreign(regression, candidate, s) for s in regression.segments]
    else:
        columns = [x[:, :, list(candidate.columns)] for x in regression.columns]
    made = np.vstack([x @ towards for x in columns])
    floor = list(floor_norms(regression.noise.floor).values())
    return max(
        float(np.sqrt(np.mean(np.sum(made[:, 3 * i : 3 * i + 3] ** 2, axis=1))) / floor[i])
        for i in range(4)
        if floor[i]
    )


def _foreign(regression: Regression, candidate: Candidate, segment: Segment) -> Floats:
    predictor = make_predictor(regression.vehicle, EVERYTHING, candidate, segment)
    return channels.predicted(segment, predictor.slopes(segment, candidate.values))
