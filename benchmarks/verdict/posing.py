"""From a case to its logs, its vehicle file and its truth, by source.

own, mock: nine flights of the compiled simulator (`recorder`: speeds or commands) or of the mock's plant.
short: one log of 22 s. campaign: ten fast flights of `alula campaign`.
outside: `recorder` is the kind of a draw of `fixtures.outside_draws`, whose vehicle, paths and sizes its seed draws.
px4_like: a change of `fixtures.outside_sih`, logged as real PX4 logs.
recorded: logs of the folder of recordings, `bundled`: of tests/data. statements: a set of `fixtures.real_flights`.
mutated: a mutation of `fixtures.mutated_flights`.
"""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.verdict.cases import Case
from benchmarks.verdict.scoring import NAMES, Expected
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.campaign_logs import campaign_logs, nine_effects
from fixtures.compiled_flights import compiled_flights
from fixtures.fleet_flights import SHORT, fleet_flight
from fixtures.flight_store import stored, stored_together
from fixtures.foreign_effects import FOREIGN
from fixtures.mutated_flights import FLOWN, MUTATIONS, USUAL
from fixtures.outside_draws import Draw, drawn
from fixtures.outside_sih import PATHS, SihFlight, change, fly_sih, sih_flight
from fixtures.planted import noisy, planted_flights
from fixtures.real_flights import DATA
from flights import Flight
from vehicles import FOLDER

RECORDINGS = "ALULA_RECORDINGS"  # folder of recorded flights that are too large for this repository
SPREAD = 1.25  # factor on a hidden size, up or down
MEDIUM = 0.4  # times the noise, from which on a hidden effect must be named
SIH_DURATION = 34.0  # s of each flight
ALIKE = (  # which no data of a mutated log can tell apart
    {"thrust_constant", "mass", "torque_constant", "inertia", "battery_sag"},
    {"weak_rotor", "centre_of_mass", "rotor_speed_fault", "rotor_cant"},
    {"rotor_drag", "linear_drag", "parasitic_drag", "blade_flapping"},
    {"imu_lever_arm", "centre_of_mass", "pose_lever_arm"},
    {"time_delay", "attitude_delay"},
)
OF_MUTATED: tuple[EffectUse | None, ...] = (
    None,
    None,
    EffectUse("rotor_drag", {"coefficient": 3e-5}),
    EffectUse("inertia", {"ratio_x": 1.15, "ratio_y": 1.15, "ratio_z": 1.0}),
    EffectUse("centre_of_mass", {"x": 0.004, "y": -0.002, "z": 0.0}),
)


@dataclass(frozen=True, eq=False)
class Posed:
    """A question as a user would ask it, and its truth.

    logs: flights, or files. normal: normal flights to compare hover with. hold_out: pattern of the file names.
    conditions: how it was flown, in words.
    """

    logs: Sequence[Flight | Path]
    vehicle: Vehicle | Path
    expected: Expected
    normal: Sequence[Path] = ()
    hold_out: str | None = None
    conditions: Mapping[str, Any] = field(default_factory=dict)


class LostFlightsError(Exception):
    """The vehicle did not keep its path, in no milder flight either: there is nothing to ask."""


def pose(case: Case, folder: Path) -> Posed:
    """Logs, vehicle and truth of a case. folder: for files. Raises LostFlightsError, RequestError."""
    return SOURCES[case.entry.source](case, folder)


def recordings() -> Path | None:
    """Folder of recordings, if one is named."""
    named = os.environ.get(RECORDINGS)
    return Path(named) if named else None


def expected_of(case: Case, hidden: Mapping[str, Mapping[str, float]]) -> Expected:
    """The truth where every hidden effect must be named, or answered with `unknown` where no catalogue has it."""
    inside = {name: values for name, values in hidden.items() if name in CATALOGUE or name in NAMES}
    outside = len(inside) < len(hidden)
    allowed = (*case.entry.allowed, *(("unknown",) if outside else ()))
    return Expected(inside, () if outside else tuple(inside), case.entry.also, allowed, outside)


