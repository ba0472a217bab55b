"""An estimator's slow errors are noise in the residuals; motion capture's residuals stay as they are."""

import dataclasses

import msgspec
import numpy as np
import pytest
from scipy.signal import lfilter, welch

import alula
from diagnosis.data.dataset import make_dataset
from diagnosis.estimation.evaluation import residuals_in
from diagnosis.estimation.held_out import HeldOut
from diagnosis.models.pose_errors import NO_ERRORS, PoseErrors, pose_errors, velocity_disagreement, velocity_error
from diagnosis.models.predictor import Predictor
from diagnosis.selection.noise import estimate_noise, noise_floor
from diagnosis.selection.regression_of_flights import make_regression
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.outside_cases import Campaign, write_campaign
from fixtures.outside_cases import flown as flights_of
from fixtures.outside_sensors import Recorder
from tests.diagnosis.set_fits import fitted_on
from tests.diagnosis.synthetic import hovering

RATE = 25.0
LIMITS = DEFAULT.pose
FORCE, POSE = 0, 3  # channels: x of the accelerometer and of the pose
# an error of velocity acts on the accelerometer alone, along x, 1 m/s^2 for 1 m/s
DRAG = PoseErrors(np.eye(12)[FORCE], LIMITS.velocity_error)


def slow(random: np.random.Generator, rows: int) -> np.ndarray:
    """An error of velocity as the thresholds have it, m/s."""
    shares = [np.exp(-1 / (RATE * time)) for time in (LIMITS.velocity_time, LIMITS.smooth_time)]
    error = random.standard_normal(rows + 1000)
    for share in shares:
        error = lfilter([1.0], [1.0, -share], error)
    error = error[1000:]
    return LIMITS.velocity_error * error / error.std()


def of_an_estimator(seed: int) -> list[np.ndarray]:
    random = np.random.default_rng(seed)
    rows = [0.05 * random.standard_normal((2000, 12)) for _ in range(2)]
    for y in rows:
        y[:, FORCE] += slow(random, len(y))
    return rows


def test_the_density_of_an_error_integrates_to_its_variance():
    frequency = np.linspace(-40, 40, 400_001)
    density = DRAG.density(frequency)
    step = frequency[1] - frequency[0]
    assert density[FORCE].sum() * step == pytest.approx(LIMITS.velocity_error**2, rel=0.01)
    slope = LIMITS.velocity_error**2 / (LIMITS.velocity_time * LIMITS.smooth_time)
    tilt = (9.81 * LIMITS.tilt_error) ** 2
    assert density[POSE].sum() * step == pytest.approx(slope + tilt, rel=0.02)
    assert NO_ERRORS.density(frequency).max() == 0.0


def test_an_estimators_slow_error_is_whitened_and_one_of_motion_capture_is_not():
    rows = of_an_estimator(0)
    allowed = estimate_noise(rows, RATE, range(12), pose=DRAG)
    refused = estimate_noise(rows, RATE, range(12))
    assert np.var(np.vstack([allowed.whiten(r) for r in rows])[:, FORCE]) == pytest.approx(1.0, abs=0.15)
    assert np.var(np.vstack([refused.whiten(r) for r in rows])[:, FORCE]) > 2.0
    floors = [noise_floor(rows, RATE, range(12), pose=errors)[FORCE] for errors in (DRAG, NO_ERRORS)]
    assert floors[0] == pytest.approx(np.vstack(rows)[:, FORCE].std(), rel=0.1)
    assert floors[1] < 0.1


def test_more_than_an_estimators_error_stays_in_the_whitened_residual():
    rows = of_an_estimator(1)
    for y in rows:
        y[:, FORCE] *= 5
    noise = estimate_noise(rows, RATE, range(12), pose=DRAG)
    assert np.var(np.vstack([noise.whiten(r) for r in rows])[:, FORCE]) > 1.5


def test_an_accelerometer_and_the_pose_made_from_it_count_once():
    random = np.random.default_rng(2)
    rows = [random.standard_normal((3000, 12))]
    rows[0][:, POSE] = rows[0][:, FORCE]
    noise = estimate_noise(rows, RATE, range(12), pose=DRAG)
    column = np.zeros((3000, 12, 1))
    column[:, [FORCE, POSE], 0] = random.standard_normal((3000, 1))
    alone = np.zeros_like(column)
    alone[:, FORCE] = column[:, FORCE]
    independent = estimate_noise([random.standard_normal((3000, 12))], RATE, range(12), pose=DRAG)
    both, one = (np.sum(of.whiten(signal) ** 2) for of, signal in ((noise, column), (independent, alone)))
    assert both == pytest.approx(one, rel=0.1)


def test_the_model_tells_how_an_error_of_velocity_acts(arpl_250g):
    (segment,) = hovering(arpl_250g, mass_ratio=1.0, seed=0)
    use = EffectUse("linear_drag", {"coefficient": 0.5})
    predictor = Predictor(arpl_250g, [use], CATALOGUE, speed_measured=True)
    assert pose_errors([segment], predictor) is NO_ERRORS
    assert pose_errors([dataclasses.replace(segment, pose_source="motion_capture")], predictor) is NO_ERRORS
    errors = pose_errors([dataclasses.replace(segment, pose_source="estimator")], predictor)
    assert errors.slopes[FORCE] == pytest.approx(0.5 / arpl_250g.body.mass, rel=1e-3)
    assert errors.slopes[6:9].max() < 1e-6


