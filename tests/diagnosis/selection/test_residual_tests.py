"""Each test of the residuals fires on what it is for, and stays silent on white noise."""

import dataclasses

import msgspec
import numpy as np
import pytest
from scipy.signal import lfilter

from diagnosis.models.channels import POSE_ACCELERATION
from diagnosis.models.pose_errors import PoseErrors
from diagnosis.selection.residual_tests import PerturbedResiduals, low_frequency_agreement, run_residual_tests
from diagnosis.selection.spectral_line import line_by_chance, strongest_line
from diagnosis.thresholds import DEFAULT
from dynamics.state import VELOCITY
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, hovering, regression

FLIGHTS = 3
LIMITS = DEFAULT.verdict
# fewer features and ridges than usual, for speed
FEW = msgspec.structs.replace(
    DEFAULT, residual_tests=msgspec.structs.replace(DEFAULT.residual_tests, features=30, ridges=(1e2, 1e3))
)


@pytest.fixture(scope="module")
def segments(arpl_250g):
    """Segments that visit a loop of places twice, the second time with another velocity."""
    moving = []
    for i, still in enumerate(hovering(arpl_250g, mass_ratio=1.0, seed=0, count=FLIGHTS, duration=24.0)):
        time = np.arange(len(still)) / still.rate
        phase = 2 * np.pi * np.where(time < 12, time / 12, (time - 12) / 6) + i
        position = np.column_stack([np.sin(phase), np.cos(phase), 1 + 0.3 * np.sin(2 * phase)])
        velocity = np.gradient(position, 1 / still.rate, axis=0)
        moving.append(dataclasses.replace(still, position=position, velocity=velocity))
    return tuple(moving)


@pytest.fixture(scope="module")
def of_noise(arpl_250g, segments):
    """Makes the regression of these segments and white residuals for it."""

    def make(seed):
        random = np.random.default_rng(seed)
        rows = [random.standard_normal((len(s.smooth[s.decimated]), CHANNELS)) for s in segments]
        columns = [np.ones((len(y), CHANNELS, 1)) for y in rows]
        return regression(
            arpl_250g, [candidate(effect("a"), 0)], columns, rows, segments=segments, thresholds=FEW
        ), rows

    return make


def fires(tests):
    """Names of the tests beyond their limits; the one by position has that of the state, without a gust."""
    return {
        name
        for name, limit in (
            ("low_frequency_agreement", LIMITS.max_agreement),
            ("predictable_from_state", LIMITS.max_predictable),
            ("spectral_line", max(LIMITS.max_line, tests.line_by_chance)),
            ("position_dependent", LIMITS.max_predictable),
        )
        if getattr(tests, name) > limit and tests.over_floor(name) > LIMITS.min_over_floor
    }


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_fires_none(of_noise, seed):
    of_all, rows = of_noise(seed)
    assert fires(run_residual_tests(of_all, rows, by_position=True)) == set()


def test_lines_and_agreement_in_white_noise_stay_below_their_limits_in_39_of_40_draws(of_noise):
    thresholds = DEFAULT.residual_tests
    lines, agreements = 0, 0
    for seed in range(40):
        random = np.random.default_rng(1000 + seed)
        rows = [random.standard_normal((500, CHANNELS)) for _ in range(3)]
        lines += strongest_line(rows, 25.0, thresholds).over_surroundings > LIMITS.max_line
        agreements += low_frequency_agreement(rows, 25.0, thresholds) > LIMITS.max_agreement
    assert lines <= 1
    assert agreements <= 1


def test_a_torque_is_slow_in_a_short_log_only_where_noise_is_not():
    """Noise as red as the rotors' turbulence makes torques: 4 of these 100 draws are above the limit of longer logs."""
    above = 0
    for seed in range(100):
        random = np.random.default_rng(3000 + seed)
        rows = [lfilter([1.0], [1.0, -0.5], random.standard_normal((m, CHANNELS)), axis=0) for m in (243, 164)]
        above += low_frequency_agreement(rows, 25.0, DEFAULT.residual_tests) > LIMITS.max_agreement
    assert above <= 1


