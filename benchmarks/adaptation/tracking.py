"""Tracking with a model that follows in flight, and what following costs a tick."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.adaptation import DRAG, MANOEUVRES, MODES, VEHICLE
from benchmarks.measurement import Page, measured, options_of
from dynamics.arrays import Floats
from dynamics.effects import CATALOGUE
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import find_vehicle, read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.followed_parameters import with_followed
from runtime.flight.flyer import Flyer
from runtime.flight_setup import FOLLOWED
from simulation.lockstep import fly_reference
from vehicles import FOLDER

HIDDEN: Mapping[str, tuple[tuple[str, dict[str, float]], ...]] = {
    "nothing": (),
    "wind 4 m/s": (DRAG, ("wind", {"x": 4.0, "y": 0.0, "z": 0.0})),
    "wind 8 m/s": (DRAG, ("wind", {"x": 8.0, "y": 0.0, "z": 0.0})),
    "drags": (DRAG, ("parasitic_drag", {"coefficient": 0.01})),
    "drags in wind": (DRAG, ("parasitic_drag", {"coefficient": 0.01}), ("wind", {"x": -2.0, "y": 4.0, "z": 0.0})),
    "mass + 15 %": (("mass", {"ratio": 1.15}),),
    "gusts of 1 m/s": (DRAG, ("gust", {"intensity": 1.0})),
}
NAMED = ("nothing", "wind 4 m/s", "wind 8 m/s", "drags", "drags in wind")  # with constants that can be true
NAMED_IN = ("Ellipse_1", "circle", "WarpedEllipse_1")  # beside the Lemniscate, slower
TRACKED = tuple(name for name in HIDDEN if name not in ("nothing", "drags in wind"))
SECONDS, FOLLOWED_AFTER = 24.0, 10.0


@dataclass(frozen=True)
class Case:
    """A flight."""

    hidden: str
    reference: str
    mode: str
    seed: int

    @property
    def key(self) -> str:
        """Unique name."""
        return f"{self.hidden}, {self.reference}, {self.mode}, {self.seed}"


def cases(seeds: int) -> list[Case]:
    """All flights: of what is hidden hover and Lemniscate, of nothing all manoeuvres, and slower ones to name it in."""
    flights = [("nothing", reference) for reference in MANOEUVRES]
    flights += [(hidden, reference) for hidden in TRACKED for reference in ("hover", "Lemniscate")]
    slow = [(hidden, reference) for hidden in NAMED[1:] for reference in NAMED_IN] + [("drags in wind", "Lemniscate")]
    return [
        case
        for seed in range(seeds)
        for case in [
            *(Case(*flight, mode, seed) for flight in flights for mode in MODES),
            *(Case(*flight, "named", seed) for flight in slow),
        ]
    ]


def flown(case: Case) -> dict[str, Any]:
    """Errors of a flight, m, and what was estimated."""
    vehicle = read_vehicle(FOLDER / f"{VEHICLE}.toml")
    mode, follow = MODES[case.mode]
    settings = AdaptationSettings(mode=mode, follow=follow)  # type: ignore[arg-type]
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=settings))
    uses = [EffectUse(name, {**CATALOGUE[name].defaults(vehicle), **values}) for name, values in HIDDEN[case.hidden]]
    reference = named_reference(case.reference, vehicle, duration=SECONDS)
    flight = fly_reference(vehicle, reference, effects=uses, seed=1000 + case.seed, controller=controller)
    true, setpoint = flight.truth.stream("position"), flight.log.stream("position_setpoint")
    assert true is not None
    assert setpoint is not None
    squares = np.sum((true.values - setpoint.values) ** 2, axis=1)
    late = squares[true.time >= FOLLOWED_AFTER]
    adaptation = controller.adaptation
    followed = {} if adaptation is None else adaptation.followed.parameters
    shown = [] if adaptation is None else adaptation.filter.followed.tolist()
    return {
        **asdict(case),
        "key": case.key,
        "rmse": float(np.sqrt(squares.mean())),
        "late_rmse": float(np.sqrt(late.mean())) if late.size else float("nan"),
        "aborted": flight.aborted,
        "events": dict(flight.events),
        "parameters": {name: [value.value, value.std] for name, value in followed.items()},
        "followed": shown,
    }


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Tracking by what is hidden, then wind and drag as they were named, then what is flown with nothing hidden."""
    body = [
        f"Position error, cm RMS: median of {len({r['seed'] for r in results})} seeds (worst), whole flights of "
        f"{SECONDS:g} s; named: also from {FOLLOWED_AFTER:g} s on.",
        "",
        "| hidden | reference | file's model | disturbance | and named | named, later |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for hidden in TRACKED:
        for reference in ("hover", "Lemniscate"):
            some = [r for r in results if (r["hidden"], r["reference"]) == (hidden, reference)]
            cells = [_cell([r["rmse"] for r in some if r["mode"] == mode]) for mode in MODES]
            cells.append(_cell([r["late_rmse"] for r in some if r["mode"] == "named"]))
            body.append(f"| {hidden} | {reference} | {' | '.join(cells)} |")
    body += ["", "With nothing hidden, error over that of the file's model, the same seed: median (worst).", ""]
    body += ["| reference | file's model | disturbance | and named |", "| --- | --- | --- | --- |"]
    usual = {(r["reference"], r["seed"]): r["rmse"] for r in results if (r["hidden"], r["mode"]) == ("nothing", "file")}
    for reference in MANOEUVRES:
        some = [r for r in results if (r["hidden"], r["reference"]) == ("nothing", reference)]
        ratios = [
            [r["rmse"] / usual[reference, r["seed"]] for r in some if r["mode"] == mode]
            for mode in ("disturbance", "named")
        ]
        own = _cell([r["rmse"] for r in some if r["mode"] == "file"])
        body.append(f"| {reference} | {own} cm | {' | '.join(_cell(ratio, 1.0) for ratio in ratios)} |")
    return "\n".join([*body, "", *_named(results)])


def _named(results: Sequence[Mapping[str, Any]]) -> list[str]:
    refused = [r for r in results if r["hidden"] == "nothing" and r["mode"] == "named"]
    lines = [
        f"Of {len(refused)} flights with nothing hidden, what was estimated was refused in "
        f"{sum('adaptation_refused' in r['events'] for r in refused)}, and a change named in "
        f"{sum('model_changed' in r['events'] for r in refused)}.",
        "",
        "Named after a flight: how many of the 95 % intervals hold the truth, of parameters that the data showed; in "
        "brackets the median distance from it.",
        "",
    ]
    flown_in = ("Lemniscate", *NAMED_IN)
    lines += [f"| hidden | parameter | true | {' | '.join(flown_in)} |", "| --- " * (3 + len(flown_in)) + "|"]
    total = [0, 0]
    for hidden in NAMED:
        true = {f"{name}.{key}": value for name, values in HIDDEN[hidden] for key, value in values.items()}
        for name in ("wind.x", "wind.y", "wind.z", "rotor_drag.coefficient", "parasitic_drag.coefficient"):
            cells = [_holding(results, (hidden, reference), name, true.get(name, 0.0), total) for reference in flown_in]
            lines.append(f"| {hidden} | {name} | {true.get(name, 0.0):g} | {' | '.join(cells)} |")
    return [*lines, "", f"All: {total[0]} of {total[1]} hold, {100 * total[0] / max(total[1], 1):.1f} %."]


def _holding(
    results: Sequence[Mapping[str, Any]], flight: tuple[str, str], name: str, true: float, total: list[int]
) -> str:
    """Of a parameter in flights of one kind; counted into the total, too."""
    away = []
    for r in results:
        if (r["hidden"], r["reference"]) == flight and r["mode"] == "named":
            value, std = r["parameters"][name]
            if r["followed"][list(r["parameters"]).index(name)]:
                away.append((abs(value - true), abs(value - true) <= 1.96 * std))
    if not away:
        return "not shown"
    holds = sum(held for _, held in away)
    total[0] += holds
    total[1] += len(away)
    return f"{holds} of {len(away)} ({float(np.median([distance for distance, _ in away])):.2g})"


def _cell(values: Sequence[float], scale: float = 100.0) -> str:
    if not values:
        return ""
    return f"{scale * float(np.median(values)):.2f} ({scale * max(values):.2f})"


def tracking(words: Sequence[str]) -> Page:
    """Tracking with a model that follows in flight, in lockstep on the mock's vehicle. Writes results/adaptation.md.

    What is hidden is in no vehicle file. Compared are the vehicle file's model, the same with the disturbance alone,
    and with wind and drags followed, too. Finished flights are kept, so that a run that was stopped resumes.

        python -m benchmarks adaptation tracking --seeds 10 --jobs 2
    """
    options = options_of(tracking.__doc__, resumes="adaptation", jobs=2, seeds=10).parse_args(words)
    results = measured(flown, cases(options.seeds), options, spoken, key_of=lambda case: case.key)
    return Page("adaptation", "A model that follows in flight", table(results))


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']}: {100 * result['rmse']:.2f} cm {result['aborted']}"


REFERENCE = "Lemniscate"
COST_MODES: dict[str, tuple[str, tuple[str, ...]]] = {
    "off": ("off", ()),
    "disturbance": ("on", ()),
    "off, wind and drags in the file": ("off", FOLLOWED),
    "wind and drags": ("on", FOLLOWED),
}
COST_HIDDEN = (DRAG, ("wind", {"x": 4.0, "y": 0.0, "z": 0.0}))
HALVES = ("step", "prepare")
GOAL = 50.0  # us


def timed(mode: str, follow: tuple[str, ...], seconds: float, repeats: int) -> Floats:
    """(3, ticks) us of each half, and of the solver's feedback in the first: the least of several flights."""
    vehicle = read_vehicle(find_vehicle(VEHICLE))
    flown = with_followed(vehicle, follow)
    uses = [EffectUse(name, dict(values)) for name, values in COST_HIDDEN]
    reference = named_reference(REFERENCE, vehicle, duration=seconds)
    flights = []
    for _ in range(repeats):
        settings = AdaptationSettings(mode=mode, follow=follow)  # type: ignore[arg-type]
        controller = Controller.build(flown, ControllerOptions.for_vehicle(flown, adaptation=settings))
        spent: dict[str, list[float]] = {half: [] for half in HALVES}
        feedback: list[float] = []
        usual = {half: getattr(Flyer, half) for half in HALVES}
        try:
            for half in HALVES:
                setattr(Flyer, half, _watched(usual[half], spent[half], feedback if half == "step" else None))
            fly_reference(vehicle, reference, effects=uses, seed=1, controller=controller)
        finally:
            for half in HALVES:
                setattr(Flyer, half, usual[half])
        flights.append([spent["step"], spent["prepare"], feedback])
    ticks = min(len(half) for flight in flights for half in flight)
    return np.asarray(np.min([[half[:ticks] for half in flight] for flight in flights], axis=0))


def _watched(method: Callable[..., Any], spent: list[float], feedback: list[float] | None) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        began = time.thread_time_ns()
        result = method(*arguments)
        spent.append((time.thread_time_ns() - began) / 1e3)
        if feedback is not None:
            feedback.append(1e6 * result.feedback_seconds)
        return result

    return call


def cost_table(seconds: float, repeats: int) -> str:
    """Median and 99 % of each half, and of what following adds."""
    times = {name: timed(mode, follow, seconds, repeats) for name, (mode, follow) in COST_MODES.items()}
    off = times["off"]
    flying = off[2] > 0
    body = [
        f"{REFERENCE} of {seconds:g} s on {VEHICLE} in wind, 100 Hz, {int(flying.sum())} ticks, processor time in us, "
        f"the least of {repeats} equal flights at each tick: median / 99 %. Added: the difference of the same tick to "
        f"that of the first row, both halves. Goal: {GOAL:g}, the feedback as it is without.",
        "",
        "| model | estimate to setpoint | of it the solver's feedback | preparation | added |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, each in times.items():
        ticks = min(each.shape[1], off.shape[1])
        some = flying[:ticks]
        step, prepare, feedback = (row[:ticks][some] for row in each)
        added = step + prepare - (off[0] + off[1])[:ticks][some]
        cells = [_cost_cell(values) for values in (step, feedback, prepare)] + [
            "" if name == "off" else _cost_cell(added)
        ]
        body.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(body)


def _cost_cell(values: Floats) -> str:
    return f"{np.median(values):.0f} / {np.quantile(values, 0.99):.0f}"


def cost(words: Sequence[str]) -> Page:
    """Cost of following per tick, in the urgent half (estimate to setpoint) and in the preparation after it.

    The same flights in lockstep, tick for tick, by the vehicle file's model and by models that follow: processor time
    of the flight logic's two halves, the least of several flights that do the same. Following adds the difference of
    the same tick, with nothing else that the tick does in it.

        python -m benchmarks adaptation cost [--repeats 7] [--seconds 40]
    """
    parser = options_of(cost.__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=40.0)
    options = parser.parse_args(words)
    text = cost_table(options.seconds, options.repeats)
    return Page("adaptation_cost", "What following costs a tick", text)
