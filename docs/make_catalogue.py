"""Write docs/catalogue.md: a section for every effect, from the effects themselves.

python docs/make_catalogue.py            # write the page
python docs/make_catalogue.py --check    # end with 1 where the page differs from what it would be
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).with_name("catalogue.md")
VEHICLES = ("arpl_250g", "crazyflie", "px4_sih")
HEAD = """# The catalogue of effects

Made from the effects' own modules (`dynamics/effects`) by `python docs/make_catalogue.py`; `alula effects NAME
--vehicle V.toml` prints the same for your vehicle. [effects.md](effects.md) explains those whose meaning is not
evident, and what real flights said of them. Usual values are what is expected of a vehicle before any flight, +- their
standard deviation."""


def page() -> str:
    """The whole page."""
    sys.path.insert(0, str(ROOT))
    from dynamics.effect_card import EffectCard, effect_cards
    from dynamics.vehicle_file import find_vehicle, read_vehicle

    def section(place: int, card: EffectCard) -> str:
        lines = [f"## {card.effect.name}", f"{card.effect.summary}{', of one rotor' * card.effect.per_rotor}."]
        lines.append("\n".join(f"    {line}" for line in card.formula))
        lines.append(_parameters([cards[place] for cards in of_vehicles]))
        facts = {
            "Needs in the log": "; ".join(" or ".join(f"`{name}`" for name in group) for group in card.needs),
            "Shows well from": card.shows_from,
            "Fly": card.fly,
            "To separate it": card.separate,
            "Looks like": ", ".join(f"[{name}](#{name})" for name in card.confounded_with),
            "Source": card.effect.source,
        }
        lines.append("\n".join(f"- {heading}: {text}" for heading, text in facts.items() if text))
        return "\n\n".join(lines)

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
    sections = [section(place, card) for place, card in enumerate(of_vehicles[0])]
    return "\n\n".join([HEAD, *sections]) + "\n"


def main() -> int:
    """Write or check the page. Returns the exit code."""
    text = page()
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(text, encoding="utf-8")
        return 0
    if PAGE.exists() and PAGE.read_text(encoding="utf-8") == text:
        return 0
    print(f"{PAGE} is not what the effects say; run: python docs/make_catalogue.py", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
