"""Next flight or action for what a diagnosis leaves open: look-alikes, leftovers, hints, what was not excited."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from diagnosis.estimation.refusal import Refused
from diagnosis.report import Leftover, MissingEffect
from dynamics.effect import Effect
from dynamics.references.catalogue import IDENTIFY

OTHERWISE = "more aggressive flight"
NOTHING = "nothing is open; fly again after the next change of the vehicle"
MAX_ADVICE = 3  # pieces of advice: who reads more follows none


def next_flight(
    effects: Sequence[MissingEffect],
    leftover: Sequence[Leftover],
    refused: Sequence[Refused],
    not_excited: Sequence[str],
    catalogue: Mapping[str, Effect],
) -> str:
    """Advice on what is open, the most urgent first.

    effects: named, of which some look alike. leftover: what no effect explains. refused: of which some are hints.
    not_excited: effects that did not show; one of them is named where nothing else is open.
    """
    advice = [_telling_apart([e.name, *e.ambiguous_with], catalogue) for e in effects if e.ambiguous_with]
    advice += dict.fromkeys(_about(one) for one in leftover)
    advice += [f"to confirm {one.name}: {_manoeuvre(catalogue[one.name])}" for one in refused if one.is_hint]
    if not advice and not_excited:
        advice.append(f"to see {not_excited[0]}: {_manoeuvre(catalogue[not_excited[0]])}")
    return ". ".join(advice[:MAX_ADVICE]) or NOTHING


def next_reference(
    effects: Sequence[MissingEffect],
    refused: Sequence[Refused],
    not_excited: Sequence[str],
    catalogue: Mapping[str, Effect],
) -> str:
    """The reference of an identification flight for the effects that are open, empty where none is.

    Look-alikes and hints, else what was not excited; not what no manoeuvre shows.
    """
    names = [name for e in effects if e.ambiguous_with for name in (e.name, *e.ambiguous_with)]
    names += [one.name for one in refused if one.is_hint]
    plannable = [name for name in dict.fromkeys(names or not_excited) if _shows_in_a_manoeuvre(catalogue[name])]
    return f"{IDENTIFY}:for={'+'.join(plannable)}" if plannable else ""


def _shows_in_a_manoeuvre(effect: Effect) -> bool:
    """Whether a planned flight can be better for it: of logs with commands, which show no reading of the rotors."""
    excitation, of_readings = effect.excitation, effect.acts_on in ("rotor_speed_reading", "rotor_clock")
    return not (effect.stochastic or of_readings) and (
        excitation is None or excitation.measure not in ("", "voltage_drop", "low_flight")
    )


def _telling_apart(names: Sequence[str], catalogue: Mapping[str, Effect]) -> str:
    manoeuvres = dict.fromkeys(_manoeuvre(catalogue[name]) for name in names)
    return f"to tell {' from '.join(names)}: {'; '.join(manoeuvres)}"


def _manoeuvre(effect: Effect) -> str:
    return effect.excitation.manoeuvre if effect.excitation is not None else OTHERWISE


def _about(leftover: Leftover) -> str:
    """Advice about what is left."""
    match leftover.test:
        case "spectral_line":
            return (
                f"about the line at {leftover.frequency or 0.0:.2g} Hz: hover for a minute, then the same with "
                "balanced propellers, tightened mounts and nothing hanging below; what stops it is its cause"
            )
        case "position_dependent":
            return "about what repeats at the same places: the same manoeuvre metres away from walls, ground and fans"
        case "predictable_from_state":
            return (
                f"about what the state predicts{_where(leftover)}: fly more of exactly that, and let a network learn "
                "it (`alula train --model grey_box --effect diagnosed`), or give an effect of your own with --effects"
            )
    return (
        f"about what changes with the time of flight{_where(leftover)}: the same manoeuvre with warm motors and a full "
        "battery, then for longer; what stops it is its cause"
    )


def _where(leftover: Leftover) -> str:
    if not leftover.regimes:
        return ""
    cell = leftover.regimes[0]
    return f" at {cell.regime} from {cell.low:.3g} to {cell.high:.3g}"
