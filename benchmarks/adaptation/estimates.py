"""Parameters followed in flight against the truth, the diagnosis of the flight, and the next vehicle file.

Random drags and winds that no vehicle file has, in lockstep on the mock's vehicle: the wind as it is named, how many
of the intervals hold, whether `alula diagnose` on the recording agrees, and the prediction error on another flight with
what `alula add --from-flight` writes. Finished flights are kept, so that a run that was stopped resumes.

    python -m benchmarks adaptation estimates --seeds 60
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import alula
from benchmarks.adaptation import VEHICLE
from benchmarks.measurement import Page, measured, options_of
from diagnosis.in_flight import is_shown
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from fixtures.followed_flight import fly_following
from flights.followed import require_followed
from vehicles import FOLDER

MANOEUVRES = ("Lemniscate", "Ellipse_1", "circle", "WarpedEllipse_1", "ExtendedLemniscate", "line")
SECONDS = 24.0
FIRST_SEED = 40_000
NINETY = 1.645  # standard deviations of a 90 % interval
NEAR, NEAR_SHARE = 0.3, 0.1  # m/s, and of the wind's speed


def case_of(seed: int) -> tuple[str, list[EffectUse]]:
    """Manoeuvre and hidden effects of a seed: drag always, wind in three of four."""
    random = np.random.default_rng(seed)
    uses = [EffectUse("rotor_drag", {"coefficient": 2.2e-5 * random.uniform(0.5, 1.8)})]
    if random.random() < 0.3:
        uses.append(EffectUse("parasitic_drag", {"coefficient": random.uniform(0.004, 0.015)}))
    if random.random() < 0.75:
        speed, heading = random.uniform(1.0, 8.0), random.uniform(0, 2 * np.pi)
        x, y = float(speed * np.cos(heading)), float(speed * np.sin(heading))
        uses.append(EffectUse("wind", {"x": x, "y": y, "z": 0.0}))
    return MANOEUVRES[seed % len(MANOEUVRES)], uses


def flown(seed: int) -> dict[str, Any]:
    """A flight: truth, what was followed, agreement with the diagnosis, errors with the next vehicle file."""
    vehicle = read_vehicle(FOLDER / f"{VEHICLE}.toml")
    reference, uses = case_of(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        try:
            flight = fly_following(vehicle, path, hidden=uses, reference=reference, duration=SECONDS, seed=seed)
        except alula.VehicleError as error:
            return {"seed": seed, "reference": reference, "never_flown": str(error)}
        result: dict[str, Any] = {
            "seed": seed,
            "reference": reference,
            "aborted": flight.aborted,
            "events": dict(flight.events),
            "true": {f"{use.name}.{key}": value for use in uses for key, value in use.parameters.items()},
            "followed": {
                name: [value.value, value.std, is_shown(value)] for name, value in require_followed(path).values.items()
            },
        }
        try:
            effects = alula.diagnose(path, vehicle).report.in_flight
        except alula.DataError as error:
            return {**result, "outcomes": {}, "added": [], "refused": str(error)}
        result["outcomes"] = {one.name: [one.outcome, one.named, one.reason] for one in effects}
        return result | _next_file(path, Path(folder), seed)


def _next_file(path: Path, folder: Path, seed: int) -> dict[str, Any]:
    """Next file by --from-flight, and the errors of file and next file on another flight with the same effects."""
    vehicle = read_vehicle(FOLDER / f"{VEHICLE}.toml")
    try:
        added = alula.add_from_flight(path, vehicle)
    except alula.DataError as error:
        return {"added": [], "refused": str(error)}
    other = folder / "other.mcap"
    _, uses = case_of(seed)
    calm = [use for use in uses if use.name != "wind"]
    fly_following(vehicle, other, hidden=calm, reference="Lemniscate", duration=SECONDS, seed=seed + 1, mode="shadow")
    proof = alula.prove(other, added.vehicle, vehicle).report
    errors = {kind: [error.before, error.after, error.floor] for kind, error in proof.channels.items()}
    return {"added": list(added.report.effects), "errors": errors}


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Wind and drags against the truth, agreement, errors on another flight."""
    results = [result for result in results if "never_flown" not in result]
    first, last = results[0]["seed"], results[-1]["seed"]
    lines = [f"{len(results)} flights of {SECONDS:g} s, every one with other effects, seeds {first} to {last}.", ""]
    lines += [*_wind(results), "", *_intervals(results), "", *_agreement(results), "", *_next_files(results)]
    return "\n".join(lines)


