"""Horizons and nodes of the nominal controller: tracking error by what the flight meets, and the time of a step.

Every manoeuvre of the catalogue but low_flight in lockstep, the shortest number of laps that takes 6 s, by motion
capture. Met: nothing; the manoeuvre at 1.15 times its speed, which saturates the rotors; a leap of the reference by
0.6 m; wind of 3 m/s on an unmodelled rotor drag; 25 % more mass; motors that lag by 40 ms. None of it is in the vehicle
file. Growth: of each interval between nodes over the one before.

    python -m benchmarks tracking horizons [--seeds 1 --further-seeds 1]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from benchmarks.measurement import Page, Result, measured, options_of, paragraph_of
from benchmarks.provenance import commit
from dynamics.arrays import Floats
from dynamics.controller_settings import intervals_of
from dynamics.errors import VehicleError
from dynamics.references import MANOEUVRES, Reference, named_reference
from dynamics.state import POSITION
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller, ControllerOptions
from simulation.lockstep import fly_reference
from vehicles import FOLDER

Grid = tuple[float, int, float]  # horizon, s, nodes, growth
DEFAULT: Grid = (1.0, 20, 1.0)
GRIDS: tuple[Grid, ...] = (DEFAULT, (0.7, 14, 1.0), (0.5, 10, 1.0), (1.0, 14, 1.06), (1.0, 10, 1.2))
FLOWN = tuple(name for name in MANOEUVRES if name != "low_flight")  # whose start, 0.15 m up, lockstep does not reach
CLOSE = 1.03  # of the default's error, to which another grid's counts as the same
DURATION, LEAP, LEAP_TIME, FASTER = 6.0, 0.6, 3.0, 1.15  # s, m, s, factor
MET: Mapping[str, tuple[EffectUse, ...]] = {
    "nothing": (),
    "saturation": (),
    "leap": (),
    "wind": (EffectUse("rotor_drag", {"coefficient": 2.2e-5}), EffectUse("wind", {"x": 3.0, "y": 0.0, "z": 0.0})),
    "payload": (EffectUse("mass", {"ratio": 1.25}),),
    "lag": (EffectUse("motor_lag", {"time_constant": 0.04}),),
}
FINALISTS: tuple[Grid, ...] = (DEFAULT, (0.7, 14, 1.0), (1.0, 14, 1.06))
SHOWN = 12  # flights of a grid that are named
NOTE = (
    "Medians over the flights of the first seed, m; in brackets the ratio to the default's error on the same flight, "
    "over all seeds its median and its largest, and flights that ended early."
)
STEPS = 400  # of the solver, whose time is measured


class Leaping:
    """A reference that leaps sideways once."""

    def __init__(self, reference: Reference) -> None:
        self._reference, self.duration, self.name = reference, reference.duration, reference.name

    def states(self, times: Floats) -> Floats:
        """(n, 13) states."""
        states = self._reference.states(times)
        states[:, POSITION.start] += LEAP * (times >= LEAP_TIME)
        return states

    def inputs(self, times: Floats) -> Floats:
        """(n, rotors) rotor speeds, rad/s."""
        return self._reference.inputs(times)


def vehicle_with(grid: Grid) -> Vehicle:
    """The paper's vehicle with another horizon."""
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    horizon, nodes, growth = grid
    settings = msgspec.structs.replace(vehicle.controller, horizon=horizon, nodes=nodes, growth=growth)
    return msgspec.structs.replace(vehicle, controller=settings)


def horizons(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__, jobs=1, resumes="horizons", seeds=1, further_seeds=1)
    chosen = parser.parse_args(words)
    seeds = chosen.seeds + chosen.further_seeds
    cases = [
        {"grid": grid, "met": met, "manoeuvre": manoeuvre, "seed": seed}
        for seed in range(seeds)
        for manoeuvre in FLOWN
        for met in MET
        for grid in (GRIDS if seed < chosen.seeds else FINALISTS)
    ]
    results = measured(flown, cases, chosen, lambda r: f"{r['key']}: {r['rmse']:.4f} m {r['ended']}", key_of=key_of)
    seeds_flown = f"Seeds: {chosen.seeds} of all grids, {chosen.further_seeds} more of {names_of(FINALISTS)}."
    commits = ", ".join(sorted({result["commit"] for result in results}))
    parts = [paragraph_of(__doc__), f"{seeds_flown} Flown at {commits}.", _table(results), NOTE]
    parts += ["## Beyond 3 %", _beyond(results), "## All, first seed", _each(results)]
    return Page("horizons", "The controller's horizon", "\n\n".join(parts))


def names_of(grids: Sequence[Grid]) -> str:
    """Names of grids, as a sentence lists them."""
    return "; ".join(map(name_of, grids))


def name_of(grid: Grid) -> str:
    """Name of a grid."""
    horizon, nodes, growth = grid
    return f"{horizon:g} s, {nodes}" + (f", x {growth:g}" if growth != 1 else "")


def key_of(case: Mapping[str, Any]) -> str:
    """Key of a case."""
    return f"{name_of(tuple(case['grid']))}: {case['met']} {case['manoeuvre']} {case['seed']}"


