"""The catalogue: components of noise that ship with Alula, one module each."""

from collections.abc import Mapping

from diagnosis.noise.component import Component
from diagnosis.noise.components import (
    accelerometer,
    dryden_gust,
    filtered_pose,
    gyro,
    held_commands,
    integrating_estimator,
    linear_commands,
    motion_capture,
    pose_readings,
    rotor_motion,
    rotor_turbulence,
    slow_turbulence,
    smooth_estimator,
    turbulence,
)

CATALOGUE: Mapping[str, Component] = {
    module.COMPONENT.name: module.COMPONENT
    for module in (
        turbulence,
        slow_turbulence,
        rotor_turbulence,
        rotor_motion,
        gyro,
        accelerometer,
        motion_capture,
        pose_readings,
        filtered_pose,
        integrating_estimator,
        smooth_estimator,
        dryden_gust,
        held_commands,
        linear_commands,
    )
}
