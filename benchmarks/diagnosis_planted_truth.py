"""Does diagnosis name what is planted? Effects of the catalogue hidden in simulated flights, at sizes set by the noise.

Every case is nine flights of about 12 s by the runtime on the mock's vehicle (two held out). An effect's size is such
that at its best channel it makes 0.1, 0.4, 1.5 or 5 times the noise floor. Even seeds are for calibrating thresholds,
odd seeds for the table. Finished cases are kept in a file, so that a run that was stopped goes on where it was.

    python benchmarks/diagnosis_planted_truth.py --seeds 4 --noise 1 3 --strengths 0.1 0.4 1.5 5 --nothing 20
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rich.progress import track

from alula.parallel import parallel_map
from benchmarks.provenance import write_result
from diagnosis.candidates import Candidate
from diagnosis.diagnose import Findings, diagnose
from diagnosis.evaluation import floors
from diagnosis.regression import Regression, make_regression
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from tests.support.planted import noisy, planted_dataset
from vehicles import FOLDER

KEPT = Path("build/diagnosis_planted_truth.jsonl")
INVISIBLE = ("motor_lag", "gust")  # with measured rotor speeds the first does not show; the second is no single number


@dataclass(frozen=True)
class Case:
    """An effect (none if empty) at a strength over the noise floor, a noise factor and a seed."""

    effect: str
    strength: float
    noise: float
    seed: int

    @property
    def key(self) -> str:
        return f"{self.effect or 'nothing'} {self.strength:g} {self.noise:g} {self.seed}"


@cache
def vehicle() -> Vehicle:
    return read_vehicle(FOLDER / "arpl_250g.toml")


@cache
def yardstick(noise: float) -> Regression:
    """A regression on flights that hide nothing: it tells how much an effect of a size shows."""
    data = planted_dataset(vehicle(), [], seed=9000, options=noisy(noise))
    return make_regression(vehicle(), CATALOGUE, data.fitted, data.flight_of)


def planted(case: Case) -> EffectUse:
    """The effect at the size that makes `strength` times the noise floor at its best channel."""
    effect, regression = CATALOGUE[case.effect], yardstick(case.noise)
    random = np.random.default_rng([case.seed, len(case.effect)])
    mine = [c for c in regression.candidates if c.effect is effect]
    candidate = mine[int(random.integers(len(mine)))]
    if candidate.whole:
        size = case.strength / shown(regression, candidate, np.ones(1))
        return EffectUse(case.effect, {k: v * size for k, v in candidate.at.items()}, candidate.rotor)
    parameters = {p.name: p for p in effect.parameters}
    towards = np.array([direction(parameters[n], random) for n in candidate.free])
    size = case.strength / shown(regression, candidate, towards)
    values = {n: candidate.at[n] + size * t for n, t in zip(candidate.free, towards, strict=True)}
    clipped = {n: float(np.clip(v, parameters[n].lower, parameters[n].upper)) for n, v in values.items()}
    return EffectUse(case.effect, {**candidate.at, **clipped}, candidate.rotor)


def direction(parameter, random) -> float:
    """From neutral towards the usual value, or to either side where there is no side."""
    prior = parameter.prior(vehicle())
    usual = prior.mean - parameter.neutral
    return usual if usual else prior.std * random.choice([-1.0, 1.0])


def shown(regression: Regression, candidate: Candidate, towards: np.ndarray) -> float:
    """RMS that a change of the candidate's coefficients makes, over the floor, at the kind that shows it best."""
    made = np.vstack([x[:, :, list(candidate.columns)] @ towards for x in regression.columns])
    floor = list(floors(regression.noise).values())
    return max(
        float(np.sqrt(np.mean(np.sum(made[:, 3 * i : 3 * i + 3] ** 2, axis=1))) / floor[i])
        for i in range(4)
        if floor[i]
    )


def run(case: Case) -> dict[str, object]:
    """Fly, diagnose, and what came of it."""
    uses = [planted(case)] if case.effect else []
    try:
        data = planted_dataset(vehicle(), uses, seed=case.seed, options=noisy(case.noise))
        began = time.perf_counter()
        findings = diagnose(data, vehicle(), CATALOGUE)
    except Exception as error:  # a case that cannot be flown or answered is a result, too
        return {**asdict(case), "error": f"{type(error).__name__}: {error}"[:200]}
    return {**asdict(case), "took": time.perf_counter() - began, **outcome(findings, uses)}


