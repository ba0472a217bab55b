"""Scale error of the accelerometer: a wrong range or unit, the same on all axes."""

from dataclasses import replace

from dynamics.effect import Effect, Parameter, Prior, Reading, Values
from dynamics.excitation import POSE, Excitation


def measurement(reading: Reading, p: Values, _: int | None) -> Reading:
    """The measured specific force is ratio times the true one, along all axes."""
    return replace(reading, specific_force=p["ratio"] * reading.specific_force)


EFFECT = Effect(
    name="imu_scale",
    summary="Wrong scale of the accelerometer",
    source="Titterton and Weston, Strapdown Inertial Navigation Technology, 2004, eq. 12.1 (scale factor error)",
    parameters=(
        Parameter("ratio", "1", "measured over true specific force", 0.4, 2.5, lambda _: Prior(1.0, 0.03), neutral=1.0),
    ),
    measurement=measurement,
    confounded_with=("imu_bias",),
    excitation=Excitation(
        (("specific_force",), *POSE),
        measure="acceleration",
        weak=0.5,
        enough=2.0,
        flight="fast climbs and quick accelerations: bob, line",
        manoeuvre="six poses at rest, each axis up and down",
    ),
)
