"""A payload is taken up or dropped in flight: the worst error, and how soon it is over. Writes results/payload.md.

In lockstep on the mock's vehicle, on the centre and off it. Errors at each time after the step are RMS over the seeds:
single flights wander by centimetres with their estimates. Finished flights are kept, so that a run that was stopped
resumes.

    python -m benchmarks adaptation payload --seeds 6
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.adaptation import VEHICLE
from benchmarks.measurement import Page, measured, options_of
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from simulation.lockstep import ParameterStep, fly_reference
from vehicles import FOLDER

LOAD = 1.2  # mass with it, over mass without
OFF_CENTRE = (0.006, 0.004)  # m by which it moves the centre of mass: it hangs at about half an arm
MANOEUVRES = ("hover", "circle", "Ellipse_1", "Lemniscate:speed=0.7", "Lemniscate")
STEPS = {"taken up": (1.0, LOAD), "dropped": (LOAD, 1.0)}
PLACES = {"centre": (0.0, 0.0), "off it": OFF_CENTRE}
MODES = ("off", "on")
SECONDS, AT, SETTLED = 18.0, 9.0, 3.0  # s: of a flight, of the step, after which the error before and in the end counts
WINDOW = 0.5  # s
GRID = np.arange(0.25, 7.0, 0.05)  # s after the step
FIRST_SEED = 64_000
GOALS = "Goals: worst error 0.3 m; within 1.5 times the error before in 2 s."


@dataclass(frozen=True)
class Case:
    """A flight."""

    reference: str
    step: str
    place: str
    mode: str
    seed: int

    @property
    def key(self) -> str:
        """Unique name."""
        return f"{self.reference}, {self.step}, {self.place}, {self.mode}, {self.seed}"


def flown(case: Case) -> dict[str, Any]:
    """Errors of a flight, m: RMS before and in the end, worst after the step, and RMS over windows after it."""
    vehicle = read_vehicle(FOLDER / f"{VEHICLE}.toml")
    settings = AdaptationSettings(mode=case.mode)  # type: ignore[arg-type]
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=settings))
    before, after = STEPS[case.step]
    place, taken = PLACES[case.place], case.step == "taken up"
    effects, values = [EffectUse("mass", {"ratio": before})], {"mass.ratio": after}
    if any(place):
        there = (0.0, 0.0) if taken else place
        effects.append(EffectUse("centre_of_mass", {"x": there[0], "y": there[1], "z": 0.0, "sensors_stay": 1.0}))
        then = place if taken else (0.0, 0.0)
        values |= {"centre_of_mass.x": then[0], "centre_of_mass.y": then[1]}
    flight = fly_reference(
        vehicle,
        named_reference(case.reference, vehicle, duration=SECONDS),
        effects=effects,
        seed=FIRST_SEED + case.seed,
        controller=controller,
        steps=[ParameterStep(AT, values)],
    )
    true, setpoint = flight.truth.stream("position"), flight.log.stream("position_setpoint")
    assert true is not None
    assert setpoint is not None
    squares, time = np.sum((true.values - setpoint.values) ** 2, axis=1), true.time - AT
    windows = [squares[(time > t - WINDOW / 2) & (time <= t + WINDOW / 2)] for t in GRID]
    ends = squares[(time > SETTLED) & (time < SECONDS - AT)]
    return {
        **asdict(case),
        "key": case.key,
        "before": float(np.sqrt(squares[(time > SETTLED - AT) & (time < 0)].mean())),
        "end": float(np.sqrt(ends.mean())) if ends.size else float("nan"),
        "worst": float(np.sqrt(squares[time >= 0].max())),
        "after": [float(np.sqrt(window.mean())) if window.size else float("nan") for window in windows],
        "aborted": flight.aborted,
        "events": dict(flight.events),
    }


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Errors by manoeuvre, step, place and mode."""
    body = [
        f"A load of {LOAD - 1:.0%} of the mass, on {VEHICLE}, {len({r['seed'] for r in results})} seeds; off centre "
        f"it moves the centre of mass by {1000 * OFF_CENTRE[0]:g} and {1000 * OFF_CENTRE[1]:g} mm. Errors in cm, RMS "
        f"over the seeds, of {WINDOW:g} s. Within: s after the step from which on the error is at most 1.5 times the "
        f"one before, or the one from {SETTLED:g} s after the step on where that is greater: with the load the vehicle "
        f"lacks thrust for the whole Lemniscate. {GOALS}",
        "",
        "| reference | load | place | adapt | before | worst | after 0.5 s | 1 s | 2 s | in the end | within |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for reference in MANOEUVRES:
        for step in STEPS:
            for place in PLACES:
                for mode in MODES:
                    kind = (reference, step, place, mode)
                    some = [r for r in results if (r["reference"], r["step"], r["place"], r["mode"]) == kind]
                    if some:
                        body.append(f"| {' | '.join(kind)} | {' | '.join(_cells(some))} |")
    named = sum("rotor_weak" in r["events"] for r in results if r["mode"] == "on")
    ended = [f"{r['key']}: {r['aborted']}" for r in results if r["aborted"]]
    body += ["", f"Flights in which a rotor was named: {named} of {sum(r['mode'] == 'on' for r in results)}."]
    return "\n".join([*body, f"Flights that ended early: {'; '.join(ended) or 'none'}."])


def _cells(some: Sequence[Mapping[str, Any]]) -> list[str]:
    before, end = (float(np.sqrt(np.mean([r[name] ** 2 for r in some]))) for name in ("before", "end"))
    after = np.sqrt(np.mean(np.square([r["after"] for r in some]), axis=0))
    beyond = GRID[after > 1.5 * max(before, end)]
    within = f"{beyond.max():.1f}" if beyond.size else "0"
    times = [100 * float(np.interp(t, GRID, after)) for t in (0.5, 1.0, 2.0)]
    errors = [100 * before, 100 * max(r["worst"] for r in some), *times, 100 * end]
    return [*(f"{error:.1f}" for error in errors), within]


def payload(words: Sequence[str]) -> Page:
    """Fly what has not been flown. Returns the page."""
    options = options_of(__doc__, resumes="payload", jobs=1, seeds=6).parse_args(words)
    kinds = [
        (reference, step, place, mode)
        for reference in MANOEUVRES
        for step in STEPS
        for place in PLACES
        for mode in MODES
        if mode == "on" or place == "centre"
    ]
    cases = [Case(*kind, seed) for seed in range(options.seeds) for kind in kinds]
    results = measured(flown, cases, options, spoken, key_of=lambda case: case.key)
    return Page("payload", "A payload that is taken up or dropped in flight", table(results))


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']}: {100 * result['worst']:.1f} cm {result['aborted']} {result['events']}"
