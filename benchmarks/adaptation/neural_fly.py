"""The figure-eight in wind of Neural-Fly, in lockstep on the mock's vehicle. Writes results/neural_fly.md.

O'Connell et al., Science Robotics 2022: (1.25 sin t, 0, 0.75 sin 2t) m, a lap in 6.28 s, in winds of 0, 4.2, 8.5, 12.1
and 8.5 + 2.4 sin t m/s along x. Their published errors over those of their controller that does not adapt are compared
with ours over those of the vehicle file's model. Their vehicle's drag in its published flights is about 0.5 m/s^2 per
m/s; so is the one that is hidden here. Finished flights are kept, so that a run that was stopped resumes.

    python -m benchmarks adaptation neural_fly --seeds 5
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.adaptation import MODES, VEHICLE
from benchmarks.measurement import Page, measured, options_of
from dynamics.references.curve import FLAT, HarmonicCurve
from dynamics.references.reference import Reference
from dynamics.references.time_law import TimeLaw
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from simulation.lockstep import ParameterStep, fly_reference
from vehicles import FOLDER

ROTOR_DRAG = 2.5e-5  # N s^2/(rad m): 0.5 m/s^2 per m/s in hover
WINDS: Mapping[str, tuple[float, float, float]] = {  # mean and amplitude, m/s; published ratio
    "0": (0.0, 0.0, 0.34),
    "4.2": (4.2, 0.0, 0.59),
    "8.5": (8.5, 0.0, 0.61),
    "12.1": (12.1, 0.0, 0.54),
    "8.5 + 2.4 sin t": (8.5, 2.4, 0.29),
}
LAPS, RAMP, FIRST_SEED = 7, 3.0, 61_000
WIND_STEP, RISE = (
    0.05,
    4.0,
)  # s: of the wind as it is given, and in which it rises, as the autopilot takes off in calm air
COUNTED = 10.0  # s from which on errors count: two laps of wind


@dataclass(frozen=True)
class Case:
    """A flight."""

    wind: str
    mode: str
    seed: int

    @property
    def key(self) -> str:
        """Unique name."""
        return f"{self.wind}, {self.mode}, {self.seed}"


def figure_eight(vehicle: Vehicle) -> Reference:
    """Neural-Fly's, with its lowest point 1 m above the ground."""
    cosine, sine = np.zeros((3, FLAT)), np.zeros((3, FLAT))
    cosine[0, 2], sine[1, 0], sine[2, 2] = 1.75, 1.25, 0.75
    law = TimeLaw(1.0, RAMP, 2 * np.pi * LAPS + RAMP)
    return Reference("figure-eight", HarmonicCurve(cosine, sine, np.zeros(FLAT)), law, vehicle)


