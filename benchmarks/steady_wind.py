"""The wind of a steady flight, named by a vehicle whose file has its drag. Writes results/steady_wind.md.

In lockstep on random winds; the file's drag is 5 % off, as one of a diagnosis is. Finished flights are kept, so that a
run that was stopped resumes.

    python -m benchmarks.steady_wind --flights 40 --table
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from benchmarks.adaptation import DRAG, MODES, VEHICLE
from benchmarks.resumable import measured, options_of, publish
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from simulation.lockstep import fly_reference
from vehicles import FOLDER

MANOEUVRES = ("hover", "line", "circle", "Ellipse_1")
WINDS = (2.0, 10.0)  # m/s
DRAG_ERROR = 0.05  # standard deviation, as a share of it
SECONDS = 20.0
FIRST_SEED = 87_000


def drawn(number: int) -> dict[str, Any]:
    """A flight by its number."""
    random = np.random.default_rng((FIRST_SEED, number))
    speed, heading = random.uniform(*WINDS), random.uniform(0.0, 2 * np.pi)
    return {
        "key": number,
        "reference": MANOEUVRES[number % len(MANOEUVRES)],
        "wind": [float(speed * np.cos(heading)), float(speed * np.sin(heading))],
        "share": float(1.0 + DRAG_ERROR * random.normal()),
    }


def flown(case: Mapping[str, Any]) -> dict[str, Any]:
    """Named effects at the end of a flight, with standard deviations."""
    vehicle = read_vehicle(FOLDER / f"{VEHICLE}.toml")
    name, values = DRAG
    coefficient = values["coefficient"]
    identified = vehicle.with_effects(EffectUse(name, {"coefficient": case["share"] * coefficient}))
    mode, follow = MODES["named"]
    settings = AdaptationSettings(mode=mode, follow=follow)  # type: ignore[arg-type]
    controller = Controller.build(identified, ControllerOptions.for_vehicle(identified, adaptation=settings))
    x, y = case["wind"]
    flight = fly_reference(
        vehicle,
        named_reference(case["reference"], identified, duration=SECONDS),
        effects=[EffectUse(name, values), EffectUse("wind", {"x": x, "y": y, "z": 0.0})],
        seed=FIRST_SEED + case["key"],
        controller=controller,
    )
    assert controller.adaptation is not None
    followed = controller.adaptation.followed.parameters
    named = [[followed[f"wind.{axis}"].value, followed[f"wind.{axis}"].std] for axis in "xy"]
    return {**case, "named": named, "aborted": flight.aborted}


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """By manoeuvre: how far off the wind's speed is, and how many intervals of 90 % hold."""
    body = [
        f"{VEHICLE} in winds of {WINDS[0]:g} to {WINDS[1]:g} m/s, {SECONDS:g} s; its file has rotor_drag, "
        f"{DRAG_ERROR:.0%} off. True: speed within 10 % or 0.3 m/s. Intervals: of wind.x and wind.y.",
        "",
        "| reference | flights | off, median, m/s | nine of ten | true | 90 % intervals hold | median deviation, m/s |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for reference in (*MANOEUVRES, "all"):
        some = [r for r in results if reference in (r["reference"], "all")]
        if some:
            body.append(f"| {reference} | {len(some)} | {' | '.join(_cells(some))} |")
    ended = [f"{r['key']}: {r['aborted']}" for r in results if r["aborted"]]
    return "\n".join([*body, "", f"Flights that ended early: {'; '.join(ended) or 'none'}."])


def _cells(some: Sequence[Mapping[str, Any]]) -> list[str]:
    true, named = np.array([r["wind"] for r in some]), np.array([r["named"] for r in some])
    speed, estimate = np.linalg.norm(true, axis=1), np.linalg.norm(named[:, :, 0], axis=1)
    off = np.abs(estimate - speed)
    holds = np.abs(named[:, :, 0] - true) < 1.645 * named[:, :, 1]
    return [
        f"{np.median(off):.2f}",
        f"{np.quantile(off, 0.9):.2f}",
        f"{np.count_nonzero(off < np.maximum(0.1 * speed, 0.3))}",
        f"{np.count_nonzero(holds)} of {holds.size}",
        f"{np.median(named[:, :, 1]):.2f}",
    ]


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']} {result['reference']}: {result['wind']} {result['named']} {result['aborted']}"


def main() -> None:
    """Fly what has not been flown, and write the table."""
    options = options_of(__doc__, "steady_wind", flights=40).parse_args()
    results = measured(flown, map(drawn, range(options.flights)), options, spoken, key_of=itemgetter("key"))
    publish("steady_wind", "The wind of a steady flight", table(results), options)


if __name__ == "__main__":
    main()
