"""Thresholds halved and doubled: verdicts."""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from rich.progress import track

from benchmarks.measurement import ROOT, Page, keep, kept_results, options_of, paragraph_of
from diagnosis.addition import add_effect
from diagnosis.completion import complete
from diagnosis.data.dataset import read_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.hover_trim import read_trim
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.effects import CATALOGUE
from dynamics.errors import AlulaError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.compiled_flights import compiled_flights
from fixtures.mutated_flights import FLOWN, USUAL, with_columns
from fixtures.outside_draws import Draw, written
from flights import Flight
from vehicles import FOLDER

DATA = ROOT / "tests" / "data"
PX4, TRIM = DATA / "px4_sih_flights", DATA / "crazypad_trim"
CRAZYFLIE = FOLDER / "crazyflie.toml"
OUTSIDE = ROOT / "build" / "threshold_margins"  # of the logs of the outside simulator
DATE = "2026-01-01"
FACTORS = (0.5, 2.0)
SEED, FLIGHTS = 41, 5  # of the outside simulator: for calibration; of each case, to be quick


@dataclass(frozen=True)
class Case:
    """Logs, a vehicle file, and what is done with them.

    rotors: order in which the vehicle file's are taken. changed: a change of `LOG_CHANGES`, of our simulator's flights.
    normal: flights with whose hover trim the logs are compared. adds: whether effects are added, once or until none is
    missing. further: whether only thresholds are varied that no case before reads.
    """

    name: str
    logs: tuple[str, ...] = ()
    vehicle: Path = FOLDER / "arpl_250g.toml"
    rotors: tuple[int, ...] = ()
    changed: str = ""
    normal: tuple[str, ...] = ()
    adds: Literal["", "once", "all"] = ""
    further: bool = False

    def answer(self, thresholds: Thresholds) -> str:
        """Verdict and names, or that it is refused."""
        try:
            if self.changed:
                return self._of_changed(thresholds)
            return self._of_logs(self.logs, read_vehicle(self.vehicle), thresholds)
        except AlulaError as error:
            advice = re.split(r"\. (?=[A-Z])", str(error))[-1].rstrip(".")
            return f"refused: {re.sub(r'-?[0-9][0-9.e+-]*', 'N', advice)}"
        except Exception as error:
            return f"traceback {type(error).__name__}"

    def _of_logs(self, logs: Sequence[str], vehicle: Vehicle, thresholds: Thresholds) -> str:
        if self.rotors:
            exchanged = tuple(vehicle.rotors.position[i] for i in self.rotors)
            vehicle = msgspec.structs.replace(
                vehicle, rotors=msgspec.structs.replace(vehicle.rotors, position=exchanged)
            )
        if self.normal:
            normal = [Path(log) for log in self.normal]
            trim = read_trim([Path(log) for log in logs], normal, vehicle, None, thresholds.hover_trim)
            return _answer(trim.verdict, [f"{effect.name} of rotor {effect.rotor}" for effect in trim.effects])
        data = read_dataset(list(logs), vehicle, thresholds=thresholds)
        if self.adds == "all":
            completed = complete(data, vehicle, CATALOGUE, date=DATE, thresholds=thresholds)
            return _answer("completed", [effect.name for effect in completed.added])
        if self.adds:
            added = add_effect(None, data, vehicle, CATALOGUE, date=DATE, thresholds=thresholds)
            return _answer("added", added.keys)
        report = diagnose_dataset(data, vehicle, CATALOGUE, thresholds).diagnosis
        return _answer(report.verdict, [effect.name for effect in report.effects])

    def _of_changed(self, thresholds: Thresholds) -> str:
        vehicle = read_vehicle(self.vehicle)
        manoeuvres = FLOWN.get(self.changed, USUAL)
        flown = compiled_flights(vehicle, [], catalogue=CATALOGUE, seed=SEED, manoeuvres=tuple(manoeuvres))
        with tempfile.TemporaryDirectory() as folder:
            change = LOG_CHANGES[self.changed]
            logs = [str(change(f).to_csv(Path(folder) / f"flight_{i}.csv")) for i, f in enumerate(flown)]
            return self._of_logs(logs, vehicle, thresholds)


def _times(flight: Flight, factor: float, *quantities: str) -> Flight:
    names = [n for n in flight.columns if n.rpartition("_")[0] in quantities]
    return with_columns(flight, {n: factor * flight[n] for n in names})


def _at(flight: Flight, rate: float) -> Flight:
    time = np.arange(flight.time[0], flight.time[-1], 1 / rate)
    columns = {n: np.interp(time, flight.time, values) for n, values in flight.columns.items()}
    return Flight(time, columns, flight.provenance)