def flown(case: Case) -> dict[str, Any]:
    """Errors of a flight, m, in its settled part, and what was estimated."""
    vehicle = read_vehicle(FOLDER / f"{VEHICLE}.toml")
    mode, follow = MODES[case.mode]
    settings = AdaptationSettings(mode=mode, follow=follow)  # type: ignore[arg-type]
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=settings))
    reference = figure_eight(vehicle)
    mean, amplitude, _ = WINDS[case.wind]
    times = np.arange(0.0, reference.duration if amplitude else RISE + WIND_STEP, WIND_STEP)
    phase = np.random.default_rng((FIRST_SEED, case.seed)).uniform(0, 2 * np.pi)  # of the wind beside the laps
    speeds = np.minimum(times / RISE, 1.0) * (mean + amplitude * np.sin(times + phase))
    flight = fly_reference(
        vehicle,
        reference,
        effects=[
            EffectUse("rotor_drag", {"coefficient": ROTOR_DRAG}),
            EffectUse("wind", {"x": 0.0, "y": 0.0, "z": 0.0, "coefficient": 0.0}),
        ],
        seed=FIRST_SEED + case.seed,
        controller=controller,
        steps=[ParameterStep(float(t), {"wind.x": float(speed)}) for t, speed in zip(times, speeds, strict=True)],
    )
    true, setpoint = flight.truth.stream("position"), flight.log.stream("position_setpoint")
    assert true is not None
    assert setpoint is not None
    squares = np.sum((true.values - setpoint.values) ** 2, axis=1)[true.time > COUNTED]
    adaptation = controller.adaptation
    followed = {} if adaptation is None else adaptation.followed.parameters
    return {
        **asdict(case),
        "key": case.key,
        "rmse": float(np.sqrt(squares.mean())) if squares.size else float("nan"),
        "largest": float(np.sqrt(squares.max())) if squares.size else float("nan"),
        "aborted": flight.aborted,
        "events": dict(flight.events),
        "parameters": {name: [value.value, value.std] for name, value in followed.items()},
    }


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Errors by wind, and their ratios beside the published ones."""
    seeds = len({r["seed"] for r in results})
    body = [
        f"Position error, cm RMS, from {COUNTED:g} s on of {LAPS} laps: median of {seeds} seeds (worst). Ratios: to "
        "the file's model with the same seed, median (worst). Published: Neural-Fly over its controller that does not "
        f"adapt. A drag of {ROTOR_DRAG:g} N s^2/(rad m) and the wind are hidden, the latter with a random phase where "
        "it changes; the effectiveness of thrust follows in all.",
        "",
        "| wind, m/s | file's model | disturbance | and named | ratio, disturbance | ratio, named | published |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    usual = {(r["wind"], r["seed"]): r["rmse"] for r in results if r["mode"] == "file"}
    for wind, (_, _, published) in WINDS.items():
        errors = {mode: [r for r in results if (r["wind"], r["mode"]) == (wind, mode)] for mode in MODES}
        cells = [_cell([100 * r["rmse"] for r in errors[mode]]) for mode in MODES]
        cells += [
            _cell([r["rmse"] / usual[wind, r["seed"]] for r in errors[mode] if (wind, r["seed"]) in usual])
            for mode in ("disturbance", "named")
        ]
        body.append(f"| {wind} | {' | '.join(cells)} | {published:.2f} |")
    ended = [f"{r['key']}: {r['aborted']}" for r in results if r["aborted"]]
    refused = sum("adaptation_refused" in r["events"] for r in results)
    body += [
        "",
        f"Flights that ended early: {'; '.join(ended) or 'none'}. What was estimated was refused in {refused}.",
    ]
    body += [
        "",
        "Theirs are flights of a real vehicle, whose errors have a floor of centimetres; the floor here is that of "
        "the mock's estimates. Neither controller that does not adapt has an integrator.",
    ]
    body += ["", "Named at the end of a flight: median, and the median standard deviation.", ""]
    body += ["| wind, m/s | wind.x | rotor_drag, 1e-5 | parasitic_drag, 1e-3 |", "| --- | --- | --- | --- |"]
    for wind in WINDS:
        some = [r["parameters"] for r in results if (r["wind"], r["mode"]) == (wind, "named")]
        named = ("wind.x", 1.0), ("rotor_drag.coefficient", 1e5), ("parasitic_drag.coefficient", 1e3)
        cells = [_named([p[name] for p in some], scale) for name, scale in named]
        body.append(f"| {wind} | {' | '.join(cells)} |")
    return "\n".join(body)


def _cell(values: Sequence[float]) -> str:
    return f"{float(np.median(values)):.2f} ({max(values):.2f})" if values else ""


def _named(values: Sequence[Sequence[float]], scale: float) -> str:
    value, std = (scale * float(part) for part in np.median(np.array(values), axis=0)) if values else (np.nan, np.nan)
    return f"{value:.2f} +- {std:.2f}"


def neural_fly(words: Sequence[str]) -> Page:
    """Fly what has not been flown. Returns the page."""
    options = options_of(__doc__, resumes="neural_fly", jobs=1, seeds=5).parse_args(words)
    cases = [Case(wind, mode, seed) for seed in range(options.seeds) for wind in WINDS for mode in MODES]
    results = measured(flown, cases, options, spoken, key_of=lambda case: case.key)
    return Page("neural_fly", "The figure-eight of Neural-Fly", table(results))


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']}: {100 * result['rmse']:.2f} cm {result['aborted']} {result['events']}"
