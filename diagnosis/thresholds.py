"""Every threshold of diagnosis: unit, meaning, default, and where the default comes from.

A field's line ends with its origin in brackets: "planted truth" (`benchmarks/diagnosis_planted_truth.py`, whose even
seeds are for calibration), another benchmark, "decisions" (`docs/decisions/diagnosis.md`), a definition, or "margins"
(`benchmarks/threshold_margins.py`): its half and its double were tried on flights with a known answer, and what follows
says with which of both an answer changes, or that no case reads it. Functions take a `Thresholds` as an argument;
`diagnosis.thresholds_file` reads one from TOML, for a fleet that needs others.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0)]
Score = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Factor = Annotated[float, Meta(ge=1)]
Correlation = Annotated[float, Meta(ge=-1, le=1)]
Count = Annotated[int, Meta(ge=1)]
Range = tuple[Score, Score]
Shares = tuple[Share, Share]
Percent = Annotated[float, Meta(ge=0, le=100)]


class ThresholdGroup(Struct, frozen=True, forbid_unknown_fields=True):
    """Thresholds of one subject. Raises ValueError for a range whose first value is not below its second."""

    def __post_init__(self) -> None:
        """Check the ranges, which are the fields of two values."""
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) == 2 and not value[0] < value[1]:
                raise ValueError(f"{name} is {value[0]:g} to {value[1]:g}: the first must be below the second")


class FilterThresholds(ThresholdGroup, frozen=True):
    """Filters on both sides of the regression. Applied when flights are read.

    cutoff: of the low-pass on both sides, Hz. [margins: half]
    slow_cutoff: below which motion is not the controller's response to turbulence, Hz. [margins: double]
    command_cutoff: the same for the values of a fit where rotor speeds follow from commands.
    [benchmarks/interval_coverage.py; decisions: instruments of a fit]
    rate: of the rows after decimation, Hz. [three times the cutoff]
    edge: that the filters spoil at both ends of a segment, s. [formula: the low-pass has fallen to 0.3 % of its peak]
    """

    cutoff: Positive = 8.0
    slow_cutoff: Positive = 1.5
    command_cutoff: Positive = 0.75
    rate: Positive = 25.0
    edge: Positive = 0.3

    def __post_init__(self) -> None:
        """Check that decimation does not alias what the filters pass."""
        if not max(self.slow_cutoff, self.command_cutoff) < self.cutoff < self.rate / 2:
            raise ValueError(
                f"slow_cutoff {self.slow_cutoff:g} and command_cutoff {self.command_cutoff:g} must be below "
                f"cutoff {self.cutoff:g}, and that below half the rate {self.rate / 2:g} Hz"
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
    """What is fitted and what is held out. Applied when flights are read.

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

    gain: range of thrust over the vehicle file's. [benchmarks/real_flights.py: 0.63 to 1.7 occur]
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
    flight_motor_std: of a motor's gain in a flight about what all flights share. [benchmarks/px4_blind.py: 0.03 to 0.1
        give the same damping]
    bend_std: of the curve's bend at hover. [margins: neither]
    min_gain_change: of the gain from 1, from which on a wrong mass or thrust constant may be behind it.
        [benchmarks/verdicts.py: 1.2 % at most in four sets that hide nothing]
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
    """What flights and vehicle file must meet before anything is diagnosed.

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
    max_velocity_error: by which they may differ, m/s. [benchmarks/mutated_flights.py]
    max_estimator_error: the same of an estimator's pose, which corrects both separately. [benchmarks/verdicts.py: 153
    flights of 12 s with PX4's errors reach 0.61, half of them 0.37]
    max_velocity_share: the same over the speed. [benchmarks/mutated_flights.py]
    max_clipped: share of a gyro's or accelerometer's rows at its greatest value. [benchmarks/mutated_flights.py]
    max_rotor_clipped: the same of a rotor's speed or command, which may fly at its limit.
    [benchmarks/mutated_flights.py]
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

    order_margin: of agreement by which another order must exceed the file's. [benchmarks/rotor_orders.py]
    min_explained: agreement of any combination of the rotors, below which a finding says so.
    [benchmarks/rotor_orders.py]
    no_relation: the same below which the rotors cannot be this flight's. [benchmarks/rotor_orders.py]
    min_share_of_mixture: of that combination's agreement that the file's arms must have. [formula: 0.5 for arms turned
    by 45 degrees]
    opposite_yaw: correlation below which the rotors yaw the vehicle the other way. [benchmarks/rotor_orders.py]
    max_opposite_ratio: of measured over modelled yaw acceleration then; above it something else yaws the vehicle
    against its rotors. [formula: constants of torque are known to a factor of two]
    min_outlier: logarithm of the gain of a rotor whose speed is doubted, over the greatest of its peers'. [definition:
    twice what is usual in this flight]
    min_angular_acceleration: standard deviation about x and y that is judged, rad/s^2. [margins: neither]
    min_yaw_acceleration: the same about z, where rotors act less. [margins: neither]
    angular_ratio: range of measured over modelled angular acceleration. [margins: neither]
    max_permuted_rotors: whose orders are all tried. [formula: 720 orders]
    response_times: lags of rotors behind commands that are tried, s. [benchmarks/rotor_orders.py]
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


class PredictionThresholds(ThresholdGroup, frozen=True):
    """Models along flights.

    hidden_rate: at which hidden states without a short time constant are integrated, Hz. [margins: neither]
    max_substeps: integration steps between two rows; hidden states that need more are not predicted. [definition: a
        time constant of 0.5 ms at 40 Hz]
    min_lag_rows: shortest time constant of a grid that is tried, rows. [margins: neither: shorter ones look alike]
    horizons: of open-loop prediction, s. [definition]
    start_interval: between starts of open-loop prediction, s. [margins: neither]
    free_start_durations: of a segment's beginning, from which hidden states that begin in mid-motion are fitted, s:
        step by step, so that a swing of 60 degrees is followed. [benchmarks/verdicts.py: slung loads, seeds 500 to 502]
    free_start_rate: at which they are integrated for that, Hz. [the same: as at 50 Hz to 0.5 % of the swing]
    free_start_band: in which a motion is looked for, Hz. [formula: lines of 0.1 to 3 m]
    free_start_noise_band: in which noise is seen, Hz. [definition: above that, below the filters' cutoff]
    free_start_excess: of the power in the first over that in the second, above which something moves there.
        [benchmarks/verdicts.py, nothing hidden: 1 in 20 segments is above, none above 3.3]
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


class NoiseThresholds(ThresholdGroup, frozen=True):
    """Noise of the residual channels.

    order: of the autoregressive models. [margins: both]
    reference_band: its level caps the spectrum below it, where missing effects show, Hz. [decisions: the noise floor]
    spectrum_rows: of a periodogram. [margins: neither]
    slow_order: of the models beside an estimator's slow errors. [px4_sih_flights: with it and `slow_spectrum_rows` the
    whitened residual below 0.1 Hz has 1.0 to 2.5 times the power of white noise, 1.5 to 4 with the usual ones]
    slow_spectrum_rows: of a periodogram beside them. [the same]
    sensor_band: over the filters' cutoff, where sensors alone are heard. [margins: neither]
    sensor_share: of the log's rate, at which that band ends at the latest. [formula: central differences see little
    beyond]
    sensor_rows: of a periodogram of the unfiltered residual. [margins: neither]
    min_sensor_band: ratio of that band's ends, over which white noise and the tail of motion, 1 / f^2, can be told
    apart. [formula: the tail falls to a quarter]
    reweightings: of the likeliest spectrum. [formula: it has converged then]
    torque_redness: factor on that cap for torques, which the rotors' turbulence reddens. [decisions: the noise floor]
    """

    order: Count = 6
    reference_band: Range = (1.5, 3.0)
    spectrum_rows: Annotated[int, Meta(ge=16)] = 128
    slow_order: Count = 10
    slow_spectrum_rows: Annotated[int, Meta(ge=16)] = 512
    sensor_band: Range = (1.25, 3.0)
    sensor_share: Share = 0.3
    sensor_rows: Annotated[int, Meta(ge=64)] = 256
    min_sensor_band: Factor = 2.0
    reweightings: Count = 5
    torque_redness: Factor = 1.5


class PoseThresholds(ThresholdGroup, frozen=True):
    """Slow errors of a pose by an estimator that used the accelerometer: smooth Gauss-Markov processes.

    velocity_error: standard deviation, m/s, at most, and where there is no position to compare with.
    [tests/data/px4_sih_flights: 0.14 to 0.23 over 28 flights of PX4 with GNSS]
    velocity_time: correlation time of that, s. [the same: 2.6 to 2.7]
    tilt_error: standard deviation, rad. [the same: 1.2 degrees]
    tilt_time: correlation time of that, s. [the same: 2.5 to 3.8]
    smooth_time: below which these errors do not change, s. [the same]
    min_coherence: of the velocity's derivative with the accelerometer where no motion reaches, above which the pose of
    a table is an estimator's. [tests/data/px4_sih_flights 0.997; tests/data/nanobench 0.26 to 0.40; simulated motion
    capture 0.13 and less]
    examples: segments on which the model's slope in the velocity is found. [margins: neither]
    """

    velocity_error: Positive = 0.2
    velocity_time: Positive = 2.7
    tilt_error: Score = 0.021
    tilt_time: Positive = 3.0
    smooth_time: Positive = 0.3
    min_coherence: Share = 0.7
    examples: Count = 3


class RegressionThresholds(ThresholdGroup, frozen=True):
    """Normal equations of all candidates.

    ridge: on all columns at once, over the number of rows. [margins: neither]
    max_bias: of a sensor in standard deviations of its specification; beyond it is a fault. [convention: 99 %]
    independent_share: of the whitened residuals, in the criterion's penalty. [margins: neither]
    """

    ridge: Positive = 1e-6
    max_bias: Positive = 2.5
    independent_share: Annotated[float, Meta(gt=0, le=1)] = 0.25


class SearchThresholds(ThresholdGroup, frozen=True):
    """Forward search over candidates. A score is twice the log-likelihood gained, less the criterion's penalty.

    min_gain: score below which no effect is claimed. [planted truth: feedback makes inertia reach 29
    where nothing is hidden]
    min_fault_gain: the same of a sensor's fault, which feedback does not imitate. [planted truth]
    relevant: gain over the number of whitened residuals below which an effect does not matter: a tenth of
    2 % of the floor of one kind of four. [margins: neither]
    min_share: of the first effect's gain that a further one must add in the first round, which is linear about a
    vehicle without either. [margins: neither]
    parsimony: share of the gain at which fewer coefficients are preferred. [margins: neither]
    min_cross_validated: share of an improvement that must show on flights left out. [margins: neither]
    min_improvement: of a set's worth, below which a step is not taken. [formula: rounding ends no search]
    max_effects: in one set. [convention]
    max_steps: of one search, which ends long before. [formula: more than twice as many as effects]
    max_rounds: of search, each about the fit of the last one. [margins: neither]
    explained: reduced chi-square of the fitted flights at which no further round is needed. [margins: neither]
    unexplained: reduced chi-square of the last round's fit above which the search begins again in still air, where a
    gust stood in for a drag. [definition: twice the noise]
    still_explained: of that search, up to which it counts, and of named effects, up to which rivals that need less are
    sought. [definition: that of a typical window that is explained]
    max_growth: of the reduced chi-square from one round's fit to the next, whose noise differ a little, above which the
    search goes fewer steps. [margins: neither]
    max_pair_share: reduced chi-square of a drag in a steady wind over that of the first set, below which the search
    goes on from that pair. [benchmarks/flight_estimates.py: 0.01 to 0.07 in three windy flights, about 1 in two]
    max_paired: best single effects with which pairs are tried. [margins: neither]
    max_trials: best additions that are cross-validated in one step. [margins: neither]
    max_proposed: best additions that the full model tries in one step of the pursuit. [decisions: of two sets that
    columns led astray the one that leaves least was among five]
    max_contenders: best single effects of which cross-validation chooses the first. [margins: neither]
    min_contender_share: of the best score that a contender must have. [margins: neither]
    bound_slack: of a prior's deviation by which noise may move a coefficient over its bound. [margins: neither]
    amplitude: range of a fixed-shape regressor's coefficient. [definition: near 1]
    min_gust_share: of the effects' gain that a gust beside them must add. [margins: neither]
    """

    min_gain: Score = 40.0
    min_fault_gain: Score = 15.0
    relevant: Share = 0.001
    min_share: Share = 0.003
    parsimony: Share = 0.985
    min_cross_validated: Share = 0.3
    min_improvement: Score = 1.0
    max_effects: Count = 10
    max_steps: Count = 60
    max_rounds: Count = 5
    explained: Factor = 1.05
    unexplained: Factor = 4.0
    still_explained: Factor = 1.5
    max_growth: Factor = 2.0
    max_pair_share: Share = 0.5
    max_paired: Count = 8
    max_trials: Count = 12
    max_proposed: Count = 5
    max_contenders: Count = 5
    min_contender_share: Share = 0.5
    bound_slack: Score = 0.02
    amplitude: Range = (0.4, 1.9)
    min_gust_share: Share = 0.03


class RivalThresholds(ThresholdGroup, frozen=True):
    """When these flights cannot tell two effects apart.

    score_margin: difference of score within which they cannot. [margins: neither]
    gain_share: of the gain, the same. [margins: half]
    added_share: of what an effect adds to the others, that a rival may leave to be declared. [margins: neither]
    max_rivals: that are compared with an effect. [margins: neither]
    min_narrow_ratio: reduced chi-square over that of an effect in whose place another one is taken, above which the two
    are declared where the catalogue says that they look alike. [margins: neither]
    min_alike_share: of an effect's gain that one which the catalogue declares to look like it has in its place, above
    which the two are declared where the verdict is unknown; and which a refused one takes from it. [definition: half of
    it]
    """

    score_margin: Score = 12.0
    gain_share: Share = 0.01
    added_share: Share = 0.15
    max_rivals: Count = 7
    min_narrow_ratio: Share = 0.95
    min_alike_share: Share = 0.5


class GustThresholds(ThresholdGroup, frozen=True):
    """Random air motion.

    max_frequency: of the cosines that make it up, Hz. [formula: 86 % of the variance of a gust of 1 s lies below]
    corners: of its spectrum, the one that is marginalised first; its strength is that of the likeliest, Hz.
    [definition: correlation times of 1, 2 and 0.5 s]
    intensity: range of its strength that is tried, m/s. [definition: from nothing to a storm]
    strengths: that are tried in it. [formula: neighbours differ by a third]
    part: of a segment whose air is independent of that of the others, s. [formula: many correlation times]
    over_error: by which it must exceed an estimator's error of velocity, which is in several channels at once.
    [benchmarks/verdicts.py: that error looks like gusts of 0.5 to 1.7 times its size]
    """

    max_frequency: Positive = 0.7
    corners: tuple[Positive, ...] = (0.15, 0.08, 0.3)
    intensity: tuple[Positive, Positive] = (0.01, 15.0)
    strengths: Annotated[int, Meta(ge=3)] = 26
    part: Positive = 30.0
    over_error: Factor = 2.0


class ResidualTestThresholds(ThresholdGroup, frozen=True):
    """Tests of what an identified model leaves; `VerdictThresholds` holds their limits.

    features: random Fourier features of state or position. [margins: neither]
    chances: residuals from elsewhere, of which the most predictable shows what chance predicts. [formula: one in nine
    exceeds all of eight]
    state_fineness: of a feature of the state, over the standard deviation of the state. [margins: neither]
    velocity_fineness: the same of the body's velocity alone, on which forces of the air depend. [margins: neither]
    position_fineness: the same of position alone, where a field of air repeats. [margins: neither]
    ridges: that are tried. [margins: neither]
    low_band: in which accelerometer and pose must not agree, Hz. [margins: neither]
    reference_band: against which that is compared, Hz. [margins: double]
    line_band: in which a spectral line is sought, Hz. [margins: neither]
    line_rows: of a periodogram. [margins: neither]
    line_refinement: frequencies within a bin of which a line's own is the best. [definition]
    line_surroundings: bins over which a line's surroundings are the median. [margins: neither]
    agreement_powers: independent ones in the low band with which `max_agreement` holds; with fewer a torque's slow part
    exceeds it by chance. [`benchmarks/short_logs.py`, seeds from
    930,000: torques are 2.75 times as strong there]
    window_width: noise bandwidth of a window of Hann, bins. [formula]
    chance: probability with which noise alone exceeds what counts as a line or as slow. [definition]
    line_draws: of residuals with random signs, to whose strongest lines a distribution is given. [formula: the
    deviation of 100 values holds to 7 %]
    state_shift: by which the state is taken later, and earlier, where it predicts, s. [benchmarks/counts.py, seeds
    24000 on: where nothing was hidden it predicts 6 to 27 times as much later as earlier, of forms outside the
    catalogue 0.9 to 1.2 times]
    """

    chances: Count = 8
    features: Count = 120
    state_fineness: Positive = 0.35
    velocity_fineness: Positive = 1.5
    position_fineness: Positive = 1.5
    ridges: tuple[Positive, ...] = (1e2, 1e3, 1e4, 1e5)
    low_band: Range = (0.05, 1.5)
    reference_band: Range = (2.5, 6.5)
    line_band: Range = (0.6, 7.0)
    line_rows: Annotated[int, Meta(ge=64)] = 512
    line_refinement: Count = 9
    line_surroundings: Count = 61
    agreement_powers: Count = 25
    window_width: Factor = 1.5
    chance: Share = 1e-3
    line_draws: Annotated[int, Meta(ge=10)] = 100
    state_shift: Positive = 0.16


class EquationErrorThresholds(ThresholdGroup, frozen=True):
    """Gauss-Newton on accelerations.

    max_steps: of Gauss-Newton. [margins: neither]
    max_cost_growth: factor on the cost beyond which a step is halved. [margins: neither]
    damping: share of each parameter's information that is added first where Gauss-Newton does not go straight.
        [convention: 1e-3 to 1e-2; the steps change it]
    damping_factor: by which that grows after a step that fits worse, and falls after one that fits better.
        [convention: ten]
    max_damped: steps so damped. [decisions: Gauss-Newton goes on from where they lead]
    min_damped_fall: share of the cost by which each of them must improve the fit. [decisions: instruments lead on]
    converged: step over the standard deviation at which it ends; output error uses the same. [formula: a bias of as
    much takes 0.005 % off an interval's coverage]
    max_unsettled: the same beyond which a fit that has ended has no interval. [definition: the step leaves it]
    hopeless: reduced chi-square over that of a set that it is compared with, above which a fit whose way was not
        straight is not made again. [decisions: damped steps took the most off a true set that ended at 5.5 times]
    min_approach: share of what is above a cost that must be reached, which a step must take off: with less, none of
        those that are left reaches it. [formula: max_steps of them take 0.57 off]
    max_idle: steps in a row that take less. [definition: the first may lead over a rise]
    difference_step: of finite differences, relative. [formula: slopes are off by half of it, and no estimate is]
    block: over which residuals may be correlated, s. [decisions: intervals come from blocks]
    prior_blocks: as many as which the noise model counts where blocks vary less. [benchmarks/interval_coverage.py]
    min_excess: reduced chi-square of a channel above which it is weighed by its own residuals, with commands.
    [margins: neither]
    slower: by which the cutoff of slow motion is divided where instruments are to hold less of the controller's answer
        to turbulence. [docs/identification.md, section 3: an eighth of the bias is left]
    max_moved: standard deviations by which such instruments may move an effect that keeps the others; wider intervals
        are their price. [benchmarks/verdicts.py, nothing hidden: 5 of 343 sets had an inertia without them, 2 with two
        deviations, none with one]
    min_more: variance of that change, at least, over that of the fit by slower motion. [convention: as little counts as
        none]
    faster: by which that cutoff is multiplied to see whether a value follows it. [benchmarks/counts.py: of seeds 24007
        and 24101, inertias of 1.84 and 1.27 with nothing hidden move by 1.14 and 0.34, true ones by 0.03]
    unsure: share of that move that is a deviation of the value. [definition: the deviation of two values]
    """

    max_steps: Count = 8
    max_cost_growth: Factor = 1.001
    damping: Share = 0.01
    damping_factor: Factor = 10.0
    max_damped: Count = 12
    min_damped_fall: Share = 0.01
    converged: Positive = 0.02
    max_unsettled: Positive = 1.0
    hopeless: Factor = 6.0
    min_approach: Share = 0.1
    max_idle: Count = 2
    difference_step: Positive = 0.02
    block: Positive = 2.0
    prior_blocks: Positive = 4.0
    min_excess: Factor = 1.2
    slower: Annotated[float, Meta(gt=1)] = 2.0
    max_moved: Positive = 1.0
    min_more: Share = 0.1
    faster: Annotated[float, Meta(gt=1)] = 4.0
    unsure: Share = 0.5


class SlowMotionThresholds(ThresholdGroup, frozen=True):
    """What slow motion leaves of a model.

    cutoff: below which motion is slow, Hz. [decisions: slow motion decides]
    min_share: of the instruments' scaled Gram matrix, below which its directions are none. [convention]
    enough: J over the number of instruments up to which it does not refute a set. [decisions: slow motion decides: 0.8
        to 1.5 of five true sets, 5 and more of four false ones]
    min_fall: of what is left over that, above which another set is better. [convention]
    """

    cutoff: Positive = 0.75
    min_share: Share = 1e-5
    enough: Factor = 2.0
    min_fall: Share = 0.1


class OutputErrorThresholds(ThresholdGroup, frozen=True):
    """Gauss-Newton on simulated windows.

    window: s. [benchmarks/output_error.py]
    max_windows: of all segments, about. [margins: neither]
    min_windows: below which nothing is fitted. [margins: neither]
    max_steps: of Gauss-Newton. [margins: neither]
    shrinkage: of the errors' covariance towards its diagonal. [margins: neither]
    difference_step: of finite differences of hidden states' starts, relative. [margins: no case]
    max_one_step_growth: factor on the one-step error of the equation-error fit. [benchmarks/output_error.py]
    """

    window: Positive = 0.5
    max_windows: Count = 300
    min_windows: Count = 20
    max_steps: Count = 4
    shrinkage: Share = 0.1
    difference_step: Positive = 1e-3
    max_one_step_growth: Factor = 1.005


class AcceptanceThresholds(ThresholdGroup, frozen=True):
    """Held-out flights judge, once, the set of effects that was selected on the others.

    max_ratio: of the held-out reduced chi-square with an effect over that without it. [margins: neither]
    max_redundant_ratio: of the reduced chi-square of the fitted flights, within which rivals are alike. [decisions:
    the full model decides]
    min_held_out_change: squared change over noise on held-out flights, below which these cannot judge. [decisions:
    held-out flights]
    leading: effects whose rivals are fitted in the full model. [decisions: the full model decides]
    max_rivals: of each of these that are fitted. [margins: neither]
    typical_window: over which the error is averaged before its geometric mean is taken, s. [decisions: held-out
    flights]
    max_linear_rise: of an error without an effect, over the floor, up to which the others are fitted again in full and
    not by their linearised equations. [margins: neither]
    """

    max_ratio: Share = 0.999
    max_redundant_ratio: Factor = 1.01
    min_held_out_change: Score = 25.0
    leading: Count = 2
    max_rivals: Count = 2
    typical_window: Positive = 2.0
    max_linear_rise: Score = 0.1


class RelevanceThresholds(ThresholdGroup, frozen=True):
    """What is too small to matter, and what is chance.

    min_rise: of an error over its floor, were all else at the floor, when an effect is left out. [definition]
    max_rise: of the same that is no loss, when an effect is put in. [definition: that of `min_rise`]
    min_axis_floor: of an axis over that of its kind; no axis is without noise. [definition]
    deviations: of an estimate from its neutral value, or of a change from none, that is not chance. [convention: 95 %]
    block: over which errors may be correlated, s. [decisions: intervals come from blocks]
    min_blocks: into which errors are divided where there are fewer of that length. [margins: neither]
    min_agreement: share of flight resamples that name an effect. [definition: the majority]
    """

    min_rise: Score = 0.02
    max_rise: Score = 0.02
    min_axis_floor: Share = 1e-3
    deviations: Positive = 2.0
    block: Positive = 2.0
    min_blocks: Count = 8
    min_agreement: Share = 0.5


class ConsistencyThresholds(ThresholdGroup, frozen=True):
    """Whether an effect has one value.

    max_drift: of its signal between where it acts strongly and weakly, or early and late in a flight, over the signal.
    [benchmarks/verdicts.py: right forms 0.00 to 0.08, a form in place of another from 0.3]
    deviations: of that difference from none, that is not chance. [convention: 95 %]
    sure: the same, above which an effect has no one value though no test of the residuals rejects. [decisions: a
        constant that warms up]
    min_over_noise: RMS of what the difference explains over the noise, above which that is so. [definition: 0.2 raises
        the error by 2 %]
    min_share_of_left: squared error that an effect explains over what is left above the floor, in the kind of channel
        that falls most. [benchmarks/verdicts.py: 0.00 to 0.03 of forms in place of another; an effect of 1.5 times the
        floor has 0.05 beside one of 5 times]
    min_share_of_axis: the same of the axis that falls most; an effect may be below one of the two. [the same: 0.2]
    min_share_at_all: as the first, below which no axis counts: what is missing by a hundred times as much reaches any
        axis. [benchmarks/verdicts.py, swirl-955 and 956: 0.004 and 0.006 of a constant that is right, with 0.34 and
        0.49 of an axis]
    """

    max_drift: Share = 0.2
    deviations: Positive = 2.0
    sure: Positive = 5.0
    min_over_noise: Score = 0.2
    min_share_of_left: Score = 0.05
    min_share_of_axis: Score = 0.25
    min_share_at_all: Score = 0.01


class LateSignalsThresholds(ThresholdGroup, frozen=True):
    """When an effect stands in for a signal that was logged late.

    min_delay: s; smaller ones are within the clocks' errors. [definition: that of the catalogue's delays]
    max_share_kept: gain of an effect beside the delay over that without it, up to which the delay replaces it.
    [margins: neither]
    min_share: of the gain of all effects that it replaces, which the delay must have in their place. [margins: neither]
    """

    min_delay: Positive = 0.003
    max_share_kept: Share = 0.2
    min_share: Share = 0.9


class VerdictThresholds(ThresholdGroup, frozen=True):
    """Limits above which the residual tests reject, and how effects are reported.

    max_agreement: of accelerometer and pose at low frequency. [planted truth]
    max_predictable: log-likelihood a residual that a function of the state gains. [planted truth]
    max_line: power of a line over its surroundings. [planted truth]
    max_line_swinging: the same beside a load that swings, whose phase is lost on wild flights. [margins: neither]
    max_chi_square: reduced, of a typical held-out window. [planted truth]
    min_over_floor: RMS of what a test finds over the channel's floor, below which it does not matter. [definition: 0.2
    raises the error by 2 %]
    min_over_gust: the same over floor and gust together, where one is named. [benchmarks/verdicts.py: gusts alone leave
    up to 0.9]
    max_share: of the same statistic before the effects, which their imperfect form may leave. [margins: neither]
    max_excused: RMS of what a test finds over the channel's floor, up to which that share excuses it. [definition: that
    much is twice the floor]
    max_gust_predictable: share of a gust's gain that state or place may predict. [decisions: air in motion is no
    function of the state]
    max_line_in_gust: share of a gust's power that a line in the spectrum may have. [decisions: a load that swings is no
    gust]
    min_swinging: squared error that a load which swings explains over what is left above the floor, below which its
    phase excuses nothing. [definition: what is left is more than the load]
    resamples: of flights, for the confidence. [margins: neither]
    """

    max_agreement: Score = 5.5
    max_predictable: Score = 0.01
    max_line: Score = 10.0
    max_line_swinging: Score = 30.0
    max_chi_square: Factor = 1.5
    min_over_floor: Score = 0.2
    min_over_gust: Score = 1.25
    max_share: Share = 0.03
    max_excused: Score = 1.75
    max_gust_predictable: Share = 0.35
    max_line_in_gust: Share = 0.1
    min_swinging: Score = 1.0
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
    [benchmarks/vehicle_from_logs.py: five sets of PX4's simulated flights]
    lag_error: the same of the motors' lag. [benchmarks/vehicle_from_logs.py: the same, and each flight by itself]
    max_interval: half of an interval over the value beyond which a value is not given. [convention]
    max_torque_deviation: standard deviation of the torque constant over it, beyond which the yaw inertia is assumed.
    [benchmarks/vehicle_from_logs.py: 0.01 to 0.15 where flights show both; a rule errs by 0.4]
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


class Thresholds(ThresholdGroup, frozen=True):
    """All thresholds of diagnosis, by subject."""

    filters: FilterThresholds = FilterThresholds()
    segment: SegmentThresholds = SegmentThresholds()
    dataset: DatasetThresholds = DatasetThresholds()
    command_curve: CommandCurveThresholds = CommandCurveThresholds()
    data_checks: DataChecks = DataChecks()
    rotor_moments: RotorMomentChecks = RotorMomentChecks()
    prediction: PredictionThresholds = PredictionThresholds()
    noise: NoiseThresholds = NoiseThresholds()
    pose: PoseThresholds = PoseThresholds()
    regression: RegressionThresholds = RegressionThresholds()
    search: SearchThresholds = SearchThresholds()
    rivals: RivalThresholds = RivalThresholds()
    gust: GustThresholds = GustThresholds()
    residual_tests: ResidualTestThresholds = ResidualTestThresholds()
    equation_error: EquationErrorThresholds = EquationErrorThresholds()
    slow_motion: SlowMotionThresholds = SlowMotionThresholds()
    output_error: OutputErrorThresholds = OutputErrorThresholds()
    acceptance: AcceptanceThresholds = AcceptanceThresholds()
    relevance: RelevanceThresholds = RelevanceThresholds()
    consistency: ConsistencyThresholds = ConsistencyThresholds()
    late_signals: LateSignalsThresholds = LateSignalsThresholds()
    verdict: VerdictThresholds = VerdictThresholds()
    completion: CompletionThresholds = CompletionThresholds()
    regimes: RegimeThresholds = RegimeThresholds()
    in_flight: InFlightThresholds = InFlightThresholds()
    hover_trim: HoverTrimThresholds = HoverTrimThresholds()
    vehicle: VehicleThresholds = VehicleThresholds()


DEFAULT = Thresholds()
