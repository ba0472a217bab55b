"""Errors that every log has: the standard deviations of nuisances before any flight."""

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
