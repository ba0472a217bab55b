"""An estimator's slow errors are measured by its position, and held-out errors are judged without them."""

import dataclasses

import msgspec
import numpy as np
import pytest

import alula
from diagnosis.by_likelihood import noise_of
from diagnosis.data.dataset import make_dataset
from diagnosis.estimation.held_out import HeldOut
from diagnosis.models.pose_errors import velocity_disagreement, velocity_error
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.outside_cases import Campaign, write_campaign
from fixtures.outside_cases import flown as flights_of
from fixtures.outside_sensors import Recorder
from tests.diagnosis.synthetic import hovering

LIMITS = DEFAULT.pose


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
    vehicle = alula.load_vehicle(folder / "vehicle.toml")
    dataset = make_dataset([alula.read_flight(log) for log in sorted(folder.glob("*.ulg"))], vehicle)
    judge = HeldOut(noise_of(dataset, vehicle, CATALOGUE), dataset.held_out)
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


@pytest.mark.slow
def test_a_drag_shows_through_an_estimators_error_of_velocity(estimated_flights):
    folder, true = estimated_flights
    diagnosis = alula.diagnose(sorted(map(str, folder.glob("*.ulg"))), str(folder / "vehicle.toml"))
    (drag,) = diagnosis.report.effects
    assert drag.name == "linear_drag"
    value = drag.parameters["coefficient"]
    assert value.value == pytest.approx(true, abs=2.5 * value.std)
    assert value.std < 0.2 * true
