"""Time delay: position, velocity and attitude are older than their stamps."""

from collections.abc import Sequence
from dataclasses import replace

from dynamics.effect import Effect, Parameter, Prior, Reading, Span, Values
from dynamics.excitation import QUICK_TURNS, Excitation
from dynamics.vehicle import Vehicle

SENSOR_PRIOR = 0.001  # s, of healthy clocks


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The pose is older than its stamp by delay."""
    return replace(reading, pose_age=reading.pose_age + p["delay"])


def grid(_: Vehicle, __: Span) -> Sequence[dict[str, float]]:
    """Delays from 5 to 60 ms."""
    return [{"delay": delay} for delay in (0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06)]


EFFECT = Effect(
    name="time_delay",
    summary="Pose and velocity arrive late against gyro, accelerometer and rotors",
    source="Rehder et al., A general approach to spatiotemporal calibration in multisensor systems, T-RO 2016",
    parameters=(Parameter("delay", "s", "age of the pose at its stamp", -0.2, 0.5, lambda _: Prior(0.02, 0.02)),),
    measurement=measurement,
    grid=grid,
    min_detectable=0.003,  # s; smaller ones are within the clocks' errors
    sensor_prior=SENSOR_PRIOR,
    excitation=Excitation(
        (("rate",), ("attitude",)),
        measure="tilting_rate",
        weak=0.2,
        enough=0.6,
        flight=QUICK_TURNS,
        manoeuvre="quick alternating rolls and pitches",
    ),
)