def _without(flight: Flight, *quantities: str) -> Flight:
    return with_columns(flight, {n: None for n in flight.columns if n.rpartition("_")[0] in quantities})


LOG_CHANGES: Mapping[str, Callable[[Flight], Flight]] = {
    "all hover": lambda f: f,
    "position in mm": lambda f: _times(f, 1e3, "position", "velocity"),
    "rates in degrees": lambda f: _times(f, 180 / np.pi, "rate"),
    "rates in degrees, no pose": lambda f: _without(_times(f, 180 / np.pi, "rate"), "position", "velocity", "attitude"),
    "1,000 Hz": lambda f: _at(f, 1000.0),
    "no pose": lambda f: _without(f, "position", "velocity", "attitude"),
}


def _answer(verdict: str, names: Sequence[str]) -> str:
    return f"{verdict}: {', '.join(names)}".rstrip(": ")


@cache
def cases() -> list[Case]:
    """All cases; outside flights are flown first."""
    kinds = (
        ("nothing", "speeds"), ("single", "inertia"), ("single", "gust"), ("nothing", "commands"),
        ("single", "motor_lag"), ("single", "slung_load"),
    )  # fmt: skip
    nothing, inertia, gust, commands, lag, slung = [_outside(Draw(kind, name, SEED)) for kind, name in kinds]
    real = {name: tuple(map(str, sorted(PX4.glob(f"{name}_*.ulg.gz")))) for name in ("drag2", "nothing")}
    px4 = FOLDER / "px4_sih.toml"
    made = [
        nothing,
        inertia,
        Case("motors exchanged", nothing.logs, nothing.vehicle, _exchanged(nothing)),
        Case("px4 drag2", real["drag2"], px4),
    ]
    normal = tuple(map(str, sorted(TRIM.glob("normal_flight_E8_*"))))
    further = [
        gust,
        commands,
        Case("px4, one flight", real["nothing"][:1], px4),
        Case("Crazyflie, hover trim", (str(next(TRIM.glob("cut_propeller_M3_3mm_E8_*"))),), CRAZYFLIE, normal=normal),
        Case("completed", lag.logs, lag.vehicle, adds="all"),
        Case("added", inertia.logs, inertia.vehicle, adds="once"),
        Case("a lag added", lag.logs, lag.vehicle, adds="once"),
        *(Case(name, changed=name) for name in LOG_CHANGES),
        slung,
    ]
    return [*made, *(replace(case, further=True) for case in further)]


def _outside(draw: Draw) -> Case:
    folder = OUTSIDE / draw.key
    return Case(draw.key, tuple(map(str, written(draw, folder)[:FLIGHTS])), folder / "vehicle.toml")


