"""The judge's page: one line of scores a set, then every answer that is neither right nor declared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.verdict.cases import CaseSet
from benchmarks.verdict.record import Record
from benchmarks.verdict.scoring import Outcome, intervals, outcome_of, unnamed

HEADINGS = (
    "set", "cases", *(str(outcome) for outcome in Outcome), "effects named or declared", "values in their intervals",
    "processor seconds: median, most, all",
)  # fmt: skip
MAX_LENGTH = 260  # of an answer in words
DEFINITIONS = """
**Right**: each hidden effect is named by itself and nothing else; flights that hide nothing are `explained`; a force
that no catalogue has is `unknown`; of a mutated log a refusal or `unknown` is right too. **Declared**: the truth is
among the effects that are declared to look alike, or named beside an `unknown`. **Silent**: nothing false, but a
hidden effect is neither named nor declared, or the answer is refused. **Wrong**: an effect that is not there nor
looks like one that is, in any verdict; `unknown` where nothing is missing; an unexpected error. **Sure and wrong**:
such an effect with a confidence of 90 % or more. Effects that show less than 0.4 times the noise need not be named. A
real flight without a known truth is right where all statements about it hold, wrong where one that forbids does not,
silent where one that demands does not.
""".strip()


def table(records: Sequence[Record], sets: Mapping[str, CaseSet]) -> str:
    """A line for each set and one for all."""
    answered = [record for record in records if not record.lost]
    lines = ["| " + " | ".join(HEADINGS) + " |", "|" + " --- |" * len(HEADINGS)]
    for name, each in sets.items():
        if some := [record for record in answered if record.set_name == name]:
            lines.append(_line(each.title, some))
    return "\n".join([*lines, _line("**all**", answered)] if answered else lines)


def page(records: Sequence[Record], sets: Mapping[str, CaseSet], head: str) -> str:
    """The whole page."""
    lost = [record.key for record in records if record.lost]
    parts = [head, table(records, sets), DEFINITIONS, "## Neither right nor declared", faults(records)]
    if lost:
        parts.append(f"Not asked, as the vehicle did not keep its path: {', '.join(lost)}.")
    return "\n\n".join(parts)


def faults(records: Sequence[Record]) -> str:
    """A line for each answer that is neither right nor declared, the worst first."""
    order = list(Outcome)
    faulty = [(outcome_of(r.answer, r.expected), r) for r in records if not r.lost]
    faulty = [(outcome, r) for outcome, r in faulty if outcome not in (Outcome.RIGHT, Outcome.DECLARED)]
    faulty.sort(key=lambda pair: -order.index(pair[0]))
    return "\n".join(f"- **{outcome}** {line(record)}" for outcome, record in faulty) or "None."


def line(record: Record) -> str:
    """A case in words: what was hidden, and the answer."""
    hidden = "; ".join(f"{n} {_short(v)}" for n, v in record.expected.hidden.items())
    hidden = hidden or ("outside the catalogue" if record.expected.outside else "nothing")
    if record.answer.statements:
        broken = "; ".join(s.text for s in record.answer.statements if not s.holds)
        hidden = f"does not hold: {broken}" if broken else "all statements hold"
    return f"`{record.key}`{_conditions(record)}: {hidden} -> {in_words(record)}"


def in_words(record: Record) -> str:
    """The answer in words."""
    answer = record.answer
    if answer.error or answer.refusal:
        return f"{answer.word}: {answer.error or answer.refusal}"[:MAX_LENGTH].replace("\n", " ").replace("|", "/")
    named = "; ".join(map(_named, answer.effects)) or "-"
    gain = f"; gain like {', '.join(sorted(answer.gain_names))}" if answer.gain_names else ""
    tests = sorted({leftover["test"] for leftover in answer.report.get("leftover", ())})
    reason = f" [{', '.join(tests)}]" if tests else ""
    return f"{answer.word}: {named}{gain}{reason}"


def _line(title: str, records: Sequence[Record]) -> str:
    counts = Counter(outcome_of(r.answer, r.expected) for r in records)
    required = sum(len(r.expected.required) for r in records)
    absent = sum(len(unnamed(r.answer, r.expected)) for r in records)
    held = [inside for r in records for inside in intervals(r.answer, r.expected)]
    took = [r.took for r in records]
    cells = [
        title, str(len(records)), *(str(counts[outcome]) for outcome in Outcome),
        f"{required - absent} of {required}" if required else "-",
        f"{sum(held)} of {len(held)} ({100 * np.mean(held):.0f} %)" if held else "-",
        f"{np.median(took):.1f}, {max(took):.0f}, {sum(took):.0f}",
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def _named(effect: Mapping[str, Any]) -> str:
    values = ", ".join(
        f"{p['value']:.4g}" + (f" ± {1.96 * p['std']:.1g}" if p["std"] else "") for p in effect["parameters"].values()
    )
    alike = f" or {', '.join(effect['ambiguous_with'])}" if effect["ambiguous_with"] else ""
    rotor = "" if effect["rotor"] is None else f" of rotor {effect['rotor']}"
    return f"{effect['name']}{rotor} {values} ({100 * effect['confidence']:.0f} %){alike}"


def _conditions(record: Record) -> str:
    recorder = record.conditions.get("recorder")
    if recorder:
        log = "estimator" if recorder["pose"] == "estimator" else "commands" if recorder["commands"] else "speeds"
        return f" ({log}, {recorder['rate']:.0f} Hz, shows {record.conditions['strength']:.1f})"
    words = ", ".join(str(value) for value in record.conditions.values())
    return f" ({words})" if words else ""


def _short(values: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.3g}" for value in values.values())
