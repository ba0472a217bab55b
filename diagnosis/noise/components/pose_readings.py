"""White noise of each reading of velocity and attitude, whatever they come from."""

from diagnosis.noise.component import Hyperparameter, fixed_prior
from diagnosis.noise.components import motion_capture

# A row's mean of a turning body's readings is no finer than this, whatever the sensor: kinematics over a row.
FINEST = 3e-4, 3e-4  # m/s, rad

COMPONENT = motion_capture.component(
    "pose_readings",
    "White noise of velocity and attitude as they were logged",
    (
        Hyperparameter("velocity", "m/s", "standard deviation of a reading", FINEST[0], 1.0, fixed_prior(5e-3, 1.5)),
        Hyperparameter("attitude", "rad", "standard deviation of a reading", FINEST[1], 0.2, fixed_prior(1e-3, 1.2)),
    ),
)