def _wind(results: Sequence[Mapping[str, Any]]) -> list[str]:
    errors, speeds = [], []
    for result in results:
        axes = [result["followed"][f"wind.{axis}"] for axis in "xy"]
        true = np.array([result["true"].get(f"wind.{axis}", 0.0) for axis in "xy"])
        if all(shown for _, _, shown in axes) and np.any(true):
            speeds.append(float(np.linalg.norm(true)))
            errors.append(float(np.linalg.norm([v for v, _, _ in axes]) - speeds[-1]))
    off, speed = np.abs(errors), np.array(speeds)
    windy = sum("wind.x" in result["true"] for result in results)
    near = int(np.sum(off <= np.maximum(NEAR, NEAR_SHARE * speed)))
    return [
        f"Wind's speed: shown in {len(off)} of {windy} windy flights; off by {np.median(off):.2f} m/s in the median, "
        f"{np.percentile(off, 90):.2f} in nine of ten; within {100 * NEAR_SHARE:g} % or {NEAR:g} m/s in {near}."
    ]


def _intervals(results: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = ["| parameter | shown | 90 % intervals that hold | 95 % | RMS of error over deviation | median deviation |"]
    lines.append("| --- | --- | --- | --- | --- | --- |")
    for name in ("wind.x", "wind.y", "rotor_drag.coefficient", "parasitic_drag.coefficient"):
        shown = [(r["followed"][name], r["true"].get(name, 0.0)) for r in results if r["followed"][name][2]]
        ratios = np.array([(value - true) / std for (value, std, _), true in shown])
        holds = [f"{np.mean(np.abs(ratios) <= limit):.0%}" for limit in (NINETY, 1.96)]
        spread, width = np.sqrt(np.mean(ratios**2)), np.median([std for (_, std, _), _ in shown])
        lines.append(f"| {name} | {len(shown)} | {holds[0]} | {holds[1]} | {spread:.2f} | {width:.2g} |")
    return lines


def _agreement(results: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = ["| effect | agrees | differs | not estimated |", "| --- | --- | --- | --- |"]
    for name in ("wind", "rotor_drag", "parasitic_drag"):
        counts = Counter(result["outcomes"][name][0] for result in results if name in result["outcomes"])
        lines.append(f"| {name} | {counts['agrees']} | {counts['differs']} | {counts['not_estimated']} |")
    return lines


def _next_files(results: Sequence[Mapping[str, Any]]) -> list[str]:
    added = [result for result in results if result["added"]]
    refused = Counter(result["refused"].split(":")[0].split(" from ")[0] for result in results if not result["added"])
    why_not = "".join(f"; {reason} in {count}" for reason, count in refused.items())
    lines = [f"--from-flight wrote a file in {len(added)} of {len(results)} flights{why_not}."]
    for kind in ("imu", "mocap"):
        pairs = np.array([result["errors"][kind] for result in added if kind in result["errors"]])
        if len(pairs):
            ratio = pairs[:, 1] / pairs[:, 0]
            lines.append(
                f"Error on another flight in still air ({kind}): {np.median(pairs[:, 0]):.2f} with the file, "
                f"{np.median(pairs[:, 1]):.2f} with the next one, floor {np.median(pairs[:, 2]):.2f} m/s^2; ratio "
                f"{np.median(ratio):.2f} in the median, {ratio.max():.2f} in the worst."
            )
    return lines


def estimates(words: Sequence[str]) -> Page:
    """Fly what has not been flown. Returns the page."""
    options = options_of(__doc__, resumes="flight_estimates", jobs=2, seeds=60, first=FIRST_SEED).parse_args(words)
    seeds = range(options.first, options.first + options.seeds)
    results = measured(flown, seeds, options, spoken, key_of=lambda seed: seed, key="seed")
    return Page("flight_estimates", "What a model followed in flight", table(results))


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['seed']} {result['reference']} {result.get('outcomes')} {result.get('added')}"
