"""Write docs/catalogue.md and a page for every effect, from the effects themselves.

python docs/make_catalogue.py            # write the pages
python docs/make_catalogue.py --check    # end with 1 where a page differs from what it would be
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = Path(__file__).parent
FOLDER = "catalogue"
VEHICLES = ("arpl_250g", "crazyflie", "px4_sih")
HEAD = """# The catalogue of effects

Made from the effects' own modules (`dynamics/effects`) by `python docs/make_catalogue.py`; `alula effects NAME
--vehicle V.toml` prints the same for your vehicle. [effects.md](effects.md) explains those whose meaning is not
evident, and what real flights said of them.

| effect | what it is | shows well from | looks like |
| --- | --- | --- | --- |
"""
FOOT = """[All effects](../catalogue.md). Usual values are what is expected of a vehicle before any flight, +- their
standard deviation. `alula effects {name} --vehicle V.toml` prints this for your vehicle."""


def pages() -> dict[Path, str]:
    """The text of every page."""
    sys.path.insert(0, str(ROOT))
    from dynamics.effect_card import EffectCard, effect_cards
    from dynamics.vehicle_file import find_vehicle, read_vehicle

    def section(place: int, card: EffectCard) -> str:
        lines = [f"# {card.effect.name}", f"{card.effect.summary}{', of one rotor' * card.effect.per_rotor}."]
        lines.append("\n".join(f"    {line}" for line in card.formula))
        lines.append(_parameters([cards[place] for cards in of_vehicles]))
        facts = {
            "Needs in the log": "; ".join(" or ".join(f"`{name}`" for name in group) for group in card.needs),
            "Shows well from": card.shows_from,
            "Fly": card.fly,
            "To separate it": card.separate,
            "Looks like": ", ".join(f"[{name}]({name}.md)" for name in card.confounded_with),
            "Source": card.effect.source,
        }
        lines.append("\n".join(f"- {heading}: {text}" for heading, text in facts.items() if text))
        return "\n\n".join([*lines, FOOT.format(name=card.effect.name)]) + "\n"

    def row(card: EffectCard) -> str:
        alike = ", ".join(f"[{name}]({FOLDER}/{name}.md)" for name in card.confounded_with)
        linked = f"[{card.effect.name}]({FOLDER}/{card.effect.name}.md)"
        return f"| {linked} | {card.effect.summary} | {card.shows_from} | {alike} |\n"

    def _parameters(cards: list[EffectCard]) -> str:
        rows = [f"| parameter | unit | meaning | bounds | none at | usual: {' | '.join(VEHICLES)} |"]
        rows.append("| --- " * (5 + len(VEHICLES)) + "|")
        for first in cards[0].effect.parameters:
            priors = [prior for card in cards if (prior := card.usual(first)) is not None]
            usual = " | ".join(f"{prior.mean:.3g} +- {prior.std:.2g}" for prior in priors)
            bounds = f"{first.lower:g} to {first.upper:g}"
            rows.append(f"| `{first.name}` | {first.unit} | {first.meaning} | {bounds} | {first.neutral:g} | {usual} |")
        return "\n".join(rows)

    of_vehicles = [effect_cards(read_vehicle(find_vehicle(name))) for name in VEHICLES]
    cards = of_vehicles[0]
    made = {DOCS / FOLDER / f"{card.effect.name}.md": section(place, card) for place, card in enumerate(cards)}
    return {DOCS / f"{FOLDER}.md": HEAD + "".join(map(row, cards)), **made}


def main() -> int:
    """Write or check the pages. Returns the exit code."""
    made, there = pages(), set((DOCS / FOLDER).glob("*.md"))
    if "--check" not in sys.argv[1:]:
        (DOCS / FOLDER).mkdir(exist_ok=True)
        for path in there - set(made):
            path.unlink()
        for path, text in made.items():
            path.write_text(text, encoding="utf-8")
        return 0
    stale = [path for path, text in made.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    for path in sorted({*stale, *(there - set(made))}):
        print(f"{path} is not what the effects say; run: python docs/make_catalogue.py", file=sys.stderr)
    return 1 if stale or there - set(made) else 0


if __name__ == "__main__":
    sys.exit(main())
