"""Effect of output error on parameters: planted effects fitted by equation error, then by output error.

Nine flights of 12 s of the mock's vehicle (M) and of RotorPy's (R); two are held out. The held-out errors are those by
which `alula add` decides which of the two fits it keeps.

    python -m benchmarks estimation output_error
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

from benchmarks.measurement import Page, measured, options_of, paragraph_of
from diagnosis.addition import add_effect
from diagnosis.data.dataset import make_dataset
from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.evaluation import reduced_chi_square, residuals
from diagnosis.estimation.output_error import refit
from diagnosis.selection.regression_of_flights import make_regression
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError
from dynamics.rate_loop import ACTUATION_DELAY
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from fixtures.hidden_effect import fly
from fixtures.rotorpy_flights import FINE_STEP, rotorpy_flights
from vehicles import FOLDER

SENSORS = ("imu_bias", "gyro_bias", "time_delay")


@dataclass(frozen=True)
class Case:
    """late: delay of a command, s, which the fit cannot tell from lag."""

    source: str
    use: EffectUse
    noise: float
    late: float = 0.0


TRUTHS = (
    EffectUse("rotor_drag", {"coefficient": 1.5e-5}),
    EffectUse("mass", {"ratio": 1.05}),
    EffectUse("inertia", {"ratio_x": 1.2, "ratio_y": 1.1, "ratio_z": 1.1}),
)
MOCK_ALONE = (
    EffectUse("rotor_gyroscopic", {"inertia": 3e-6}),
    EffectUse("slung_load", {"mass": 0.03, "length": 0.5}),
    EffectUse("weak_rotor", {"loss": 0.05}, 1),
)


def cases() -> list[Case]:
    listed = [Case(source, use, 1.0) for use in TRUTHS for source in "MR"]
    listed += [Case("M", use, 1.0) for use in MOCK_ALONE]
    lag = EffectUse("motor_lag", {"time_constant": 0.04})
    return [*listed, Case("M", lag, 1.0, ACTUATION_DELAY), Case("R", lag, 1.0, FINE_STEP / 2)]


def run(case: Case) -> dict[str, Any]:
    """Rows of the table: one a parameter."""
    vehicle, use = read_vehicle(FOLDER / "arpl_250g.toml"), case.use
    if case.source == "M":
        flights = fly((use,), noise=case.noise, seed=11)
    else:
        flights = rotorpy_flights(vehicle, [use], seed=11, noise=case.noise, commands=use.name == "motor_lag")
    data = make_dataset(flights, vehicle)
    some = {name: CATALOGUE[name] for name in (use.name, *SENSORS)}
    regression = make_regression(vehicle, some, data.fitted, data.flight_of)
    mine = [c for c in regression.candidates if c.effect.name == use.name and c.rotor == use.rotor]
    first = min((fit(regression, [c]) for c in mine), key=lambda one: one.chi_square)
    second = refit(first, vehicle, some, data.fitted, data.held_out)
    assert second is not None
    one_step = [
        reduced_chi_square(residuals(f.vehicle, some, data.held_out, regression.noise), regression.noise)
        for f in (first, second.fit)
    ]
    try:
        added = add_effect(use.name, data, vehicle, some, date="2026-01-01", rotor=use.rotor)
        chosen = "output error" if added.by_output_error else "equation error"
    except DataError:
        chosen = "not added"
    rows = []
    for (key, name), estimate in first.estimates.items():
        true = use.parameters[name] + (case.late if name == "time_constant" else 0.0)
        again = second.fit.estimates[key, name]
        listed = [f"{100 * (e.value / true - 1):+.2f} ± {196 * e.std / abs(true):.2f}" for e in (estimate, again)]
        rows.append(
            f"| {case.source} | {key} {name} | {case.noise:g} | {listed[0]} | {listed[1]} | {one_step[0]:.3f}, "
            f"{one_step[1]:.3f} | {second.before:.3f}, {second.after:.3f} | {chosen} |"
        )
    return {"key": repr(case), "rows": rows}


def table(rows: Sequence[str]) -> str:
    fits = [f"{which}, % off ± 95 %" for which in ("equation error", "output error")]
    head = "| " + " | ".join(["flights", "parameter", "noise", *fits, "chi-square, one step", "windows", "kept"]) + " |"
    return "\n".join([paragraph_of(__doc__), "", head, "|" + " --- |" * 8, *rows])


def output_error(words: Sequence[str]) -> Page:
    """The measurement's page."""
    options = options_of(__doc__, resumes="output_error", jobs=1).parse_args(words)
    results = measured(run, cases(), options, itemgetter("key"), key_of=repr)
    rows = [row for result in results for row in result["rows"]]
    return Page("output_error", "Output error against equation error", table(rows))