@pytest.mark.parametrize("lengths", [(500,), (243, 164)])
def test_a_line_in_a_short_log_is_one_that_noise_does_not_have(lengths):
    """Nine in ten draws of one segment of 20 s exceed `max_line`."""
    thresholds = DEFAULT.residual_tests
    for seed in range(8):
        random = np.random.default_rng(2000 + seed)
        rows = [random.standard_normal((m, CHANNELS)) for m in lengths]
        limit = max(LIMITS.max_line, line_by_chance(rows, 25.0, thresholds))
        assert strongest_line(rows, 25.0, thresholds).over_surroundings < limit
        for y in rows:
            y[:, 4] += 1.2 * np.sin(2 * np.pi * 3.0 * np.arange(len(y)) / 25.0)
        limit = max(LIMITS.max_line, line_by_chance(rows, 25.0, thresholds))
        assert strongest_line(rows, 25.0, thresholds).over_surroundings > limit


def test_a_planted_sine_is_a_line(of_noise):
    of_all, rows = of_noise(0)
    for y in rows:
        y[:, 4] += 0.8 * np.sin(2 * np.pi * 3.0 * np.arange(len(y)) / 25.0)
    tests = run_residual_tests(of_all, rows)
    assert "spectral_line" in fires(tests)
    named = tests.findings["spectral_line"]
    assert (named.channel, named.frequency) == (4, pytest.approx(3.0, abs=0.05))
    assert named.rms == pytest.approx(0.8 / np.sqrt(2), rel=0.1)


def harmonics(segments, rate=25.0):
    """(m,) of each segment: a periodic manoeuvre of 1.1 Hz with a second and a third harmonic."""
    times = [np.arange(len(s.smooth[s.decimated])) / rate for s in segments]
    return [sum(np.sin(2 * np.pi * 1.1 * k * t + k) / k for k in (1, 2, 3)) for t in times]


def flown(segment, motion):
    """The segment with an angular acceleration about y that is this motion."""
    time = np.arange(len(segment)) / segment.rate
    rows = np.arange(len(segment.position))[segment.decimated]
    gyro = segment.gyro.copy()
    gyro[:, 1] += np.cumsum(np.interp(time, time[rows], motion)) / segment.rate
    return dataclasses.replace(segment, gyro=gyro)


@pytest.fixture(scope="module")
def periodic(of_noise, segments):
    """Makes the regression of a periodic manoeuvre that turns the vehicle by 20 times the noise, and noise for it."""
    motion = harmonics(segments)
    moving = tuple(flown(s, 20.0 * turning) for s, turning in zip(segments, motion, strict=True))

    def make(seed):
        of_all, rows = of_noise(seed)
        return dataclasses.replace(of_all, segments=moving), rows, motion

    return make


@pytest.mark.parametrize("seed", range(3))
def test_what_a_form_leaves_of_a_periodic_manoeuvre_is_no_line(periodic, seed):
    of_all, rows, motion = periodic(seed)
    for y, turning in zip(rows, motion, strict=True):
        y[:, 7] += 0.04 * 20.0 * turning  # a form that is wrong by 4 %
    tests = run_residual_tests(of_all, rows)
    assert "spectral_line" not in fires(tests)
    assert strongest_line(rows, 25.0, FEW.residual_tests).over_surroundings > max(LIMITS.max_line, tests.line_by_chance)


@pytest.mark.parametrize("frequency", [1.6, 2.75, 4.0])
def test_a_line_elsewhere_than_the_manoeuvre_s_is_one_beside_what_a_form_leaves(periodic, frequency):
    of_all, rows, motion = periodic(1)
    for y, turning in zip(rows, motion, strict=True):
        y[:, 7] += 0.04 * 20.0 * turning + 0.6 * np.sin(2 * np.pi * frequency * np.arange(len(y)) / 25.0)
    tests = run_residual_tests(of_all, rows)
    assert "spectral_line" in fires(tests)
    assert tests.findings["spectral_line"].frequency == pytest.approx(frequency, abs=0.05)


@pytest.mark.parametrize("left", [0.3, 0.15])
def test_a_line_of_the_manoeuvre_of_which_much_is_left_is_one(periodic, left):
    """A share of its power above `max_share`, and one below it that is far above the floor."""
    of_all, rows, motion = periodic(2)
    for y, turning in zip(rows, motion, strict=True):
        y[:, 7] += left * 20.0 * turning
    assert "spectral_line" in fires(run_residual_tests(of_all, rows))


