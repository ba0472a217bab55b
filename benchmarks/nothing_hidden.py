"""Flights with nothing hidden: what following costs. Writes results/nothing_hidden.md.

Eight manoeuvres in turn, a new seed each, flown in lockstep by the vehicle file's model and by one that follows the
disturbance, wind and drags. Finished flights are kept, so that a run that was stopped resumes.

    python -m benchmarks.nothing_hidden --flights 500 --jobs 1 --table
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.adaptation import MANOEUVRES, SECONDS, VEHICLE
from benchmarks.provenance import write_result
from dynamics.references import named_reference
from dynamics.vehicle_file import read_vehicle
from flights.parallel import parallel_map
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight_setup import FOLLOWED
from simulation.lockstep import fly_reference
from vehicles import FOLDER

MODES = {"off": (), "on": FOLLOWED}
FIRST_SEED = 200_000  # settings were chosen on others
GOAL_MEDIAN, GOAL_WORST = 1.03, 1.10


def flown(case: tuple[int, str]) -> dict[str, Any]:
    """Error of a flight by its number and mode, m."""
    number, mode = case
    vehicle = read_vehicle(FOLDER / f"{VEHICLE}.toml")
    settings = AdaptationSettings(mode=mode, follow=MODES[mode])  # type: ignore[arg-type]
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=settings))
    name = MANOEUVRES[number % len(MANOEUVRES)]
    reference = named_reference(name, vehicle, duration=SECONDS)
    flight = fly_reference(vehicle, reference, seed=FIRST_SEED + number, controller=controller)
    return {
        "number": number,
        "mode": mode,
        "reference": name,
        "rmse": flight.position_rmse,
        "aborted": flight.aborted,
        "events": dict(flight.events),
    }


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Ratios of errors by manoeuvre."""
    errors = {(r["number"], r["mode"]): r["rmse"] for r in results}
    pairs = [r for r in results if r["mode"] == "on" and (r["number"], "off") in errors]
    body = [
        f"{len(pairs)} pairs of flights of {SECONDS:g} s with nothing hidden on {VEHICLE}, seeds from {FIRST_SEED} on: "
        "error of the model that follows over that of the vehicle file's, the same seed and manoeuvre. Goal: "
        f"{GOAL_MEDIAN:.2f} in the median, {GOAL_WORST:.2f} in the worst.",
        "",
        "| reference | pairs | file's model, cm | median | 95 % below | worst | refused | changes named |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name in (*MANOEUVRES, "all"):
        some = [r for r in pairs if name in (r["reference"], "all")]
        if not some:
            continue
        ratios = np.array([r["rmse"] / errors[r["number"], "off"] for r in some])
        usual = 100 * float(np.median([errors[r["number"], "off"] for r in some]))
        counts = [sum(event in r["events"] for r in some) for event in ("adaptation_refused", "model_changed")]
        body.append(
            f"| {name} | {len(some)} | {usual:.2f} | {np.median(ratios):.3f} | {np.quantile(ratios, 0.95):.3f} | "
            f"{ratios.max():.3f} | {counts[0]} | {counts[1]} |"
        )
    ended = sum(bool(r["aborted"]) for r in results)
    return "\n".join([*body, "", f"Flights that ended early: {ended}."])


def main() -> None:
    """Fly what has not been flown, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=500)
    parser.add_argument("--modes", nargs="+", choices=MODES, default=list(MODES))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--kept", type=Path, default=Path("build/nothing_hidden.jsonl"))
    parser.add_argument("--table", action="store_true", help="write benchmarks/results/nothing_hidden.md")
    options = parser.parse_args()
    options.kept.parent.mkdir(parents=True, exist_ok=True)
    lines = options.kept.read_text().splitlines() if options.kept.exists() else []
    done = {(r["number"], r["mode"]): r for r in map(json.loads, lines)}
    cases = [(number, mode) for number in range(options.flights) for mode in options.modes]
    for _, result in parallel_map(flown, [case for case in cases if case not in done], jobs=options.jobs):
        done[result["number"], result["mode"]] = result
        with options.kept.open("a") as file:
            print(json.dumps(result), file=file)
    if options.table:
        write_result("nothing_hidden", "What following costs where nothing is hidden", table(list(done.values())))
    else:
        print(table(list(done.values())))


if __name__ == "__main__":
    main()
