"""Scale error of the gyro: a wrong range or unit, the same on all axes."""

from dataclasses import replace

from dynamics.effect import Effect, Parameter, Prior, Reading, Values
from dynamics.excitation import Excitation


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The measured body rate is ratio times the true one, about all axes."""
    return replace(reading, rate_body=p["ratio"] * reading.rate_body)


EFFECT = Effect(
    name="gyro_scale",
    summary="Wrong scale of the gyro",
    source="Titterton and Weston, Strapdown Inertial Navigation Technology, 2004, eq. 12.2 (scale factor error)",
    parameters=(Parameter("ratio", "1", "measured over true rate", 0.4, 2.5, lambda _: Prior(1.0, 0.03), neutral=1.0),),
    measurement=measurement,
    excitation=Excitation(
        (("rate",), ("attitude",)),
        measure="tilting_rate",
        weak=0.2,
        enough=0.6,
        flight="rolls, pitches and turns of the nose: Lemniscate",
        manoeuvre="slow turns by a known angle about each axis",
    ),
)
