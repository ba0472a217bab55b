"""Someone hides an effect in simulated flights; the command line alone must find it. What it then said and did."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from alula import cli
from diagnosis.dataset import make_dataset
from dynamics import quaternion
from dynamics.effects import CATALOGUE
from dynamics.errors import AlulaError
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle, write_vehicle
from flights import Flight
from sitl_mock.battery import usual_battery
from tests.support.planted import HELD_OUT, MANOEUVRES, noisy, planted_flights
from tests.support.planted_sizes import Yardstick
from vehicles import FOLDER

STRENGTHS, NOISES = (1.5, 5.0), (1.0, 3.0)  # times the noise floor; times the usual noise
LAGS = {1.5: 0.03, 5.0: 0.045}  # s; the mock's motors always lag, so that there is no flight without to measure it by
GUST_TIME = 1.0  # s
EMPTY = 0.25  # charge of the battery on the last flight, whose voltage must vary for sag to show
SHORTEST = 6.0  # s of a flight, else the hidden effect was more than the vehicle could bear
WEAKER = (1.0, 0.7, 0.5, 0.3)  # of the strength, tried in turn until the vehicle bears it
AT_FLOOR = 1.3  # times its floor a channel may have after adding, the goal for the worst effect
REFUSED = (3,)  # exit code of what says honestly that it cannot; no error, but nothing is added either
UNIFORM = ("imu_bias", "gyro_bias")  # the same everywhere, so that nowhere is worse than elsewhere


@dataclass(frozen=True)
class Draw:
    """What is hidden, if there is an effect: strength over the noise floor, factor on the noise, seed."""

    effect: str
    strength: float
    noise: float
    seed: int

    @classmethod
    def random(cls, seed: int, number: int) -> Draw:
        """The draw of a number by a seed: an effect of the whole catalogue, strong or very strong."""
        random = np.random.default_rng([seed, number])
        name = str(random.choice(list(CATALOGUE)))
        return cls(name, float(random.choice(STRENGTHS)), float(random.choice(NOISES)), seed * 10 + number)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the command line made of a draw. faults: what must never be; misses: what was wanted besides."""

    draw: Draw
    hidden: tuple[EffectUse, ...]
    compared: dict[str, Any]
    verdict: dict[str, Any]
    added: dict[str, Any] | None
    faults: tuple[str, ...]
    misses: tuple[str, ...]
    took: float

    def __str__(self) -> str:
        d, first = self.draw, [e["name"] for e in self.verdict.get("effects", [])]
        rivals = [e["ambiguous_with"] for e in self.verdict.get("effects", [])]
        hidden = "; ".join(f"{u.name}{'' if u.rotor is None else u.rotor} {_short(u.parameters)}" for u in self.hidden)
        after = {} if self.added is None else {k: _over(c) for k, c in self.added["channels"].items()}
        return (
            f"{d.effect or 'nothing'} x{d.strength:g} noise x{d.noise:g} (seed {d.seed}): {hidden} -> "
            f"{self.verdict.get('verdict')} {first} {rivals}, before and after over floor {after}; "
            f"{'HOLDS' if not (self.faults or self.misses) else f'faults {self.faults} misses {self.misses}'}; "
            f"{self.took:.0f} s"
        )


def vehicle() -> Vehicle:
    """The vehicle that is flown."""
    return read_vehicle(FOLDER / "arpl_250g.toml")


@cache
def nothing_hidden(seed: int) -> list[Flight]:
    """Flights that hide nothing, at the usual noise."""
    return fly((), noise=1.0, seed=seed)


def yardstick(seed: int) -> Yardstick:
    """How effects of a size show in flights that hide nothing."""
    return Yardstick.of(make_dataset(nothing_hidden(seed), vehicle()), vehicle())


def fly(uses: Sequence[EffectUse], *, noise: float, seed: int) -> list[Flight]:
    """Nine flights on the mock's vehicle, each on a battery with less charge, as a log that can show the effects."""
    flights, made = [], [use for use in uses if use.name != "time_delay"]
    for i, manoeuvre in enumerate(MANOEUVRES):
        charge = 1 - (1 - EMPTY) * ((5 * i) % len(MANOEUVRES)) / (len(MANOEUVRES) - 1)  # no order, no trend
        options = dataclasses.replace(noisy(noise), battery=usual_battery(vehicle(), charge=charge))
        flights += planted_flights(vehicle(), made, seed=1000 * seed + i, options=options, manoeuvres=[manoeuvre])
    names = {use.name for use in uses}
    if "motor_lag" in names:
        flights = [_with(f, dict.fromkeys(n for n in f.columns if n.startswith("rotor_speed"))) for f in flights]
    delay = sum(use.parameters["delay"] for use in uses if use.name == "time_delay")
    return [_late(f, delay) for f in flights] if delay else flights


def try_command_line(draw: Draw, measure: Yardstick, folder: Path) -> Outcome:
    """Hide what was drawn in flights, then compare, diagnose and add by the command line in a folder of its own."""
    began = time.perf_counter()
    hidden, flights = _hidden(draw, measure)
    logs = _written(flights, folder)
    file = str(folder / "vehicle.toml")
    write_vehicle(vehicle(), Path(file))
    faults: list[str] = []
    compared = _asked("compare", [*logs, "--vehicle", file], folder, faults)
    held = ["--vehicle", file, "--hold-out", "holdout_*"]
    verdict = _asked("diagnose", [*logs, *held], folder, faults)
    added = None
    if verdict.get("effects"):
        added = _added(verdict["effects"], logs, held, folder, faults)
    misses = _misses(draw, verdict, compared, added) if not faults else []
    took = time.perf_counter() - began
    return Outcome(draw, tuple(hidden), compared, verdict, added, tuple(faults), tuple(misses), took)


