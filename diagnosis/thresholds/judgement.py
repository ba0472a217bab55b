"""Thresholds of judgement: the verdict and the answers of other commands."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from diagnosis.thresholds.group import Count, Factor, Positive, Score, Share, Shares, ThresholdGroup


class VerdictThresholds(ThresholdGroup, frozen=True):
    """How a gain of commands is reported.

    resamples: of flights, for the confidence. [margins: neither]
    """

    resamples: Count = 40


class CompletionThresholds(ThresholdGroup, frozen=True):
    """When the rounds of completion end.

    max_rounds: of diagnosis. [margins: neither]
    min_share: of what the first round took off the held-out reduced chi-square, for a further round. [margins: neither]
    """

    max_rounds: Count = 3
    min_share: Share = 0.01


class RegimeThresholds(ThresholdGroup, frozen=True):
    """Maps of where a model fails.

    bins: along a quantity. [margins: neither]
    quantiles: of a quantity between which the bins lie. [margins: neither]
    min_rows: of a cell that counts as flown. [definition: one second at 25 Hz]
    min_failing: RMS over floor of a cell that is named. [margins: neither]
    min_failing_share: the same over the median cell. [margins: neither]
    min_speed: below which motion has no direction, m/s. [margins: neither]
    worst_window: duration of the worst window that is named, s. [definition]
    leftover_cells: windows and cells that are named of what a test found. [definition]
    """

    bins: Annotated[int, Meta(ge=2)] = 6
    quantiles: Shares = (0.005, 0.995)
    min_rows: Count = 25
    min_failing: Factor = 1.5
    min_failing_share: Factor = 1.2
    min_speed: Score = 0.3
    worst_window: Positive = 2.0
    leftover_cells: Count = 3


class InFlightThresholds(ThresholdGroup, frozen=True):
    """Parameters that a model followed in flight, beside the diagnosis of the flight.

    max_unshown: standard deviation at the end of tracking over that before the flight, up to which the flight showed a
    parameter. [definition: half of its prior]
    interval: half of a 95 % interval, over the standard deviation. [convention]
    changed: deviations by which a parameter that the flight shows moves in it, above which it changed. [definition]
    """

    max_unshown: Share = 0.5
    interval: Positive = 1.96
    changed: Positive = 5.0


class HoverTrimThresholds(ThresholdGroup, frozen=True):
    """Rotors' shares of the load in hover, compared with normal flights.

    min_hover: of a flight, s. [margins: double]
    min_segment: of hover that counts, s. [margins: neither]
    min_rotor_rate: of the logged commands, Hz; means need no more. [margins: neither]
    max_speed: of hover, m/s. [margins: neither]
    max_rate: of hover, rad/s. [margins: no case]
    cutoff: below which speed and rate count as motion, Hz. [margins: neither]
    prior_spread: of a rotor's share between normal flights. [decisions: normal flights]
    prior_freedom: degrees of freedom of the prior. [decisions: normal flights]
    false_alarms: of normal flights, over all rotors. [convention: 5 %]
    min_spreads: above the normal flight in which the rotor worked hardest. [decisions: normal flights]
    enough_flights: normal flights that need no prior. [decisions: normal flights]
    few_flights: normal flights below which a note says that the spread is others'. [decisions: normal flights]
    """

    min_hover: Positive = 4.0
    min_segment: Positive = 0.5
    min_rotor_rate: Positive = 5.0
    max_speed: Positive = 0.3
    max_rate: Positive = 0.5
    cutoff: Positive = 1.0
    prior_spread: Positive = 0.02
    prior_freedom: Count = 20
    false_alarms: Annotated[float, Meta(gt=0, lt=1)] = 0.05
    min_spreads: Score = 1.0
    enough_flights: Count = 5
    few_flights: Count = 3


class VehicleThresholds(ThresholdGroup, frozen=True):
    """A vehicle's constants from its flights, and a vehicle file beside them.

    max_rounds: of correcting the vehicle and fitting again. [PX4's simulated flights: two to five]
    converged: correction over half of an interval below which it is none. [definition]
    model_error: half of an interval over the value that the model's own errors add.
    [benchmarks estimation vehicle_from_logs: five sets of PX4's simulated flights]
    lag_error: the same of the motors' lag.
    [benchmarks estimation vehicle_from_logs: the same, and each flight by itself]
    max_interval: half of an interval over the value beyond which a value is not given. [convention]
    max_torque_deviation: standard deviation of the torque constant over it, beyond which the yaw inertia is assumed.
    [benchmarks estimation vehicle_from_logs: 0.01 to 0.15 where flights show both; a rule errs by 0.4]
    min_loaded: squared speeds over usual ones below which a row is not in flight. [definition: half of the weight]
    max_lag: of speeds behind signals that is tried, s. [command_curve.max_lag and a third]
    lag_step: between the lags that are tried, s. [definition: a row at 200 Hz]
    signal_parts: of a flight, whose spread is the interval of what signals show. [convention]
    min_part: of rows in flight in a part that counts, share. [convention]
    assumed_speed: of a rotor at full signal, where nothing states it, rad/s. [a scale: nothing else depends on it]
    torque_ratio: of a rotor's torque to its thrust before any flight, m. [vehicles/: 6 to 20 mm]
    max_angle: between a rotor's direction in the file and in the parameters, degrees. [convention]
    max_length: of the difference in its distance from the centre, over it. [convention]
    tolerance: of a value beside its interval, over it. [convention: smaller differences change no flight]
    curve_tolerance: of the thrust curve beside its interval. [convention]
    """

    max_rounds: Count = 5
    converged: Share = 0.2
    model_error: Share = 0.07
    lag_error: Share = 0.1
    max_interval: Share = 0.5
    max_torque_deviation: Share = 0.2
    min_loaded: Share = 0.5
    max_lag: Positive = 0.2
    lag_step: Positive = 0.005
    signal_parts: Count = 6
    min_part: Share = 0.95
    assumed_speed: Positive = 1000.0
    torque_ratio: Positive = 0.016
    max_angle: Positive = 10.0
    max_length: Share = 0.1
    tolerance: Share = 0.05
    curve_tolerance: Share = 0.1
