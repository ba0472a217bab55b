"""Attitude delay: the attitude is older than its stamp while position and velocity are not."""

from collections.abc import Sequence
from dataclasses import replace

from dynamics.effect import Effect, Parameter, Prior, Reading, Span, Values
from dynamics.excitation import QUICK_TURNS, Excitation
from dynamics.vehicle import Vehicle


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The attitude is older than position and velocity by delay."""
    return replace(reading, attitude_age=reading.attitude_age + p["delay"])


def grid(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """Delays of which the nearer is within a factor of two of any from 5 to 60 ms."""
    return [{"delay": delay} for delay in (0.01, 0.03)]


EFFECT = Effect(
    name="attitude_delay",
    summary="Attitude arrives late against gyro, position and velocity",
    source="Rehder et al., A general approach to spatiotemporal calibration in multisensor systems, T-RO 2016",
    parameters=(
        Parameter("delay", "s", "age of the attitude beyond the position's", -0.2, 0.5, lambda _: Prior(0.01, 0.02)),
    ),
    measurement=measurement,
    grid=grid,
    min_detectable=0.003,  # s; smaller ones are within the clocks' errors
    confounded_with=("time_delay",),
    excitation=Excitation(
        (("rate",), ("attitude",), ("velocity",)),
        measure="tilting_rate",
        weak=0.2,
        enough=0.6,
        flight=QUICK_TURNS,
        manoeuvre="quick alternating rolls and pitches, then straight accelerations without tilting further",
    ),
)