def flown(vehicle, error):
    """A segment that moves, its velocity with an error (n, 3) m/s that the position does not have."""
    (still,) = hovering(vehicle, mass_ratio=1.0, seed=0, duration=60.0)
    time = np.arange(len(still)) / still.rate
    position = np.column_stack([np.sin(time), np.cos(0.7 * time), 0.2 * np.sin(1.3 * time)])
    velocity = np.gradient(position, 1 / still.rate, axis=0) + error(still)
    return dataclasses.replace(still, position=position, velocity=velocity, lacks=frozenset(), pose_source="estimator")


def test_the_velocitys_error_is_measured_by_the_position(arpl_250g):
    exact = flown(arpl_250g, lambda segment: 0.0)
    assert velocity_disagreement(exact) < 0.005
    small = msgspec.structs.replace(LIMITS, velocity_error=0.1)
    unplaced = dataclasses.replace(exact, lacks=frozenset({"position"}))
    wrong = flown(arpl_250g, lambda segment: velocity_error(unplaced, np.random.default_rng(1), small))
    assert velocity_disagreement(wrong) == pytest.approx(0.1, rel=0.3)
    far = flown(arpl_250g, lambda segment: 5.0)
    assert velocity_disagreement(far) == LIMITS.velocity_error
    assert velocity_disagreement(unplaced) == LIMITS.velocity_error


@pytest.fixture(scope="module")
def estimated_flights(tmp_path_factory):
    """Slow flights of a vehicle of the outside simulator as PX4 logs them, with twice the drag of its file."""
    folder = tmp_path_factory.mktemp("estimated")
    alone = Campaign({}, {}, Recorder(250.0, commands=True, pose="estimator"), True, False, flights=9, seed=21)
    hidden, declared = ({"linear_drag": {"coefficient": ratio * alone.frame.mass}} for ratio in (1.0, 0.5))
    campaign = dataclasses.replace(alone, hidden=hidden, declared=declared)
    (truths,) = flights_of([campaign])
    write_campaign(campaign, truths, folder)
    return folder, hidden["linear_drag"]["coefficient"]


@pytest.mark.slow
def test_held_out_errors_are_judged_without_the_poses(estimated_flights):
    folder, true = estimated_flights
    vehicle, dataset, regression = regression_of(folder)
    judge = HeldOut(regression, dataset.held_out)
    right, none = (
        msgspec.structs.replace(vehicle, effects=(*others, *drag))
        for others in [tuple(use for use in vehicle.effects if use.name != "linear_drag")]
        for drag in ((EffectUse("linear_drag", {"coefficient": true}),), ())
    )
    floor = judge.floor(right)
    corrected = judge.channel_changes(none, right, floor)["imu"]
    measured = {
        name: np.sqrt(np.mean(np.sum(np.vstack(judge.rows(which))[:, :3] ** 2, axis=1)))
        for name, which in (("right", right), ("none", none))
    }
    assert corrected.after < 0.98 * measured["right"]
    assert corrected.before == pytest.approx(measured["none"], rel=0.01)  # without a drag it is no force
    assert judge.improvement(none, right) > 2.0
    assert judge.improvement(right, none) < -2.0


def regression_of(folder):
    """The vehicle, the data set and the regression of a folder's flights."""
    vehicle = alula.load_vehicle(folder / "vehicle.toml")
    dataset = make_dataset([alula.read_flight(log) for log in sorted(folder.glob("*.ulg"))], vehicle)
    return vehicle, dataset, make_regression(vehicle, CATALOGUE, dataset.fitted, dataset.flight_of)


@pytest.mark.slow
def test_a_gyros_noise_does_not_explain_itself_in_the_attitudes_rate(estimated_flights):
    """Columns of its scale and its delays are made of it, and beside each other they would leave nothing of it."""
    folder, _ = estimated_flights
    vehicle, dataset, regression = regression_of(folder)
    rows = residuals_in(regression, fitted_on(dataset, vehicle, CATALOGUE).vehicle, regression.segments)
    rates = np.vstack([regression.noise.whiten(y) for y in rows])[:, 9:]
    assert np.mean(rates**2, axis=0) == pytest.approx(np.ones(3), abs=0.5)  # 2 to 6 where it does
    for axis in rates.T:  # as dense at the frequencies of noise as at those of motion
        frequency, density = welch(axis, regression.rate, nperseg=128)
        assert density[frequency > 5].max() * regression.rate / 2 < 4.0  # 8 to 16


@pytest.mark.slow
def test_a_drag_shows_through_an_estimators_error_of_velocity(estimated_flights):
    folder, true = estimated_flights
    diagnosis = alula.diagnose(sorted(map(str, folder.glob("*.ulg"))), str(folder / "vehicle.toml"))
    (drag,) = diagnosis.report.effects
    assert drag.name == "linear_drag"
    value = drag.parameters["coefficient"]
    assert value.value == pytest.approx(true, abs=2.5 * value.std)
    assert value.std < 0.2 * true
