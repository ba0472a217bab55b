"""Cost of following per tick, in the urgent half (estimate to setpoint) and in the preparation after it.

The same flights in lockstep, tick for tick, by the vehicle file's model and by models that follow: processor time of
the flight logic's two halves, the least of several flights that do the same. Following adds the difference of the same
tick, with nothing else that the tick does in it.

    python -m benchmarks.adaptation_cost [--repeats 7] [--seconds 40] [--table]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.adaptation import DRAG
from benchmarks.provenance import write_result
from dynamics.arrays import Floats
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import find_vehicle, read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.followed_parameters import with_followed
from runtime.flight.flyer import Flyer
from runtime.flight_setup import FOLLOWED
from simulation.lockstep import fly_reference

VEHICLE, REFERENCE = "arpl_250g", "Lemniscate"
MODES: dict[str, tuple[str, tuple[str, ...]]] = {
    "off": ("off", ()),
    "disturbance": ("on", ()),
    "off, wind and drags in the file": ("off", FOLLOWED),
    "wind and drags": ("on", FOLLOWED),
}
HIDDEN = (DRAG, ("wind", {"x": 4.0, "y": 0.0, "z": 0.0}))
HALVES = ("step", "prepare")
GOAL = 50.0  # us


def timed(mode: str, follow: tuple[str, ...], seconds: float, repeats: int) -> Floats:
    """(3, ticks) us of each half, and of the solver's feedback in the first: the least of several flights."""
    vehicle = read_vehicle(find_vehicle(VEHICLE))
    flown = with_followed(vehicle, follow)
    uses = [EffectUse(name, dict(values)) for name, values in HIDDEN]
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


def table(seconds: float, repeats: int) -> str:
    """Median and 99 % of each half, and of what following adds."""
    times = {name: timed(mode, follow, seconds, repeats) for name, (mode, follow) in MODES.items()}
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
        cells = [_cell(values) for values in (step, feedback, prepare)] + ["" if name == "off" else _cell(added)]
        body.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(body)


def _cell(values: Floats) -> str:
    return f"{np.median(values):.0f} / {np.quantile(values, 0.99):.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--table", action="store_true", help="write benchmarks/results/adaptation_cost.md")
    options = parser.parse_args()
    text = table(options.seconds, options.repeats)
    if options.table:
        write_result("adaptation_cost", "What following costs a tick", text)
    else:
        print(text)


if __name__ == "__main__":
    main()
