"""Rotor delay: the rotors' measured speeds are older than their stamps."""

from collections.abc import Sequence
from dataclasses import replace

from dynamics.effect import Effect, Parameter, Prior, Reading, Span, Values
from dynamics.excitation import DRIVE, QUICK_TURNS, Excitation
from dynamics.vehicle import Vehicle


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The rotors' speeds are older than their stamps by delay."""
    return replace(reading, rotor_age=reading.rotor_age + p["delay"])


def grid(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """Delays of which one is within a factor of two of any from 3 to 80 ms."""
    return [{"delay": delay} for delay in (0.006, 0.017, 0.045)]


EFFECT = Effect(
    name="rotor_delay",
    summary="Rotor speeds arrive late against gyro and accelerometer",
    source="Rehder et al., A general approach to spatiotemporal calibration in multisensor systems, T-RO 2016",
    parameters=(
        Parameter("delay", "s", "age of the rotors' speeds at their stamp", -0.1, 0.2, lambda _: Prior(0.01, 0.01)),
    ),
    measurement=measurement,
    grid=grid,
    min_detectable=0.003,  # s; smaller ones are within the clocks' errors
    acts_on="rotor_clock",
    confounded_with=("axial_inflow",),
    excitation=Excitation(
        (("rate", "specific_force"), DRIVE),
        measure="tilting_acceleration",
        weak=2.0,
        enough=8.0,
        flight=QUICK_TURNS,
        manoeuvre="quick steps in thrust and body rates",
    ),
)