def _hidden(draw: Draw, measure: Yardstick) -> tuple[list[EffectUse], list[Flight]]:
    """The effect at the drawn strength, or as much of it as the vehicle bears, and its flights."""
    if not draw.effect:
        return [], nothing_hidden(draw.seed)
    for share in WEAKER:
        random = np.random.default_rng(draw.seed)
        use = _sized(draw, share * draw.strength * draw.noise, measure, random)
        try:
            flights = fly((use,), noise=draw.noise, seed=draw.seed)
        except AlulaError:  # it did not even reach the beginning
            continue
        if min(f.duration for f in flights) > SHORTEST:
            return [use], flights
    raise RuntimeError(f"{draw}: the vehicle bears it at no strength; make the draw itself gentler")


def _sized(draw: Draw, strength: float, measure: Yardstick, random: np.random.Generator) -> EffectUse:
    if draw.effect == "motor_lag":
        return EffectUse("motor_lag", {"time_constant": LAGS[draw.strength]})
    if draw.effect == "gust":
        wind = measure.sized("wind", strength, random).parameters
        return EffectUse("gust", {"intensity": float(np.hypot(wind["x"], wind["y"])), "correlation_time": GUST_TIME})
    return measure.sized(draw.effect, strength, random)


def _written(flights: Sequence[Flight], folder: Path) -> list[str]:
    count = len(flights)
    names = [f"flight_{i}.csv" if i < count - HELD_OUT else f"holdout_{i}.csv" for i in range(count)]
    return [str(flight.to_csv(folder / name)) for flight, name in zip(flights, names, strict=True)]


def _asked(command: str, arguments: Sequence[str], folder: Path, faults: list[str], *, may: Sequence[int] = ()) -> Any:
    """The JSON that a command wrote, empty where it wrote none; an exit code but 0 and those it may have is a fault."""
    answer = folder / f"{command}.json"
    code, shown = _alula(command, *arguments, "--json", str(answer))
    if code != 0 and code not in may:
        faults.append(f"alula {command} ended with {code}: {shown[-300:]}")
    return json.loads(answer.read_text()) if answer.exists() else {}


def _added(
    effects: Sequence[dict[str, Any]], logs: Sequence[str], held: Sequence[str], folder: Path, faults: list[str]
) -> dict[str, Any] | None:
    first = effects[0]
    rotor = [] if first["rotor"] is None else ["--rotor", str(first["rotor"])]
    added = _asked("add", [first["name"], *logs, *held, *rotor], folder, faults, may=REFUSED)
    written = folder / "vehicle.v2.toml"
    if bool(added) != written.exists():
        faults.append(f"alula add answered {'with' if added else 'without'} a result, but the file says otherwise")
    if added and added["misfit"]["after"] >= added["misfit"]["before"]:
        faults.append("the model became worse")
    return added or None


def _misses(draw: Draw, verdict: dict[str, Any], compared: dict[str, Any], added: dict[str, Any] | None) -> list[str]:
    if not draw.effect:
        return [] if verdict["verdict"] == "explained" else [f"nothing was hidden, but: {verdict['verdict']}"]
    misses = []
    first = verdict["effects"][0] if verdict["effects"] else {"name": "nothing", "ambiguous_with": []}
    pair = [first["name"], *first["ambiguous_with"]]
    if not (first["name"] == draw.effect or (draw.effect in pair and len(pair) == 2)):
        misses.append(f"named {' or '.join(pair)}")
    if draw.effect == "gust":
        return misses
    if not any(axis["rms"] > 1.1 * axis["floor"] for axis in compared["axes"]):
        misses.append("compare sees no error")
    if draw.effect not in UNIFORM and not verdict["fails_where"]:
        misses.append("not located")
    if added is None:
        return [*misses, "not added"]
    high = {kind: round(c["after"] / c["floor"], 2) for kind, c in added["channels"].items()}
    if max(high.values()) > AT_FLOOR:
        misses.append(f"after adding over floor: {high}")
    return misses


def _alula(*arguments: str) -> tuple[int, str]:
    """Exit code and all that was printed, of the command as a user types it."""
    told, before = io.StringIO(), sys.argv
    sys.argv = ["alula", *arguments]
    try:
        with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
            cli.main()
        code = 0
    except SystemExit as ended:
        code = int(ended.code or 0)
    finally:
        sys.argv = before
    return code, told.getvalue()


def _late(flight: Flight, delay: float) -> Flight:
    """The flight with its pose older than its stamps by delay, s."""
    names = [
        n for n in flight.columns if n.partition("_")[0] in ("position", "velocity", "attitude") and "set" not in n
    ]
    moved = {n: np.interp(flight.time - delay, flight.time, flight[n]) for n in names}
    turned = quaternion.normalise(np.column_stack([moved[f"attitude_{axis}"] for axis in "wxyz"]))
    return _with(flight, moved | {f"attitude_{axis}": np.asarray(turned)[:, i] for i, axis in enumerate("wxyz")})


def _with(flight: Flight, columns: dict[str, Any]) -> Flight:
    present = {name: values for name, values in {**flight.columns, **columns}.items() if values is not None}
    return Flight(flight.time, present, flight.provenance, flight.origins, flight.parameters, flight.metadata)


def _short(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items())


def _over(channel: dict[str, float]) -> tuple[float, float]:
    return round(channel["before"] / channel["floor"], 2), round(channel["after"] / channel["floor"], 2)
