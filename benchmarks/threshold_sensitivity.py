"""Sensitivity of estimates to a fit's thresholds, each halved and doubled. Writes results/threshold_sensitivity.md.

Known sets on flights of the outside simulator, as in `interval_coverage`. A shift is that of an estimate over its
standard deviation, a width is the standard deviation over that with the default; the largest over the cases counts.

    python -m benchmarks.threshold_sensitivity --kept build/thresholds.jsonl --table
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.interval_coverage import Case, fitted_rows
from benchmarks.provenance import write_result
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.errors import AlulaError
from fixtures.outside_cases import flown

CASES = (
    Case("speeds", "linear_drag", 501), Case("speeds", "inertia", 502), Case("speeds", "blade_flapping", 503),
    Case("speeds", "rotor_gyroscopic", 504), Case("commands", "motor_lag", 505), Case("speeds", "gust", 506),
)  # fmt: skip
FLIGHTS = 5
VARIED = (
    "filters.cutoff", "filters.slow_cutoff", "filters.command_cutoff", "filters.edge", "noise.order",
    "noise.spectrum_rows", "regression.ridge", "equation_error.converged", "equation_error.difference_step",
    "equation_error.max_steps", "equation_error.max_cost_growth", "equation_error.block", "equation_error.prior_blocks",
    "gust.max_frequency", "gust.part", "command_curve.gain_std", "command_curve.flight_gain_std",
    "command_curve.motor_std", "command_curve.bend_std", "command_curve.noise", "command_curve.independent_share",
    "command_curve.air_std", "command_curve.lift_std", "command_curve.max_curved_ratio",
)  # fmt: skip
OF_COMMANDS = ("filters.command_cutoff", "command_curve")  # which only cases of commands have
OF_GUSTS = ("gust",)


def changed(name: str, factor: float) -> Thresholds:
    """The thresholds with one of them times a factor, or a growth beyond 1 times it."""
    group, field = name.split(".")
    of_group = getattr(DEFAULT, group)
    value = getattr(of_group, field)
    new = 1 + factor * (value - 1) if field == "max_cost_growth" else factor * value
    new = max(1, round(new)) if isinstance(value, int) else new
    return msgspec.structs.replace(DEFAULT, **{group: msgspec.structs.replace(of_group, **{field: new})})


def cases_of(name: str) -> list[Case]:
    """The cases that a threshold touches."""
    if name.startswith(OF_COMMANDS):
        return [case for case in CASES if case.logged == "commands"]
    if name.startswith(OF_GUSTS):
        return [case for case in CASES if case.name == "gust"]
    return list(CASES)


def measured(done: set[str]) -> Iterator[dict[str, Any]]:
    """The estimates of each case with each threshold."""
    campaigns = [replace(case.campaign(), flights=FLIGHTS) for case in CASES]
    flights = dict(zip(CASES, zip(campaigns, flown(campaigns), strict=True), strict=True))
    jobs = [("default", 1.0, case) for case in CASES]
    jobs += [(name, factor, case) for name in VARIED for factor in (0.5, 2.0) for case in cases_of(name)]
    for name, factor, case in jobs:
        campaign, truths = flights[case]
        key = f"{name} {factor:g} {case.key}"
        if key in done or truths is None:
            continue
        try:
            thresholds = DEFAULT if name == "default" else changed(name, factor)
            rows = fitted_rows(case, campaign, truths, thresholds)
        except (AlulaError, ValueError) as error:
            yield {"key": key, "name": name, "factor": factor, "case": case.key, "refused": str(error)}
            continue
        estimates = {f"{row['effect']} {row['parameter']}": (row["value"], row["std"]) for row in rows}
        yield {"key": key, "name": name, "factor": factor, "case": case.key, "estimates": estimates}


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """A line for each threshold."""
    usual = {r["case"]: r["estimates"] for r in results if r["name"] == "default"}
    lines = ["| threshold | default | halved: shift, width | doubled: shift, width |", "| --- | --- | --- | --- |"]
    for name in VARIED:
        group, field = name.split(".")
        cells = [name, f"{getattr(getattr(DEFAULT, group), field):g}"]
        for factor in (0.5, 2.0):
            some = [r for r in results if r["name"] == name and r["factor"] == factor]
            cells.append(_largest(some, usual))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _largest(some: Sequence[Mapping[str, Any]], usual: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    pairs = [
        (value, usual[r["case"]][name]) for r in some if "estimates" in r for name, value in r["estimates"].items()
    ]
    if not pairs:
        return some[0]["refused"][:60] if some else "-"
    shift = max(abs(new[0] - old[0]) / old[1] for new, old in pairs)
    widths = [new[1] / old[1] for new, old in pairs]
    return f"{shift:.2f}, {min(widths):.2f} to {np.max(widths):.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kept", type=Path, default=Path("build/thresholds.jsonl"))
    parser.add_argument("--table", action="store_true", help="write benchmarks/results/threshold_sensitivity.md")
    options = parser.parse_args()
    options.kept.parent.mkdir(parents=True, exist_ok=True)
    results = [json.loads(line) for line in options.kept.read_text().splitlines()] if options.kept.exists() else []
    for result in measured({r["key"] for r in results}):
        results.append(result)
        with options.kept.open("a") as file:
            print(json.dumps(result), file=file)
        print(result["key"], flush=True)
    if options.table:
        body = f"{__doc__.split(chr(10) * 2)[1]}\n\n{table(results)}"
        write_result("threshold_sensitivity", "What the thresholds of a fit do", body)
    else:
        print(table(results))


if __name__ == "__main__":
    main()
