"""Thrust over command, as the joint fit has it."""

from __future__ import annotations

import math

from diagnosis.estimation.fitted import Fit, ParameterEstimate
from diagnosis.models.command_effects import GAIN
from dynamics.effects.mass import EFFECT as MASS

GAIN_KEY = (GAIN.name, GAIN.parameters[0].name)
MASS_KEY = (MASS.name, MASS.parameters[0].name)


def command_gain(fitted: Fit, mass: float) -> ParameterEstimate | None:
    """Ratio on the first estimate of the gain, None where rotor speeds were measured.

    In the fit the gain is that of thrust over weight, so that the thrust grows with the mass.
    mass: ratio to the vehicle file's body with which the first estimate was made.
    """
    gain = fitted.commands.get(GAIN_KEY)
    if gain is None:
        return None
    ratio = next((use.parameters[MASS_KEY[1]] for use in fitted.vehicle.effects if use.name == MASS.name), 1.0)
    payload = fitted.estimates.get(MASS_KEY)
    relative = math.hypot(gain.std / gain.value, 0.0 if payload is None else payload.std / payload.value)
    value = gain.value * ratio / mass
    return ParameterEstimate(value, relative * value, gain.unit)
