"""Errors that every log has: the standard deviations of nuisances before any flight."""

from diagnosis.noise.component import LogNormal
from dynamics.effects import gyro_bias, imu_bias, time_delay

GYRO = gyro_bias.SENSOR_PRIOR  # rad/s
ACCELEROMETER = imu_bias.SENSOR_PRIOR  # m/s^2
ACCELEROMETER_OF_AUTOPILOT = 0.1  # m/s^2: flown as it is, its estimator finds the bias
CLOCK = time_delay.SENSOR_PRIOR  # s, of the pose, and of measured rotor speeds
HOLD = 0.29  # periods of a log, of measured rotor speeds: uniform, as they may be held before or behind their rows
FILTER_DELAY = 0.004  # s, of a gyro that an autopilot low-passes: its estimator's velocity and attitude are not
ATTITUDE_CLOCK = 0.002  # s, of the attitude beyond the velocity
LEVEL = 0.002  # rad, of the pose's axes on the body
LEVEL_OF_ESTIMATOR = 0.01  # rad
DISCREPANCY = 0.01  # of a channel's own explained motion, in each block of time anew
SIZES = (0.03, 0.1, 0.3, 1.0)  # of the model's own motion, that a force or torque which no effect is may have
FUNCTIONS = {  # what that may be a function of: fineness of one over the quantities' deviations, and how many
    "state": (0.35, 12),
    "velocity": (1.5, 16),
    "place": (3.0, 20),
    "time": (1.0, 8),
}
GUST = LogNormal(0.5, 1.2)  # m/s: from a draught to a storm
SLOW = LogNormal(0.7, 0.55)  # of still air's slow force sideways, over the fast one: in 30 sets of flights
DRIFT = LogNormal(0.1, 0.7)  # m/s: velocity that an estimator lets drift for seconds
UNFITTED = LogNormal(0.3, 1.0)  # share of a function that is left beyond what is found of it