def flown(case: Mapping[str, Any]) -> dict[str, Any]:
    """A flight: tracking error, m, and why it ended early."""
    vehicle = vehicle_with(case["grid"])
    faster = f":speed={FASTER}" if case["met"] == "saturation" else ""
    reference = named_reference(f"{case['manoeuvre']}{faster}", vehicle, duration=DURATION)
    path: Any = Leaping(reference) if case["met"] == "leap" else reference
    try:
        flight = fly_reference(vehicle, path, effects=MET[case["met"]], seed=case["seed"])
    except VehicleError as error:
        outcome = {"rmse": float("nan"), "ended": str(error)}
    else:
        outcome = {"rmse": flight.position_rmse, "ended": flight.aborted}
    return {"key": key_of(case), **case, **outcome, "commit": commit()}


def _of(results: Sequence[Result], grid: Grid, met: str) -> dict[tuple[str, int], Result]:
    """Results of a grid by manoeuvre and seed."""
    return {(r["manoeuvre"], r["seed"]): r for r in results if tuple(r["grid"]) == grid and r["met"] == met}


def _ratios(results: Sequence[Result], grid: Grid, met: str) -> dict[tuple[str, int], float]:
    """Errors over those of the default on the same flight, by manoeuvre and seed."""
    usual = _of(results, DEFAULT, met)
    of_default = {at: r["rmse"] for at, r in usual.items() if np.isfinite(r["rmse"])}
    return {at: r["rmse"] / of_default[at] for at, r in _of(results, grid, met).items() if at in of_default}


def _table(results: Sequence[Result]) -> str:
    titles = ["horizon", "nodes", "growth", "intervals, ms", "prepare, us", "feedback, us", *MET]
    rows = [" | ".join(titles), " | ".join(["---"] * len(titles))]
    for grid in GRIDS:
        cells = []
        for met in MET:
            each = {at: r for at, r in _of(results, grid, met).items() if np.isfinite(r["rmse"])}
            ratios = _ratios(results, grid, met)
            median = np.nanmedian([r["rmse"] for (_, seed), r in each.items() if seed == 0] or [np.nan])
            typical, worst = np.nanmedian([*ratios.values()] or [np.nan]), np.nanmax([*ratios.values()] or [np.nan])
            ended = sum(bool(r["ended"]) for r in each.values())
            cells.append(f"{median:.4f} ({typical:.2f}, {worst:.2f}{f', {ended} ended' if ended else ''})")
        prepare, feedback = step_time(grid)
        horizon, nodes, growth = grid
        intervals = [1e3 * interval for interval in intervals_of(*grid)]
        lengths = f"{intervals[0]:.0f} to {intervals[-1]:.0f}" if growth != 1 else f"{intervals[0]:.0f}"
        rows.append(
            f"{horizon:g} s | {nodes} | {growth:g} | {lengths} | {prepare:.0f} | {feedback:.0f} | " + " | ".join(cells)
        )
    return "\n".join(f"| {row} |" for row in rows)


def _beyond(results: Sequence[Result]) -> str:
    """Flights whose error is more than CLOSE times that of the default, by grid."""
    rows = ["grid | flights | above 3 % | which, ratio of errors", "--- | --- | --- | ---"]
    for grid in GRIDS[1:]:
        far, count = [], 0
        for met in MET:
            for (manoeuvre, seed), ratio in _ratios(results, grid, met).items():
                count += 1
                if not ratio <= CLOSE:
                    far.append((ratio, f"{manoeuvre} {met} ({seed}) {ratio:.2f}"))
        named = "; ".join(text for _, text in sorted(far, reverse=True)[:SHOWN])
        rows.append(f"{name_of(grid)} | {count} | {len(far)} | {named}{' ...' if len(far) > SHOWN else ''}")
    return "\n".join(f"| {row} |" for row in rows)


def _each(results: Sequence[Result]) -> str:
    rows = ["manoeuvre | met | " + " | ".join(map(name_of, GRIDS)), " | ".join(["---"] * (2 + len(GRIDS)))]
    for manoeuvre in FLOWN:
        for met in MET:
            cells = []
            for grid in GRIDS:
                each = [r for at, r in _of(results, grid, met).items() if at == (manoeuvre, 0)]
                mean = np.mean([r["rmse"] for r in each] or [np.nan])
                cells.append(f"{mean:.4f}{' ended' if any(r['ended'] for r in each) else ''}")
            rows.append(f"{manoeuvre} | {met} | " + " | ".join(cells))
    return "\n".join(f"| {row} |" for row in rows)


def step_time(grid: Grid) -> tuple[float, float]:
    """Preparation and feedback, us, tenth percentile of some steps: other programs take the processor as well."""
    vehicle = vehicle_with(grid)
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle))
    reference = named_reference("Lemniscate", vehicle, duration=DURATION)
    state, times = reference.states(np.array([4.0]))[0], []
    controller.reset(state, 0.0)
    for tick in range(STEPS):
        now = 4.0 + 0.01 * tick
        states, inputs = reference.states(controller.node_times(now)), reference.inputs(controller.node_times(now))
        controller.prepare(states, inputs[:-1])
        controller.feedback(controller.compensate(reference.states(np.array([now]))[0], now - 0.02, now), now)
        report = controller.solver.report
        times.append((1e6 * report.prepare_seconds, 1e6 * report.feedback_seconds))
    prepare, feedback = np.percentile(times, 10, axis=0)
    return float(prepare), float(feedback)
