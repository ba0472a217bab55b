"""The manoeuvre that would show an effect, or distinguish two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dynamics.effect import Effect

OTHERWISE = "more aggressive flight"


def next_flight(ambiguous: Sequence[str], not_excited: Sequence[str], catalogue: Mapping[str, Effect]) -> str:
    """What to fly next. ambiguous: effects that cannot be distinguished; not_excited: effects that did not show."""
    if len(ambiguous) > 1:
        manoeuvres = "; ".join(dict.fromkeys(_manoeuvre(catalogue[name]) for name in ambiguous))
        return f"to tell {' from '.join(ambiguous)}: {manoeuvres}"
    if not_excited:
        return f"to see {not_excited[0]}: {_manoeuvre(catalogue[not_excited[0]])}"
    return "nothing is open; fly again after the next change of the vehicle"


def _manoeuvre(effect: Effect) -> str:
    return effect.excitation.manoeuvre if effect.excitation is not None else OTHERWISE
