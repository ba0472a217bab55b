"""Slow turbulence: the second time scale of disturbance force and torque, beside `turbulence`."""

from dataclasses import replace

from diagnosis.noise.component import LogNormal
from diagnosis.noise.components import turbulence

COMPONENT = replace(
    turbulence.COMPONENT,
    name="slow_turbulence",
    summary="Force and torque that last for seconds: the room's own air",
    parameters=(  # bounds that meet those of `turbulence` and leave no place to exchange the two
        *turbulence.LEVELS,
        *turbulence.times(LogNormal(1.0, 0.8), LogNormal(0.6, 0.8), 0.3, 30.0),
    ),
)