def test_a_slow_force_on_which_accelerometer_and_pose_agree_is_noticed(of_noise):
    of_all, rows = of_noise(0)
    for i, y in enumerate(rows):
        slow = np.sin(2 * np.pi * 0.4 * np.arange(len(y)) / 25.0 + i)
        y[:, 1] += slow
        y[:, 4] += slow
    tests = run_residual_tests(of_all, rows)
    assert "low_frequency_agreement" in fires(tests)
    assert tests.findings["low_frequency_agreement"].channel == 1
    assert tests.findings["low_frequency_agreement"].rms == pytest.approx(np.sqrt(0.5), rel=0.15)
    for y in rows:  # the same in the accelerometer alone is a sensor's
        y[:, 4] = np.random.default_rng(1).standard_normal(len(y))
    assert "low_frequency_agreement" not in fires(run_residual_tests(of_all, rows))
    tone = tests.findings["low_frequency_agreement"]
    assert type(tone.rms) is type(tone.over_floor) is float  # as JSON holds it


def test_a_gust_raises_the_floor_of_all_findings_but_the_line(of_noise):
    of_all, rows = of_noise(0)
    still, gusty = (run_residual_tests(of_all, rows, gust=air) for air in (None, np.sqrt(3.0) * of_all.noise.floor))
    for name, finding in still.findings.items():
        ratio = 1.0 if name == "spectral_line" else 2.0
        assert ratio * gusty.over_floor(name) == pytest.approx(finding.over_floor), name
    assert "spectral_line" in still.findings
    assert len(still.findings) > 1


def test_a_force_that_depends_on_the_state_is_predictable(of_noise, segments):
    of_all, rows = of_noise(0)
    for y, segment in zip(rows, segments, strict=True):
        velocity = segment.smooth[segment.decimated, VELOCITY]
        y[:, 0] += velocity[:, 0] * np.abs(velocity[:, 0])
    tests = run_residual_tests(of_all, rows)
    assert "predictable_from_state" in fires(tests)
    named = tests.findings["predictable_from_state"]
    planted = np.concatenate([s.smooth[s.decimated, VELOCITY][:, 0] for s in segments])
    assert named.channel == 0
    assert named.rms == pytest.approx(np.sqrt(np.mean(planted**4)), rel=0.3)
    assert [len(part) for part in named.part] == [len(y) for y in rows]
    assert tests.position_dependent == 0.0


def test_turbulence_that_the_state_answers_is_no_function_of_the_state(of_noise, segments):
    """A force that moves the vehicle is in the velocity afterwards: the state ahead predicts it, not the one before."""
    of_all, rows = of_noise(0)
    random, moved = np.random.default_rng(5), []
    for y, segment in zip(rows, segments, strict=True):
        force = lfilter([0.1], [1, -0.9], 4 * random.standard_normal(len(y)))  # for about 0.4 s
        y[:, 0] += force
        velocity = segment.velocity.copy()
        answer = np.convolve(force, np.exp(-np.arange(50) / 12.5))[: len(force)] / 25.0
        velocity[:, 0] += np.interp(np.arange(len(segment)), np.arange(len(segment))[segment.decimated], answer)
        moved.append(dataclasses.replace(segment, velocity=velocity))
    tests = run_residual_tests(dataclasses.replace(of_all, segments=tuple(moved)), rows)
    unaware = msgspec.structs.replace(FEW.residual_tests, state_shift=1e-3)  # which compares the state with itself
    compared = dataclasses.replace(
        of_all, segments=tuple(moved), thresholds=msgspec.structs.replace(FEW, residual_tests=unaware)
    )
    assert "predictable_from_state" in fires(run_residual_tests(compared, rows))
    assert "predictable_from_state" not in fires(tests)


def test_a_force_that_depends_on_the_place_repeats_there(of_noise, segments):
    of_all, rows = of_noise(0)
    for y, segment in zip(rows, segments, strict=True):
        y[:, 0] += np.cos(3 * segment.position[segment.decimated, 0])
    assert "position_dependent" in fires(run_residual_tests(of_all, rows, by_position=True))
    of_all, rows = of_noise(0)
    for y in rows:  # a slow force that does not recur at the same place
        y[:, 0] += np.sin(2 * np.pi * 0.11 * np.arange(len(y)) / 25.0)
    assert "position_dependent" not in fires(run_residual_tests(of_all, rows, by_position=True))


