"""Scores of `benchmarks.verdicts`: the figures that the verdict is held to, and the list of wrong answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fixtures.outside_effects import FOREIGN

Result = Mapping[str, Any]
MEDIUM = 0.4  # times the noise, from which on an effect counts as medium
SURE = 0.9  # share of resamples
AT_FLOOR = 1.1
VALUE = 0.05  # relative error of a parameter
NAMES: Mapping[str, tuple[str, ...]] = {  # under which the catalogue may know what the simulator hides
    "lost_propeller": ("weak_rotor",),
    "centre_of_mass": ("centre_of_mass", "imu_lever_arm", "pose_lever_arm"),  # the sensors stay where they were
}
ALIKE = ({"mass", "thrust_constant"}, {"torque_constant", "inertia"}, {"wind", "gust"})  # nothing tells these apart


def right(effect: Mapping[str, Any], hidden: Mapping[str, Any], *, rivals: bool = False) -> bool:
    """Whether a named effect is hidden, on its rotor; or, with rivals, one that it is declared to look like."""
    names_given = {effect["name"], *(effect["ambiguous_with"] if rivals else ())}
    for name, values in hidden.items():
        if names_given & set(NAMES.get(name, (name,))):
            same = effect["rotor"] is None or "rotor" not in values or int(values["rotor"]) == effect["rotor"]
            if same or effect["name"] not in NAMES.get(name, (name,)):
                return True
    return False


def sure_falsehoods(result: Result) -> list[Mapping[str, Any]]:
    """Effects that are not there, named with 90 % agreement or more, in any verdict."""
    hidden = result["hidden"]
    return [
        e for e in effects(result)
        if e["confidence"] >= SURE and not right(e, hidden, rivals=True)
    ]  # fmt: skip


def effects(result: Result) -> Sequence[Mapping[str, Any]]:
    """Named."""
    return result["report"]["effects"] if "report" in result else ()


def verdict(result: Result) -> str:
    """One word."""
    return str(result["report"]["verdict"]) if "report" in result else "error" if "error" in result else "refused"


def strength(result: Result) -> float:
    """The greatest over the kinds of channel."""
    return float(max(result["strength"].values(), default=np.inf))


def first_right(result: Result, *, rivals: bool = False) -> bool:
    """Whether the first named effect is hidden, or declared to look like one that is."""
    named = effects(result)
    if not named and rivals:  # declared to be behind a gain of the commands
        return bool(set(as_gain(result)) & set(result["hidden"]))
    return bool(named) and right(named[0], result["hidden"], rivals=rivals)


def as_gain(result: Result) -> Sequence[str]:
    """Effects that are declared to be behind a gain of the commands."""
    gain = result.get("report", {}).get("command_gain") or {}
    return gain.get("look_alikes", ())


def table(results: Sequence[Result]) -> str:
    """All figures, with what they are of."""
    flown = [r for r in results if "report" in r or "error" in r or "refused" in r]
    singles = [r for r in flown if r["kind"] in ("single", "own", "estimator") and strength(r) >= MEDIUM]
    foreign = [r for r in flown if r["kind"] == "outside" and strength(r) >= MEDIUM]
    lines = ["| | measured | goal |", "| --- | --- | --- |"]
    for name in ("speeds", "commands", "campaign", "estimator", "true_file"):
        some = [r for r in flown if r["kind"] == "nothing" and r["name"] == name]
        lines.append(
            _line(f"nothing hidden, {name}: false alarms", some, lambda r: bool(effects(r) or as_gain(r)), "<= 0.5 %")
        )
        lines.append(_line(f"nothing hidden, {name}: explained", some, lambda r: verdict(r) == "explained", ">= 97 %"))
    for kind in ("single", "own", "estimator"):
        some = [r for r in singles if r["kind"] == kind]
        lines.append(_line(f"{kind}, medium and stronger: first right", some, first_right, ">= 97 %"))
        lines.append(_line(f"{kind}: with declared set", some, lambda r: first_right(r, rivals=True), ">= 99 %"))
        lines.append(_line(f"{kind}: right and nothing else named", some, alone, ""))
        lines.append(_line(f"{kind}: unknown", some, lambda r: verdict(r) == "unknown", "<= 5 %"))
    lines.append(_line("named with >= 90 % and wrong", flown, lambda r: bool(sure_falsehoods(r)), "<= 0.5 %"))
    lines.append(_line("outside the catalogue, medium and stronger: named", foreign, claimed, "0"))
    lines.append(_line("outside the catalogue: unknown", foreign, lambda r: verdict(r) == "unknown", ">= 90 %"))
    reasoned = [r for r in foreign if verdict(r) == "unknown"]
    lines.append(_line("of these with a reason", reasoned, lambda r: bool(r["report"].get("leftover")), "100 %"))
    lines += several(flown)
    lines += loops([r for r in flown if r["kind"] == "add"])
    lines += intervals(flown)
    took = [r["took"] * 100 / r["seconds"] for r in flown if "seconds" in r and r["kind"] != "many"]
    if took:
        usual, slow = np.median(took), np.quantile(took, 0.95)
        lines.append(f"| processor time for 100 s of flight, median, 95 % | {usual:.1f}, {slow:.1f} s | <= 2.5 s |")
    lines.append(_line("tracebacks", results, lambda r: "error" in r, "0"))
    lines.append(_line("refused (exit 3)", flown, lambda r: "refused" in r, ""))
    return "\n".join(line for line in lines if line)


def visible(result: Result) -> list[str]:
    """Hidden effects that can show: no gust, which is a nuisance, nor a lag of motors whose speeds are measured."""
    commands = result["conditions"].get("recorder", {}).get("commands", False)
    return [n for n in result["hidden"] if n != "gust" and (n != "motor_lag" or commands)]


def alone(result: Result) -> bool:
    """Whether the hidden effect is named or declared, also behind a gain of the commands, and no other is."""
    declared = bool(set(as_gain(result)) & set(result["hidden"]))
    return (
        (bool(effects(result)) or declared)
        and all(right(e, result["hidden"], rivals=True) for e in effects(result))
        and (verdict(result) != "unknown")
    )


def claimed(result: Result) -> bool:
    """Whether an effect that is not there is the verdict, instead of unknown or explained."""
    return verdict(result) in ("effect", "ambiguous") and not all(
        right(e, result["hidden"], rivals=True) for e in effects(result)
    )


def several(flown: Sequence[Result]) -> list[str]:
    """Many effects at once."""
    lines = []
    for name in ("nine", "random"):
        some = [r for r in flown if r["kind"] == "many" and r["name"] == name and "report" in r]
        hidden = [(r, n) for r in some for n in visible(r)]
        named = [n for r, n in hidden if any(right(e, {n: r["hidden"][n]}, rivals=True) for e in effects(r))]
        false = [e for r in some for e in effects(r) if not right(e, r["hidden"], rivals=True)]
        close = [error for r in some for error, _ in errors(r)]
        if some:
            within = np.mean(np.array(close) <= VALUE) if close else 0.0
            over = [c["after"] / c["floor"] for r in some for c in r["report"]["channels"].values() if c["floor"]]
            typical, worst = np.median(over), max(over)
            lines += [
                f"| many, {name} ({len(some)} sets): effects named | {len(named)} of {len(hidden)} | >= 90 % |",
                f"| many, {name}: named and not there | {len(false)} | 0 |",
                f"| many, {name}: values within 5 % | {100 * within:.0f} % of {len(close)} | all |",
                f"| many, {name}: channels over floor, median, worst | {typical:.2f}, {worst:.2f} | <= 1.1 |",
                f"| many, {name}: processor time, worst | {max(r['took'] for r in some):.0f} s | <= 15 s |",
            ]
    return lines


def loops(some: Sequence[Result]) -> list[str]:
    """Adding until it stops."""
    done = [r for r in some if "rounds" in r]
    if not done:
        return []
    steps = [s for r in done for s in r["rounds"]]
    worse = [
        s for s in steps
        if any(c["after"] > 1.01 * c["before"] for c in s["channels"].values())
    ]  # fmt: skip
    drifted = [s for s in steps if drifted(*s["open_loop"])]
    inside = [r for r in done if r["name"] in ("single", "random")]
    at_floor = [
        r
        for r in inside
        if all(c["before"] <= AT_FLOOR * c["floor"] for c in r["report"]["channels"].values() if c["floor"])
    ]
    return [
        f"| `add` until it stops ({len(done)} loops, {len(steps)} steps): a channel worse | {len(worse)} steps | 0 |",
        f"| `add`: open loop worse | {len(drifted)} steps | 0 |",
        f"| `add`: at the floor in the end, effects of the catalogue | {len(at_floor)} of {len(inside)} | all |",
    ]


def drifted(before: Sequence[Mapping[str, float]], after: Sequence[Mapping[str, float]]) -> bool:
    """Whether any open-loop error grew by more than 2 %."""
    names = ("position", "velocity", "attitude", "rate")
    return any(b[name] > 1.02 * a[name] for a, b in zip(before, after, strict=True) for name in names)


def intervals(flown: Sequence[Result]) -> list[str]:
    """Whether 95 % intervals hold, by effect, where the verdict is right."""
    by: dict[str, list[bool]] = {}
    relative: dict[str, list[float]] = {}
    for result in flown:
        if result["kind"] in ("single", "own", "estimator"):
            for name, error, held in held_by(result):
                by.setdefault(name, []).append(held)
                relative.setdefault(name, []).append(error)
    if not by:
        return []
    every = [h for held in by.values() for h in held]
    off = [f"{n} {sum(h)} of {len(h)}" for n, h in sorted(by.items()) if np.mean(h) < 0.93]
    values = [e for errors_ in relative.values() for e in errors_]
    return [
        f"| intervals hold | {sum(every)} of {len(every)} ({100 * np.mean(every):.0f} %) | 93 to 97 % |",
        f"| effects whose intervals hold less | {', '.join(off) or 'none'} | none |",
        f"| values within 5 % of the truth | {sum(e <= VALUE for e in values)} of {len(values)} | >= 90 % |",
    ]


def held_by(result: Result) -> list[tuple[str, float, bool]]:
    """(effect, relative error, whether its 95 % interval holds the truth) of each parameter that was fitted."""
    made = []
    for e in effects(result):
        hidden = result["hidden"].get(e["name"])
        if hidden is None or not right(e, {e["name"]: hidden}):
            continue
        for name, p in e["parameters"].items():
            if p["std"] > 0 and name in hidden:
                off = abs(p["value"] - hidden[name])
                made.append((e["name"], off / max(abs(hidden[name]), 1e-12), off <= 1.96 * p["std"]))
    return made


def errors(result: Result) -> list[tuple[float, bool]]:
    """Relative errors of values, and whether intervals hold, for effects of size."""
    return [
        (error, held) for name, error, held in held_by(result) if name not in ("gust", "centre_of_mass", "rotor_cant")
    ]


def wrong_answers(results: Sequence[Result]) -> str:
    """One line for each: what was hidden, what was names_given."""
    lines = ["## Wrong answers", ""]
    for r in results:
        if fault := fault_of(r):
            names_given = [_named(e) for e in effects(r)]
            hidden = "; ".join(f"{n} {_short(v)}" for n, v in r["hidden"].items()) or "nothing"
            lines.append(
                f"- **{fault}** `{r['key']}` (x{strength(r):.1f}, {conditions(r)}): {hidden} -> {verdict(r)}: "
                f"{'; '.join(names_given) or r.get('error', r.get('refused', '-'))[:220]}{_refusals(r)}{_over(r)}"
            )
    return "\n".join(lines)


def fault_of(r: Result) -> str:
    """Fault of an answer, empty where there is none."""
    if "error" in r:
        return "traceback"
    if "report" not in r:
        return "refused" if "refused" in r else ""
    if r["kind"] == "add":
        return ""
    if sure_falsehoods(r):
        return "sure and false"
    if r["kind"] == "nothing":
        return "" if verdict(r) == "explained" else "not explained"
    if r["kind"] == "many":
        missing = [n for n in visible(r) if not any(right(e, {n: r["hidden"][n]}, rivals=True) for e in effects(r))]
        return (
            f"{len(missing)} missing"
            if missing
            else ""
            if all(right(e, r["hidden"], rivals=True) for e in effects(r))
            else "false"
        )
    if r["name"] in FOREIGN:
        return "claimed" if claimed(r) else "missed" if strength(r) >= MEDIUM and verdict(r) == "explained" else ""
    if strength(r) < MEDIUM:
        return "claimed" if claimed(r) else ""
    return "" if alone(r) else "unknown" if first_right(r) and verdict(r) == "unknown" else "wrong"


def conditions(r: Result) -> str:
    """How it was flown and logged."""
    c = r["conditions"]
    if "recorder" not in c:
        return "alula campaign"
    recorder = c["recorder"]
    log = "PX4's estimator" if recorder["pose"] == "estimator" else "commands" if recorder["commands"] else "speeds"
    return (
        f"{log}, {recorder['rate']:.0f} Hz, noise {recorder['noise']:.1f}, {c['layout']}{', fast' if c['fast'] else ''}"
    )


def _named(e: Mapping[str, Any]) -> str:
    rivals = f", or {', '.join(e['ambiguous_with'])}" if e["ambiguous_with"] else ""
    rotor = "" if e["rotor"] is None else e["rotor"]
    return f"{e['name']}{rotor} {_values(e)} ({100 * e['confidence']:.0f} %{rivals})"


def _over(r: Result) -> str:
    if "report" not in r:
        return ""
    return " | " + ", ".join(
        f"{kind} {c['before'] / c['floor']:.2f}>{c['after'] / c['floor']:.2f}"
        for kind, c in r["report"]["channels"].items() if c["floor"]
    )  # fmt: skip


def _refusals(r: Result) -> str:
    refused = r["report"].get("refused", ()) if "report" in r else ()
    return f" [refused: {', '.join(e['name'] + ' ' + e['reason'] for e in refused)}]" if refused else ""


def _values(effect: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{p['value']:.3g}" + (f"+-{1.96 * p['std']:.1g}" if p["std"] else "") for p in effect["parameters"].values()
    )


def _short(values: Mapping[str, float]) -> str:
    return ", ".join(f"{v:.3g}" for v in values.values())


def _line(title: str, some: Sequence[Result], counts: Any, goal: str) -> str:
    if not some:
        return ""
    count = sum(bool(counts(r)) for r in some)
    return f"| {title} | {count} of {len(some)} ({100 * count / len(some):.0f} %) | {goal} |"