def outcome(findings: Findings, uses: Sequence[EffectUse]) -> dict[str, object]:
    said = findings.diagnosis
    errors = {k: (c.before / c.floor, c.after / c.floor) for k, c in said.channels.items()}
    result: dict[str, object] = {
        "verdict": said.verdict,
        "names": [e.name for e in said.effects],
        "rivals": [list(e.ambiguous_with) for e in said.effects],
        "confidence": [e.confidence for e in said.effects],
        "over_floor": errors,
        "leftover": asdict(findings.leftover),
        "misfit": (findings.misfit_before, findings.misfit_after),
        "singles": [(s.candidates[0].effect.name, s.score) for s in findings.selection.singles[:5]],
    }
    if uses and said.effects and said.effects[0].name == uses[0].name:
        found, true = said.effects[0].parameters, uses[0].parameters
        result["parameters"] = {n: (true[n], p.value, p.std) for n, p in found.items() if p.std > 0 and n in true}
        result["rotor_right"] = said.effects[0].rotor == uses[0].rotor
    return result


def cases(options: argparse.Namespace) -> list[Case]:
    names = [n for n in CATALOGUE if n not in INVISIBLE]
    planned = [
        Case(name, strength, noise, seed)
        for seed in range(options.first, options.first + options.seeds)
        for noise in options.noise
        for strength in options.strengths
        for name in names
    ]
    nothing = [Case("", 0.0, noise, 500 + options.first + i) for noise in options.noise for i in range(options.nothing)]
    return [*nothing, *planned]


def table(results: Sequence[dict]) -> str:
    reported = [r for r in results if r["seed"] % 2 == 1 and "error" not in r]
    failed = [r for r in results if "error" in r]
    lines = [f"{len(results)} cases, {len(reported)} of them with odd seeds, which are reported.", ""]
    nothing = [r for r in reported if not r["effect"]]
    false = sum(r["verdict"] != "explained" for r in nothing)
    lines += [f"Nothing hidden: {false} false alarms in {len(nothing)}.", ""]
    lines += [
        "| strength | cases | first right | right or in a set of two | none named | wrong | unknown | after/floor |"
    ]
    lines += ["| --- | --- | --- | --- | --- | --- | --- | --- |"]
    for strength in sorted({r["strength"] for r in reported if r["effect"]}):
        lines.append(row(strength, [r for r in reported if r["effect"] and r["strength"] == strength]))
    wrong = [r for r in reported if r["effect"] and (r["names"] or [""])[0] != r["effect"]]
    lines += ["", "Not named first: " + ("; ".join(described(r) for r in wrong) or "none") + "."]
    if failed:
        lines += [
            "",
            "No answer: " + "; ".join(f"{r['effect']} x{r['strength']:g}: {r['error']}" for r in failed) + ".",
        ]
    lines += ["", *parameter_lines(reported)]
    return "\n".join(lines)


def row(strength: float, results: Sequence[dict]) -> str:
    right = sum((r["names"] or [""])[0] == r["effect"] for r in results)
    near = sum(r["effect"] in [*(r["names"] or [""])[:1], *((r["rivals"] or [[]])[0][:1])] for r in results)
    silent = sum(not r["names"] for r in results)
    unknown = sum(r["verdict"] == "unknown" for r in results)
    after = np.median([max(v[1] for v in r["over_floor"].values()) for r in results])
    count = len(results)
    return (
        f"| {strength:g} | {count} | {right} | {near} | {silent} | {count - right - silent} | {unknown} | {after:.2f} |"
    )


def described(r: dict) -> str:
    return f"{r['effect']} x{r['strength']:g} (seed {r['seed']}): {', '.join(r['names']) or 'none'} ({r['verdict']})"


def parameter_lines(reported: Sequence[dict]) -> list[str]:
    errors, inside, count = [], 0, 0
    for r in reported:
        for true, value, std in r.get("parameters", {}).values() if r["strength"] >= 1.5 else ():
            scale = max(abs(true), 1e-12)
            errors.append(abs(value - true) / scale)
            inside += abs(value - true) <= 1.96 * std
            count += 1
    if not count:
        return []
    return [f"Parameters at strength 1.5 and above: median error {100 * np.median(errors):.1f} %, "
            f"95 % intervals hold {inside} of {count}."]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--noise", type=float, nargs="+", default=[1.0])
    parser.add_argument("--strengths", type=float, nargs="+", default=[0.4, 1.5])
    parser.add_argument("--nothing", type=int, default=6)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--budget", type=float, default=float("inf"), help="seconds after which no case is begun")
    options = parser.parse_args()
    KEPT.parent.mkdir(exist_ok=True)
    done = {}
    if KEPT.exists():
        done = {json.loads(line)["key"]: json.loads(line) for line in KEPT.read_text().splitlines()}
    todo = [case for case in cases(options) if case.key not in done]
    began = time.monotonic()
    with KEPT.open("a") as file:
        for index, result in track(parallel_map(run, todo, jobs=options.jobs), total=len(todo)):
            done[todo[index].key] = {"key": todo[index].key, **result}
            print(json.dumps(done[todo[index].key]), file=file, flush=True)
            if time.monotonic() - began > options.budget:
                break
    write_result("diagnosis_planted_truth", "Planted truth: does diagnosis name it?", table(list(done.values())))


if __name__ == "__main__":
    main()
