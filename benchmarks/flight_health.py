"""Health of flights at default logging rates: causes named, and statements about flights in which nothing is wrong."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.measurement import ROOT, Page, keep, kept_results, options_of, paragraph_of
from fixtures.default_rate_flight import record
from fixtures.health_cases import KINDS, health_case, is_right
from flights.health import read_health
from flights.parallel import parallel_map
from flights.reading import read_log

FIRST_SEED = 9000  # all seeds below were looked at while limits were chosen or changed, and thrown away
REAL = (  # logs of real vehicles and of real PX4 in its own simulation, and what comes first in them
    ("tests/data/default_rate_logs/disconnected_battery.ulg.gz", ("vibration", "battery_not_measured")),
    ("tests/data/default_rate_logs/no_satellites.ulg.gz", ("",)),
    ("tests/data/default_rate_logs/uavcan.ulg.gz", ("vibration",)),
    ("tests/data/pyulog_samples/sample_px4_events.ulg.gz", ("",)),
    ("tests/data/px4_sih_flights/nothing_1_circle.ulg.gz", ("",)),
    ("tests/data/px4_sih_flights/nothing_2_line.ulg.gz", ("",)),
    ("tests/data/px4_sih_flights/nothing_3_warped_ellipse_2.ulg.gz", ("tipped_over",)),  # by 43 degrees, its SOURCE
)


def flight_health(words: Sequence[str]) -> Page:
    """The first failure of flights, by logs at PX4's default rates.

    Mock flights with one failure each, recorded at PX4's default rates: a cause is right where the statement that comes
    first has its name and, where one is meant, its rotor. Healthy flights (light wind, rotors up to 5 % apart, mass up
    to 10 % off) count every fault or warning as a false statement. No flight was looked at before the limits stood.

        python -m benchmarks readers health [--seeds N] [--healthy N] [--jobs J]
    """
    parser = options_of(flight_health.__doc__, jobs=1, resumes="flight_health", seeds=2, healthy=30)
    options = parser.parse_args(words)
    planned_flights = _planned(options)
    done = {(result["kind"], result["seed"]) for result in kept_results(options.kept)}
    missing = [case for case in planned_flights if case not in done]
    for _, result in parallel_map(_judged, missing, jobs=options.jobs):
        keep(options.kept, result, line=f"{result['kind']} {result['seed']}: {result['first'] or 'nothing'}")
    results = [r for r in kept_results(options.kept) if (r["kind"], r["seed"]) in set(planned_flights)]
    return Page("flight_health", "Health of flights at default logging rates", _body(results), trial=options.quick)


def _planned(options: argparse.Namespace) -> list[tuple[str, int]]:
    counts = {kind: options.healthy if kind == "healthy" else options.seeds for kind in KINDS}
    rounds = range(max(counts.values()))
    cases = [(kind, FIRST_SEED + place) for place in rounds for kind, count in counts.items() if place < count]
    return cases[: options.cases] if options.cases else cases


def _judged(case: tuple[str, int]) -> dict[str, Any]:
    """The verdict on one flight, as plain data."""
    kind, seed = case
    planted = health_case(kind, seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.ulg"
        path.write_bytes(record(planted.flight))
        health = read_health(read_log(path))
    return {
        "kind": kind, "seed": seed, "name": planted.kind, "vehicle": planted.flight.vehicle, "first": health.first,
        "right": is_right(planted, health), "defects": [s.name for s in health.defects],
    }  # fmt: skip


def _body(results: Sequence[dict[str, Any]]) -> str:
    lines = [paragraph_of(flight_health.__doc__), ""]
    lines += ["| failure | flights | right first | other answers |", "| --- | --- | --- | --- |"]
    failures = [r for r in results if r["kind"] != "healthy"]
    for kind in KINDS:
        own = [r for r in results if r["kind"] == kind]
        if own:
            others = ", ".join(sorted({r["first"] or "nothing" for r in own if not r["right"]}))
            lines.append(f"| {own[0]['name']} | {len(own)} | {sum(r['right'] for r in own)} | {others} |")
    healthy = [r for r in results if r["kind"] == "healthy"]
    lines += ["", f"Causes right: {sum(r['right'] for r in failures)} of {len(failures)} failures."]
    lines += [f"False statements: on {sum(not r['right'] for r in healthy)} of {len(healthy)} healthy flights.", ""]
    lines += ["| real log | first | right |", "| --- | --- | --- |"]
    for name, accepted in REAL:
        if (path := ROOT / name).exists():
            health = read_health(read_log(path))
            answer = "yes" if health.first in accepted else "no"
            lines.append(f"| {Path(name).name} | {health.first or 'nothing'} | {answer} |")
    return "\n".join(lines)
