"""Rotor-speed fault: one rotor's measured speed is wrong while the rotor itself is healthy."""

from dataclasses import replace

from dynamics import symbolic as ca
from dynamics.effect import Effect, Parameter, Prior, Reading, Values
from dynamics.excitation import COMMAND, Excitation


def measurement(reading: Reading, p: Values, rotor: int | None) -> Reading:
    """The measured speed of one rotor is gain times the true one."""
    factor = ca.SX.ones(reading.rotor_speed.shape[0])
    factor[rotor or 0] = p["gain"]
    return replace(reading, rotor_speed=reading.rotor_speed * factor)


EFFECT = Effect(
    name="rotor_speed_fault",
    summary="One rotor's speed sensor reads wrong",
    source="multiplicative sensor fault, Isermann, Fault-Diagnosis Systems, 2006, ch. 5",
    parameters=(
        Parameter("gain", "1", "measured speed over the true one", 0.0, 3.0, lambda _: Prior(0.9, 0.2), neutral=1.0),
    ),
    measurement=measurement,
    per_rotor=True,
    acts_on="rotor_speed_reading",
    confounded_with=("weak_rotor",),
    excitation=Excitation(
        (("rotor_speed",), ("rate", *COMMAND)),
        measure="duration",
        weak=5.0,
        enough=15.0,
        flight="hover",
        manoeuvre="thrust steps in hover, then the same with this rotor's propeller exchanged for another rotor's",
    ),
)