def _own(case: Case, _: Path) -> Posed:
    hidden, vehicle = _sized(case), read_vehicle(FOLDER / "arpl_250g.toml")
    uses = [_use(name, values) for name, values in hidden.items()]
    entry = case.entry
    commands = entry.recorder == "commands"
    fly = partial(
        compiled_flights, vehicle, uses, catalogue={**CATALOGUE, **FOREIGN}, seed=case.seed, noise=entry.noise,
        commands=commands,
    )  # fmt: skip
    return Posed(stored(fly, "own", uses, case.seed, entry.noise, commands), vehicle, expected_of(case, hidden))


def _mock(case: Case, _: Path) -> Posed:
    hidden, vehicle = _sized(case), read_vehicle(FOLDER / "arpl_250g.toml")
    uses = [_use(name, values) for name, values in hidden.items()]
    logs = planted_flights(vehicle, uses, seed=case.seed, options=noisy(case.entry.noise))
    return Posed(logs, vehicle, expected_of(case, hidden))


def _short(case: Case, _: Path) -> Posed:
    hidden, vehicle = _sized(case), read_vehicle(FOLDER / "arpl_250g.toml")
    uses = [_use(name, values) for name, values in hidden.items()]
    log = stored(partial(fleet_flight, vehicle, uses, case.seed, SHORT), "short", uses, case.seed)
    return Posed([log], vehicle, expected_of(case, hidden))


def _campaign(case: Case, folder: Path) -> Posed:
    nine = case.entry.name == "nine"
    files = campaign_logs(nine=nine, seed=case.seed)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    hidden = {use.name: dict(use.parameters) for use in nine_effects()} if nine else {}
    required = tuple(name for name in hidden if name not in ("gust", "motor_lag"))  # speeds are measured
    truth = Expected(hidden, required, case.entry.also, case.entry.allowed)
    return Posed(sorted(folder / name for name in files), FOLDER / "arpl_250g.toml", truth)


def _outside(case: Case, folder: Path) -> Posed:
    (logs,) = drawn([_draw(case)])
    if logs is None:
        raise LostFlightsError
    files = logs.write(folder)
    truth = expected_of(case, logs.hidden)
    strength = max(logs.strength.values())
    commands = logs.conditions["recorder"]["commands"]
    visible = [n for n in truth.required if n != "gust" and (n != "motor_lag" or commands)]
    if strength < MEDIUM:
        visible = []
        if truth.outside:
            truth = msgspec.structs.replace(truth, allowed=(*truth.allowed, "explained"))
    truth = msgspec.structs.replace(truth, required=tuple(visible))
    conditions = {**logs.conditions, "strength": strength}
    return Posed(files, folder / "vehicle.toml", truth, conditions=conditions)


def _draw(case: Case) -> Draw:
    return Draw(case.entry.recorder, case.entry.name, case.seed)


def _px4_like(case: Case, folder: Path) -> Posed:
    hidden, files = _sih_logs([case])[0]
    for name, content in files.items():
        (folder / name).write_bytes(gzip.decompress(content))
    logs = sorted(folder / name for name in files)
    return Posed(logs, FOLDER / "px4_sih.toml", expected_of(case, hidden))


Sih = tuple[dict[str, dict[str, float]], dict[str, bytes]]


def _sih_logs(cases: Sequence[Case]) -> list[Sih]:
    """Hidden effects of each case, and its two or three ULogs, compressed."""
    return stored_together(_fly_sih, [("px4_like", case.entry.name, case.seed) for case in cases])


def _fly_sih(requests: Sequence[tuple[str, str, int]]) -> list[Sih]:
    vehicle = read_vehicle(FOLDER / "px4_sih.toml")
    plans: list[SihFlight] = []
    places: list[tuple[int, str]] = []
    hidden_changes = []
    for number, (_, name, seed) in enumerate(requests):
        random = np.random.default_rng([seed, *name.encode()])
        hidden, count = change(name, random), int(random.integers(2, 4))
        hidden_changes.append(hidden)
        for path in random.permutation(PATHS)[:count]:
            plans.append(sih_flight(str(path), vehicle, hidden, SIH_DURATION, int(random.integers(2**31))))
            places.append((number, f"{str(path).partition(':')[0]}.ulg"))
    files: list[dict[str, bytes]] = [{} for _ in requests]
    for (number, name), log in zip(places, fly_sih(plans) if plans else (), strict=True):
        if log is not None:
            files[number][name] = gzip.compress(log, 1)
    return list(zip(hidden_changes, files, strict=True))


