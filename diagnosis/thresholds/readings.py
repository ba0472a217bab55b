"""Thresholds of what is read: filters, segments, noise, and the checks of the data."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from diagnosis.thresholds.group import (
    Correlation,
    Count,
    Factor,
    Percent,
    Positive,
    Range,
    Score,
    Share,
    ThresholdGroup,
)


class FilterThresholds(ThresholdGroup, frozen=True):
    """Filters of residuals, on both sides of the equation. Applied when flights are read.

    cutoff: of the low-pass on both sides, Hz. [margins: half]
    slow_cutoff: below which motion is not the controller's response to turbulence, Hz. [margins: double]
    rate: of the rows after decimation, Hz. [three times the cutoff]
    edge: that the filters spoil at both ends of a segment, s. [formula: the low-pass has fallen to 0.3 % of its peak]
    """

    cutoff: Positive = 8.0
    slow_cutoff: Positive = 1.5
    rate: Positive = 25.0
    edge: Positive = 0.3

    def __post_init__(self) -> None:
        """Check that decimation does not alias what the filters pass."""
        if not self.slow_cutoff < self.cutoff < self.rate / 2:
            raise ValueError(
                f"slow_cutoff {self.slow_cutoff:g} must be below cutoff {self.cutoff:g}, and that below half the rate "
                f"{self.rate / 2:g} Hz"
            )


class SegmentThresholds(ThresholdGroup, frozen=True):
    """Which rows of a flight are used. Applied when flights are read.

    max_rate: of a log that is not thinned out first, Hz. [margins: neither]
    resampled_rate: to which a faster log is thinned out, Hz. [margins: neither]
    min_rate_share: of the slowest usable rate at which a stream still counts; clocks are not exact. [margins: neither]
    min_duration: of a segment, s. [margins: neither]
    margin: left out around ground and contact, s. [margins: neither]
    max_specific_force: beyond it is a crash or a landing, m/s^2. [margins: neither]
    full_cell: voltage of a full battery cell, V. [definition: lithium polymer]
    cell_slack: by which a cell may be above that, V. [margins: neither]
    full_quantile: of the voltage, that is taken for the highest one. [convention]
    min_voltage: of a battery that is measured at all, V. [margins: neither]
    min_cell: voltage of a cell in flight below which it is no measurement, V. [definition: lithium polymer; 2.5 V occur
    under load]
    voltage_cutoff: of the low-pass on the voltage, Hz; it falls with every manoeuvre, its noise does not. [margins:
    neither]
    """

    max_rate: Positive = 500.0
    resampled_rate: Positive = 250.0
    min_rate_share: Share = 0.95
    min_duration: Positive = 3.0
    margin: Score = 0.5
    max_specific_force: Positive = 60.0
    full_cell: Positive = 4.2
    cell_slack: Score = 0.2
    full_quantile: Share = 0.99
    min_voltage: Score = 2.5
    min_cell: Score = 2.0
    voltage_cutoff: Positive = 4.0


class DatasetThresholds(ThresholdGroup, frozen=True):
    """Division into fitted and held-out flights. Applied when flights are read.

    held_out_share: of the flights, or of the one flight's time. [convention]
    min_groups: of fitted rows, which leaving one out needs; fewer flights are cut into parts. [margins: neither]
    min_part: duration of such a part, s. [margins: neither]
    min_group: of a single flight's parts that are left out together, s. [margins: neither]
    block: that is held out where whole flights are not, s. [margins: neither]
    boundary: share of the flights' extent over which a place is close to the side of their box. [margins: neither]
    min_excitation: motion of held-out flights, RMS over that of the others, below which they do not judge. [margins:
    neither]
    """

    held_out_share: Annotated[float, Meta(gt=0, lt=1)] = 0.2
    min_groups: Annotated[int, Meta(ge=2)] = 4
    min_part: Positive = 6.0
    min_group: Positive = 15.0
    block: Positive = 5.0
    boundary: Share = 0.15
    min_excitation: Share = 0.25


class CommandCurveThresholds(ThresholdGroup, frozen=True):
    """Thrust over command, where no rotor speed was measured. Applied when flights are read.

    gain: range of thrust over the vehicle file's. [results/real_flights.md: 0.63 to 1.7 occur]
    max_lag: of the rotors behind commands that is tried, s. [margins: neither]
    lag_step: between the lags that are tried, s. [margins: neither]
    noise: specific force of other effects, m/s^2. [margins: neither]
    independent_share: of rows that count as independent observations. [margins: neither]
    term_std: prior standard deviations of constant, linear and quadratic term. [margins: neither]
    air_std: prior standard deviation of the drag along body z, 1/s. [margins: neither]
    lift_std: the same of the lift of travelling, 1/m. [margins: neither]
    max_curved_ratio: of the variance that a curve leaves over that which a straight line leaves, above which the line
        is taken. [margins: neither]
    max_motor_difference: of a healthy vehicle's motor from the mean. [decisions: the command's gain; 0.1 occurs]
    command_percentiles: range of commands within which the curve is not straight. [margins: neither]
    gain_std: prior standard deviation of thrust over weight that all flights share, about the first estimate, which
        counts lift of travelling as thrust. [margins: neither]
    flight_gain_std: of a flight's own gain about it; the battery changes it. [margins: neither]
    motor_std: of a motor's gain about the first estimate. [margins: neither]
    flight_motor_std: of a motor's gain in a flight about what all flights share. [results/px4_blind.md: 0.03 to 0.1
        give the same damping]
    bend_std: of the curve's bend at hover. [margins: neither]
    min_gain_change: of the gain from 1, from which on a wrong mass or thrust constant may be behind it.
        [results/verdicts.md: 1.2 % at most in four sets that hide nothing]
    gain_deviations: standard deviations that this change has at least. [margins: neither]
    """

    gain: Range = (0.55, 1.8)
    max_lag: Positive = 0.15
    lag_step: Positive = 0.01
    noise: Positive = 0.3
    independent_share: Annotated[float, Meta(gt=0, le=1)] = 0.1
    term_std: tuple[Positive, Positive, Positive] = (0.3, 1.0, 0.3)
    air_std: Positive = 1.0
    lift_std: Positive = 0.02
    max_curved_ratio: Share = 0.8
    max_motor_difference: Share = 0.25
    command_percentiles: tuple[Percent, Percent] = (0.5, 99.5)
    gain_std: Positive = 0.05
    flight_gain_std: Positive = 0.03
    motor_std: Positive = 0.03
    flight_motor_std: Positive = 0.03
    bend_std: Positive = 0.05
    min_gain_change: Share = 0.03
    gain_deviations: Positive = 3.0


class DataChecks(ThresholdGroup, frozen=True):
    """Conditions on flights and vehicle file before anything is diagnosed.

    min_duration: of all flights together, s. [margins: neither]
    min_speed: horizontal, RMS, m/s; less with little rotation is hover. [margins: neither]
    min_rate: body rate, RMS, rad/s; less with little speed is hover. [margins: half]
    min_thrust_change: standard deviation where there is no velocity, m/s^2. [margins: neither]
    thrust_ratio: range of modelled over measured thrust. [margins: both]
    tilt_ratio: range of the pose's horizontal acceleration over that which the tilt gives. [margins: neither]
    min_tilt_acceleration: RMS of the latter that the ratio needs, m/s^2. [margins: neither]
    min_rotor_speed: share of hover speed below which a sensor is dead. [margins: neither]
    unit_slack: factor by which a ratio may miss that of two units and still be called it. [margins: neither]
    velocity_span: over which velocity and the change of position are compared, s. [margins: neither]
    max_velocity_error: by which they may differ, m/s. [results/mutated_flights.md]
    max_estimator_error: the same of an estimator's pose, which corrects both separately. [results/verdicts.md: 153
    flights of 12 s with PX4's errors reach 0.61, half of them 0.37]
    max_velocity_share: the same over the speed. [results/mutated_flights.md]
    max_clipped: share of a gyro's or accelerometer's rows at its greatest value. [results/mutated_flights.md]
    max_rotor_clipped: the same of a rotor's speed or command, which may fly at its limit.
    [results/mutated_flights.md]
    """

    min_duration: Positive = 20.0
    min_speed: Score = 0.25
    min_rate: Score = 0.10
    min_thrust_change: Score = 0.5
    thrust_ratio: Range = (0.6, 1.67)
    tilt_ratio: Range = (0.2, 5.0)
    min_tilt_acceleration: Score = 0.3
    min_rotor_speed: Share = 0.1
    unit_slack: Factor = 2.0
    velocity_span: Positive = 0.2
    max_velocity_error: Score = 0.6
    max_estimator_error: Score = 1.0
    max_velocity_share: Share = 0.3
    max_clipped: Share = 0.03
    max_rotor_clipped: Share = 0.3


class RotorMomentChecks(ThresholdGroup, frozen=True):
    """How well the rotors of the vehicle file must explain how the vehicle turns.

    An agreement is the share of the angular acceleration about roll and pitch that an order of the rotors explains
    beside the air, damping and the centre of mass; an axis that turns the other way counts negatively.

    order_margin: of agreement by which another order must exceed the file's. [benchmarks readers rotor_orders]
    min_explained: agreement of any combination of the rotors, below which a finding says so.
    [benchmarks readers rotor_orders]
    no_relation: the same below which the rotors cannot be this flight's. [benchmarks readers rotor_orders]
    min_share_of_mixture: of that combination's agreement that the file's arms must have. [formula: 0.5 for arms turned
    by 45 degrees]
    opposite_yaw: correlation below which the rotors yaw the vehicle the other way. [benchmarks readers rotor_orders]
    max_opposite_ratio: of measured over modelled yaw acceleration then; above it something else yaws the vehicle
    against its rotors. [formula: constants of torque are known to a factor of two]
    min_outlier: logarithm of the gain of a rotor whose speed is doubted, over the greatest of its peers'. [definition:
    twice what is usual in this flight]
    min_angular_acceleration: standard deviation about x and y that is judged, rad/s^2. [margins: neither]
    min_yaw_acceleration: the same about z, where rotors act less. [margins: neither]
    angular_ratio: range of measured over modelled angular acceleration. [margins: neither]
    max_permuted_rotors: whose orders are all tried. [formula: 720 orders]
    response_times: lags of rotors behind commands that are tried, s. [benchmarks readers rotor_orders]
    max_shift: of the rotors' clock against the gyro's that is tried, s. [margins: neither]
    min_flight: of one flight that is judged on its own, s. [margins: neither]
    min_rows: of a segment that is compared. [formula: three times the unknowns]
    unit_slack: factor by which a ratio may miss that of two units and still be called it. [margins: no case]
    """

    order_margin: Share = 0.15
    min_explained: Share = 0.3
    no_relation: Share = 0.1
    min_share_of_mixture: Share = 0.6
    opposite_yaw: Correlation = -0.25
    max_opposite_ratio: Factor = 3.0
    min_outlier: Factor = 2.0
    min_angular_acceleration: Score = 0.5
    min_yaw_acceleration: Score = 0.2
    angular_ratio: Range = (0.2, 5.0)
    max_permuted_rotors: Count = 6
    response_times: tuple[Score, ...] = (0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.15)
    max_shift: Positive = 1.0
    min_flight: Positive = 8.0
    min_rows: Count = 36
    unit_slack: Factor = 2.0


class RotorHoldThresholds(ThresholdGroup, frozen=True):
    """Whether rotor speeds hold or settle between rows. Applied when flights are read.

    deviations: of the mean's delay from none, below which speeds count as smooth. [convention: five]
    min_gain: twice the log-likelihood by which one delay of rotation and thrust must be likelier to count as a late
        clock. [convention: three deviations]
    slack: deviations by which a share may lie outside of 0 to 1. [convention: three]
    block_rows: of the regression over which residuals may be correlated. [definition: two seconds]
    ridge: of the scaled columns. [convention]
    """

    deviations: Positive = 5.0
    min_gain: Score = 9.0
    slack: Positive = 3.0
    block_rows: Count = 50
    ridge: Share = 1e-6


class PredictionThresholds(ThresholdGroup, frozen=True):
    """Models along flights.

    hidden_rate: at which hidden states without a short time constant are integrated, Hz. [margins: neither]
    max_substeps: integration steps between two rows; hidden states that need more are not predicted. [definition: a
        time constant of 0.5 ms at 40 Hz]
    min_lag_rows: shortest time constant of a grid that is tried, rows. [margins: neither: shorter ones look alike]
    horizons: of open-loop prediction, s. [definition]
    start_interval: between starts of open-loop prediction, s. [margins: neither]
    free_start_durations: of a segment's beginning, from which hidden states that begin in mid-motion are fitted, s:
        step by step, so that a swing of 60 degrees is followed. [results/verdicts.md: slung loads, seeds 500 to 502]
    free_start_rate: at which they are integrated for that, Hz. [the same: as at 50 Hz to 0.5 % of the swing]
    free_start_band: in which a motion is looked for, Hz. [formula: lines of 0.1 to 3 m]
    free_start_noise_band: in which noise is seen, Hz. [definition: above that, below the filters' cutoff]
    free_start_excess: of the power in the first over that in the second, above which something moves there.
        [results/verdicts.md, nothing hidden: 1 in 20 segments is above, none above 3.3]
    free_start_step: by which a state moves at most in a step, standard deviations. [the same slung loads]
    free_start_reach: by which it moves at most in all. [definition: 3 standard deviations]
    free_start_strength: of an effect that is sought, over its usual value. [definition: a tenth to five times]
    free_start_rounding: to which logarithms of parameters are rounded for a start that others are near.
        [decisions: a load may swing when the log starts]
    free_start_steps: from there. [decisions, the same: always as many, so that slopes by differences are smooth]
    free_start_difference: for slopes in the states, standard deviations. [decisions, the same]
    """

    hidden_rate: Positive = 50.0
    max_substeps: Count = 50
    min_lag_rows: Positive = 0.35
    horizons: tuple[Positive, ...] = (0.1, 0.5, 1.0)
    start_interval: Positive = 0.5
    free_start_durations: tuple[Positive, ...] = (2.0, 3.0, 4.0, 6.0, 6.0)
    free_start_rate: Positive = 25.0
    free_start_band: Range = (0.3, 1.5)
    free_start_noise_band: Range = (2.0, 5.0)
    free_start_excess: Positive = 2.5
    free_start_step: Positive = 1.0
    free_start_reach: Positive = 3.0
    free_start_strength: Range = (0.1, 5.0)
    free_start_rounding: Positive = 0.1
    free_start_steps: Count = 3
    free_start_difference: Positive = 0.05


class PoseThresholds(ThresholdGroup, frozen=True):
    """Slow errors of a pose by an estimator that used the accelerometer: a smooth Gauss-Markov process.

    velocity_error: standard deviation, m/s, at most, and where there is no position to compare with.
    [tests/data/px4_sih_flights: 0.14 to 0.23 over 28 flights of PX4 with GNSS]
    velocity_time: correlation time of that, s. [the same: 2.6 to 2.7]
    smooth_time: below which that error does not change, s. [the same]
    sensor_band: over the filters' cutoff, where sensors alone are heard. [margins: neither]
    sensor_share: of the log's rate, at which that band ends at the latest. [formula: central differences see little
    beyond]
    sensor_rows: of a periodogram there. [margins: neither]
    min_coherence: of the velocity's derivative with the accelerometer where no motion reaches, above which the pose of
    a table is an estimator's. [tests/data/px4_sih_flights 0.997; tests/data/nanobench 0.26 to 0.40; simulated motion
    capture 0.13 and less]
    draws: of the error of velocity: the mean of what they make of held-out errors counts, and the most that the state
    predicts of them. [margins: neither]
    """

    velocity_error: Positive = 0.2
    velocity_time: Positive = 2.7
    smooth_time: Positive = 0.3
    sensor_band: Range = (1.25, 3.0)
    sensor_share: Share = 0.3
    sensor_rows: Annotated[int, Meta(ge=64)] = 256
    min_coherence: Share = 0.7
    draws: Count = 4
