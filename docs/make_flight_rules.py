"""Write docs/flight_rules.md from the tables of phases and events.

python docs/make_flight_rules.py            # write the page
python docs/make_flight_rules.py --check    # end with 1 where the page differs from what it would be
"""

from __future__ import annotations

import sys
from math import inf
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).parent / "flight_rules.md"
HEAD = """# The rules of a flight

Made from the tables of the flight logic (`runtime/flight/phases.py` and `runtime/flight/events.py`) by
`python docs/make_flight_rules.py`. [Fly](flight.md) explains what they lead to.
"""
PHASES_HEAD = """
## Phases

Setpoints are made, and the controller tracks, as the row of the present phase says. Where fallbacks are off, thrust
goes away on the ground, and nothing is safer than to disarm. Where the ground is expected, a contact is a landing and
no crash.

| phase | what it does | setpoints | tracks | fallbacks | ground expected | may disarm |
| --- | --- | --- | --- | --- | --- | --- |
"""
NEXT_HEAD = """
## Which phase is next

A cell is the phase that follows. With conditions the first one that holds counts. "goes on": the phase stays on
purpose. An empty cell: the cause has no meaning in that phase, which stays.

"""
EVENTS_HEAD = """
## Events

The fallback is the mildest that may be flown while the event is active. "stays" in the column of clearing: until
control is taken again. Present for less than the onset, an event is not raised.

| event | text | severity | fallback | onset, s | clears after, s | consequences |
| --- | --- | --- | --- | --- | --- | --- |
"""


def page() -> str:
    """The text of the page."""
    sys.path.insert(0, str(ROOT))
    from runtime.flight.events import POLICIES, Policy
    from runtime.flight.phases import PHASES, Phase, PhasePolicy, Target, Trigger

    def row(phase: Phase, policy: PhasePolicy) -> str:
        marks = " | ".join("yes" if on else "" for on in (policy.falls_back, policy.lands, policy.may_disarm))
        return f"| `{phase.value}` | {policy.text} | {policy.handler.value} | {policy.path.value} | {marks} |\n"

    def cell(on: dict[Trigger, Target], trigger: Trigger) -> str:
        if trigger not in on:
            return ""
        target = on[trigger]
        if target is None:
            return "goes on"
        if isinstance(target, Phase):
            return f"`{target.value}`"
        return "; ".join(f"{condition.value}: `{phase.value}`" for condition, phase in target.items())

    def next_phases() -> str:
        lines = [f"| phase | {' | '.join(trigger.value for trigger in Trigger)} |\n"]
        lines.append(f"|{' --- |' * (len(Trigger) + 1)}\n")
        for phase, policy in PHASES.items():
            cells = " | ".join(cell(dict(policy.on), trigger) for trigger in Trigger)
            lines.append(f"| `{phase.value}` | {cells} |\n")
        return "".join(lines)

    def consequences(policy: Policy) -> str:
        texts = {
            "refuses engaging": policy.refuses,
            "lands": policy.lands,
            "straight down": policy.sinks,
            "probes the ground": policy.probes,
        }
        return ", ".join(text for text, holds in texts.items() if holds)

    def event_row(name: str, policy: Policy) -> str:
        clears = "stays" if policy.clear_after == inf else f"{policy.clear_after:g}"
        levels = f"{policy.severity.name.lower()} | {policy.fallback.name.lower().replace('_', ' ')}"
        return f"| `{name}` | {policy.text} | {levels} | {policy.onset:g} | {clears} | {consequences(policy)} |\n"

    events = "".join(event_row(event.value, policy) for event, policy in POLICIES.items())
    phases = "".join(row(phase, policy) for phase, policy in PHASES.items())
    return HEAD + PHASES_HEAD + phases + NEXT_HEAD + next_phases() + EVENTS_HEAD + events


def main() -> int:
    """Write or check the page. Returns the exit code."""
    text = page()
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(text, encoding="utf-8")
        return 0
    if PAGE.exists() and PAGE.read_text(encoding="utf-8") == text:
        return 0
    print(f"{PAGE} is not what the tables say; run: python docs/make_flight_rules.py", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