def _recorded(case: Case, _: Path) -> Posed:
    if (folder := recordings()) is None:
        raise RequestError(f"no folder of recordings. Name it with --recordings or {RECORDINGS}.")
    return _of_files(case, folder)


def _bundled(case: Case, _: Path) -> Posed:
    return _of_files(case, DATA)


def _of_files(case: Case, folder: Path) -> Posed:
    entry = case.entry
    own_file = folder / entry.vehicle
    vehicle = read_vehicle(own_file if own_file.is_file() else FOLDER / f"{entry.vehicle}.toml")
    if entry.bare:
        vehicle = msgspec.structs.replace(vehicle, effects=())
    logs, normal = ([folder / name for name in names] for names in (entry.files, entry.normal))
    return Posed(logs, vehicle, expected_of(case, entry.hidden), normal, entry.hold_out)


def _mutated(case: Case, folder: Path) -> Posed:
    random = np.random.default_rng([2026, case.seed])
    use, commands = OF_MUTATED[int(random.integers(len(OF_MUTATED)))], bool(random.random() < 0.35)
    seed = 100 + int(random.integers(4))
    vehicle, uses = read_vehicle(FOLDER / "arpl_250g.toml"), [use] if use else []
    manoeuvres = tuple(FLOWN.get(case.entry.name, USUAL))
    fly = partial(
        compiled_flights, vehicle, uses, catalogue=CATALOGUE, seed=seed, commands=commands, manoeuvres=manoeuvres
    )
    flights = stored(fly, "mutated", uses, seed, commands, manoeuvres)
    mutated = MUTATIONS[case.entry.name](flights, vehicle, random)
    logs = [flight.to_csv(folder / f"flight_{i}.csv") for i, flight in enumerate(mutated.flights)]
    hidden = {use.name: dict(use.parameters) for use in uses}
    true = {*mutated.true, *hidden}
    also = sorted(true.union(*(group for group in ALIKE if group & true)))
    truth = Expected(hidden, tuple(hidden), (*case.entry.also, *also), ("refused", "unknown"), bool(mutated.true))
    conditions = {"mutation": mutated.what, "rotors": "commands" if commands else "speeds"}
    return Posed(logs, mutated.vehicle, truth, conditions=conditions)


def _sized(case: Case) -> dict[str, dict[str, float]]:
    """The hidden effects of an entry, each somewhat larger or smaller, on a rotor that the seed draws."""
    random = np.random.default_rng([*case.key.encode()])
    made: dict[str, dict[str, float]] = {}
    for name, values in case.entry.hidden.items():
        size = float(np.exp(random.uniform(-np.log(SPREAD), np.log(SPREAD))))
        effect = CATALOGUE.get(name)
        neutral = {} if effect is None else {p.name: p.neutral for p in effect.parameters}
        made[name] = {k: neutral.get(k, 0.0) + size * (value - neutral.get(k, 0.0)) for k, value in values.items()}
        if effect is not None and effect.per_rotor:
            made[name]["rotor"] = float(random.integers(4))
    return made


def _use(name: str, values: Mapping[str, float]) -> EffectUse:
    rotor = int(values["rotor"]) if "rotor" in values else None
    return EffectUse(name, {key: value for key, value in values.items() if key != "rotor"}, rotor)


SOURCES: Mapping[str, Callable[[Case, Path], Posed]] = {
    "own": _own, "mock": _mock, "short": _short, "campaign": _campaign, "outside": _outside, "px4_like": _px4_like,
    "recorded": _recorded, "bundled": _bundled, "mutated": _mutated,
}  # fmt: skip
TOGETHER: Mapping[str, Callable[[Sequence[Case]], object]] = {  # simulators that fly many at the cost of a few
    "outside": lambda cases: drawn([_draw(case) for case in cases]),
    "px4_like": _sih_logs,
}