def _exchanged(case: Case) -> tuple[int, ...]:
    count = read_vehicle(case.vehicle).rotors.count
    return tuple((i + count // 2) % count for i in range(count))  # each for the one across


def underived() -> list[str]:
    """Thresholds whose line names no other origin."""
    names = []
    for group in msgspec.structs.fields(Thresholds):
        of_group = getattr(DEFAULT, group.name)
        text = re.sub(r"\s+", " ", type(of_group).__doc__ or "")
        for field in msgspec.structs.fields(of_group):
            line = re.search(rf" {field.name}: [^\[]*\[([^\]]*)\]", text)
            if line and (line[1].startswith("margins")):
                names.append(f"{group.name}.{field.name}")
    return names


def changed(name: str, factor: float) -> Thresholds:
    """The thresholds with one of them times a factor. Raises msgspec.ValidationError where it is out of its range."""
    group, field = name.split(".")
    of_group = getattr(DEFAULT, group)
    value = _scaled(getattr(of_group, field), factor, name)
    built = {**msgspec.to_builtins(of_group), field: value}
    return msgspec.structs.replace(DEFAULT, **{group: msgspec.convert(built, type(of_group))})


def _scaled(value: Any, factor: float, name: str) -> Any:
    if isinstance(value, tuple):
        return [_scaled(one, factor, name) for one in value]
    if isinstance(value, int):
        return max(1, round(factor * value))
    group, field = name.split(".")
    bounds = next(f.type for f in msgspec.structs.fields(type(getattr(DEFAULT, group))) if f.name == field)
    if "ge=1" in str(bounds) and value > 1:
        return 1 + factor * (value - 1)
    if "le=1" in str(bounds) and value > 0.5:
        return 1 - (1 - value) / factor
    return factor * value


def read_in(case: Case) -> set[str]:
    """The thresholds that a case reads."""
    reads: set[str] = set()
    groups = {}
    for group in msgspec.structs.fields(Thresholds):
        of_group = getattr(DEFAULT, group.name)
        groups[group.name] = _watched(type(of_group), group.name, reads)(**msgspec.structs.asdict(of_group))
    watched = Thresholds(**groups)
    reads.clear()  # of what was read to check the values
    case.answer(watched)
    return reads


def _watched(kind: type, group: str, reads: set[str]) -> type:
    names = {field.name for field in msgspec.structs.fields(kind)}

    class Watched(kind, frozen=True):  # type: ignore[misc, valid-type]
        def __getattribute__(self, name: str) -> Any:
            if name in names:
                reads.add(f"{group}.{name}")
            return super().__getattribute__(name)

    return Watched


def runs(selected: Sequence[Case], done: set[str]) -> Iterator[dict[str, Any]]:
    """Each answer that is not there yet."""
    for case in selected:
        if f"default {case.name}" not in done:
            reads = sorted(read_in(case))
            yield {"key": f"default {case.name}", "case": case.name, "answer": case.answer(DEFAULT), "reads": reads}


def varied(selected: Sequence[Case], results: Sequence[Mapping[str, Any]]) -> list[tuple[str, float, Case]]:
    """Runs: each threshold, by how much, and the cases that read it."""
    reads = {r["case"]: set(r["reads"]) for r in results if r["key"].startswith("default ")}
    chosen, before = [], set[str]()
    for case in selected:
        names = reads[case.name] - before if case.further else reads[case.name]
        chosen += [(name, factor, case) for name in underived() if name in names for factor in FACTORS]
        before |= reads[case.name]
    return chosen


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """A line for each threshold."""
    usual = {r["case"]: r["answer"] for r in results if r["key"].startswith("default ")}
    reads = {name for r in results for name in r.get("reads", ())}
    lines = ["| case | answer |", "| --- | --- |", *(f"| {case} | {answer} |" for case, answer in usual.items()), ""]
    lines += ["| threshold | value | cases | halved | doubled |", "| --- | --- | --- | --- | --- |"]
    for name in underived():
        group, field = name.split(".")
        some = [r for r in results if r.get("name") == name]
        value = msgspec.to_builtins(getattr(getattr(DEFAULT, group), field))
        shown = ", ".join(f"{one:g}" for one in value) if isinstance(value, (list, tuple)) else f"{value:g}"
        cells = [
            _changed_answers([r for r in some if r["factor"] == factor], usual, is_read=name in reads)
            for factor in FACTORS
        ]
        lines.append(f"| {name} | {shown} | {len({r['case'] for r in some})} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _changed_answers(some: Sequence[Mapping[str, Any]], usual: Mapping[str, str], *, is_read: bool) -> str:
    if not some:
        return "not run" if is_read else "not read"
    if some[0]["answer"] == "out of range":
        return "out of range"
    other = [f"{r['case']}: {r['answer']}" for r in some if r["answer"] != usual[r["case"]]]
    return "; ".join(other) or "the same"


def margins(words: Sequence[str]) -> Page:
    """Margins of thresholds: verdicts with half and double of each. Writes results/threshold_margins.md.

    Every threshold whose line names no other origin ("margins") is halved and doubled, one at a time (a factor's or a
    share's distance from 1, where it has one), on flights of the outside simulator, of real PX4 and of a real Crazyflie
    with a known answer, and on logs that must be refused. The cases after PX4's vary only what no case before them
    reads. A threshold that no case reads is listed as such: its case is missing here. Finished runs are kept, so that a
    run that was stopped resumes.

        python -m benchmarks thresholds margins
    """
    parser = options_of(margins.__doc__, resumes="threshold_margins")
    parser.add_argument("--budget", type=float, default=float("inf"), help="s after which nothing is begun")
    options = parser.parse_args(words)
    selected, results = cases()[: options.cases], kept_results(options.kept)
    for result in runs(selected, {r["key"] for r in results}):
        results.append(result)
        keep(options.kept, result)
    done = {r["key"] for r in results}
    todo = [(n, f, c) for n, f, c in varied(selected, results) if f"{n} {f:g} {c.name}" not in done]
    began = time.monotonic()
    for name, factor, case in track(todo, description="thresholds"):
        if time.monotonic() - began > options.budget:
            break
        try:
            answer = case.answer(changed(name, factor))
        except (msgspec.ValidationError, ValueError):
            answer = "out of range"
        key = f"{name} {factor:g} {case.name}"
        results.append({"key": key, "name": name, "factor": factor, "case": case.name, "answer": answer})
        keep(options.kept, results[-1])
    body = f"{paragraph_of(margins.__doc__)}\n\n{table(results)}"
    return Page("threshold_margins", "What a threshold's half and its double do to verdicts", body)