def test_a_force_that_bends_sharply_with_the_velocity_is_predictable(of_noise, segments):
    of_all, rows = of_noise(0)
    for y, segment in zip(rows, segments, strict=True):
        y[:, 0] += 0.6 * np.sign(segment.smooth[segment.decimated, VELOCITY][:, 0])
    assert "predictable_from_state" in fires(run_residual_tests(of_all, rows))


def slow(random, shape, poles):
    """Gauss-Markov processes of unit variance along the first axis. poles: the correlation from row to row, each."""
    values = random.standard_normal((shape[0] + 1000, *shape[1:]))
    for pole in poles:
        values = lfilter([1.0], [1.0, -pole], values, axis=0)
    return values[1000:] / np.std(values[1000:])


def test_an_estimators_slow_errors_resemble_some_function_of_the_state_by_chance(arpl_250g):
    """Short flights visit few independent states, and errors that last as long fit one function of them or another."""
    flown = []
    for i, still in enumerate(hovering(arpl_250g, mass_ratio=1.0, seed=0, count=7, duration=12.0)):
        velocity = slow(np.random.default_rng(50 + i), still.velocity.shape, poles=(0.98, 0.98))
        flown.append(dataclasses.replace(still, velocity=velocity))
    fooled = {"by chance": 0, "less what chance gives": 0}
    for seed in range(4):
        random = np.random.default_rng(seed)
        rows = [random.standard_normal((len(s.smooth[s.decimated]), CHANNELS)) for s in flown]
        for y in rows:
            y[:, POSE_ACCELERATION] += 2 * slow(random, y[:, POSE_ACCELERATION].shape, poles=(0.98,))
        columns = [np.ones((len(y), CHANNELS, 1)) for y in rows]
        of_all = regression(
            arpl_250g, [candidate(effect("a"), 0)], columns, rows, segments=tuple(flown), thresholds=FEW
        )
        fooled["by chance"] += "predictable_from_state" in fires(run_residual_tests(of_all, rows))
        estimated = dataclasses.replace(of_all, pose=PoseErrors(np.ones(CHANNELS), 0.2))
        fooled["less what chance gives"] += "predictable_from_state" in fires(run_residual_tests(estimated, rows))
    assert fooled["by chance"] >= 2
    assert fooled["less what chance gives"] == 0
    for y, segment in zip(rows, flown, strict=True):  # what does depend on it is found beside them
        y[:, 0] += np.abs(segment.smooth[segment.decimated, VELOCITY][:, 0])
    assert "predictable_from_state" in fires(run_residual_tests(estimated, rows))


def test_an_error_of_velocity_under_a_right_drag_is_no_function_of_the_state(arpl_250g):
    """It is force to the model and in the measured velocity, which predicts it."""
    drag, flown, rows = 2.5, [], []
    draws = [PerturbedResiduals([], []) for _ in range(4)]
    for i, still in enumerate(hovering(arpl_250g, mass_ratio=1.0, seed=0, count=7, duration=50.0)):
        random = np.random.default_rng(70 + i)
        true, error, *drawn = (
            size * slow(random, still.velocity.shape, poles=(0.98, 0.98)) for size in (0.5, *(0.25,) * 5)
        )
        flown.append(dataclasses.replace(still, velocity=true + error))
        rows.append(random.standard_normal((len(still.smooth[still.decimated]), CHANNELS)))
        rows[-1][:, :3] += drag * error[still.decimated]
        for draw, values in zip(draws, drawn, strict=True):
            draw.segments.append(dataclasses.replace(still, velocity=true + error + values))
            draw.added.append(np.hstack([drag * values[still.decimated], np.zeros((len(rows[-1]), CHANNELS - 3))]))
    columns = [np.ones((len(y), CHANNELS, 1)) for y in rows]
    of_all = regression(arpl_250g, [candidate(effect("a"), 0)], columns, rows, segments=tuple(flown), thresholds=FEW)
    estimated = dataclasses.replace(of_all, pose=PoseErrors(np.ones(CHANNELS), 0.2))
    assert "predictable_from_state" in fires(run_residual_tests(estimated, rows))
    assert "predictable_from_state" not in fires(run_residual_tests(estimated, rows, perturbed=lambda: draws))
    for y, segment in zip(rows, flown, strict=True):  # what does depend on it is found beside them
        y[:, 0] += 8 * np.abs(segment.velocity[segment.decimated][:, 0])
    assert "predictable_from_state" in fires(run_residual_tests(estimated, rows, perturbed=lambda: draws))
