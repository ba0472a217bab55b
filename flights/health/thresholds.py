"""Limits that healthy logs keep, each with its source.

[study]: calibrated on mock flights and real logs that the study's page does not report on
(benchmarks/results/flight_health.md). All others are documented by PX4 or ArduPilot.
"""

from __future__ import annotations

from typing import NamedTuple


class Limit(NamedTuple):
    """A value beyond which healthy logs do not go. warning, fault: the levels of statement."""

    warning: float
    fault: float


# Rotors in hover: a command over the mean of all, less 1 [study]
IMBALANCE = Limit(0.13, 0.25)
STEP_OF_BALANCE = 0.08  # the same within one flight: a rotor that changed [study]
SINGLE_ROTOR = 0.6  # share of a lone rotor's pattern that the yaw pattern must show, 1 for a broken propeller [study]

# Actuators: share of the range; PX4's and ArduPilot's mixers give up yaw, then attitude, at its end
NEAR_LIMIT = 0.98
AT_LIMIT = Limit(0.10, 0.25)  # share of the time in the air with a rotor at its upper limit [study]
HOVER_SHARE = Limit(0.80, 0.90)  # of the range in hover; PX4 allows MPC_THR_HOVER up to 0.8

# Power, V a cell under load: PX4's BAT_V_EMPTY 3.6 (3.5 before 1.12), and where cells are damaged; where the log does
# not state how many cells there are, the second alone: healthy single cells go below the first
CELL = Limit(3.5, 3.2)
SAG = Limit(0.20, 0.30)  # of the voltage at rest, within 3 s of the load; healthy Crazyflies reach 0.19 [study]
PLAUSIBLE_CELL = 2.0  # V; less is no battery that a vehicle flies with

# Rate loops: amplitude of a narrow line above 2 Hz, rad/s [study]
OSCILLATION = Limit(0.7, 1.4)
LINE_SHARE = 0.35  # of the power above 2 Hz within 15 % of the line's frequency [study]

# High-frequency acceleration, m/s^2: PX4's vehicle_imu_status.accel_vibration_metric, as Flight Review colours it (half
# and one g); ArduPilot's VIBE, by its documentation on measuring vibration
VIBRATION = Limit(4.905, 9.81)
VIBE = Limit(30.0, 60.0)
CLIPPED = Limit(10.0, 100.0)  # samples in a flight; ArduPilot: 100 is a problem

# Estimator: innovations over their gates (rejected above 1, by definition), and resets in the air, m and m/s
TEST_RATIO = 1.0
REJECTED_FOR = Limit(0.5, 2.0)  # s
JUMP = Limit(1.0, 5.0)  # m of position; COM_POS_FS_EPH is 5
SWITCHES = Limit(1.0, 3.0)  # of the estimator's instance in the air
SWITCH_WINDOW = 5.0  # s
GPS_ACCURACY = 5.0  # m: PX4's COM_POS_FS_EPH

# Control: angle between attitude and setpoint, rad; FD_FAIL_R and _P are 60 degrees
ATTITUDE_ERROR = 0.7  # for ATTITUDE_ERROR_FOR [study]
ATTITUDE_ERROR_FOR = 0.25  # s
UPSET = 1.05  # rad of tilt that no setpoint asks for
IMPACT_FORCE = 35.0  # m/s^2 of specific force in the air [study]
IMPACT_RATE = 6.0  # rad/s of change within IMPACT_WINDOW that no setpoint asks for [study]
IMPACT_WINDOW = 0.12  # s
LEANING = (
    5.0  # m/s^2 across the body for LEANING_FOR: in flight only drag is there, at rest half of gravity at 30 degrees
)
LEANING_FOR = 1.0  # s
