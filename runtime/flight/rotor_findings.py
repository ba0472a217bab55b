"""Rotors that have lost thrust, as events. Pure."""

from __future__ import annotations

from runtime.control.adaptation import Adaptation
from runtime.flight.events import Event


def rotor_findings(adaptation: Adaptation, motors: tuple[int, ...] | None) -> dict[Event, str]:
    """Rotors that have lost thrust, or have a load under them: both take the same force at the same place away.

    Beyond the limit only where the model's changes are flown.
    motors: for each rotor the index of the autopilot's motor, None where it is not known.
    """
    if adaptation.rotors is None or not (losses := adaptation.rotors.losses):
        return {}
    text = "; ".join(
        f"{_name(loss.rotor, motors)} has lost {100 * loss.share:.0f} +- {196 * loss.deviation:.0f} % of thrust"
        f", or a load of {adaptation.load_of(loss):.2g} kg hangs under it"
        for loss in losses
    )
    present = {Event.ROTOR_WEAK: text}
    return {**present, Event.ROTOR_FAILING: text} if adaptation.rotors.grave and adaptation.flies else present


def _name(rotor: int, motors: tuple[int, ...] | None) -> str:
    """The rotor's number in the vehicle file, and the autopilot's, from 1."""
    return f"rotor {rotor}" if motors is None else f"rotor {rotor} (motor {motors[rotor] + 1})"
