"""A controller's answer to turbulence is no inertia, and no function of the state that a model lacks."""

import pytest

from diagnosis.data.dataset import make_dataset, read_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from fixtures.compiled_flights import compiled_flights
from fixtures.mutated_flights import USUAL, with_columns
from fixtures.outside_cases import Campaign, flown, write_campaign
from fixtures.outside_sensors import Recorder


def test_the_answer_to_turbulence_is_not_named(tmp_path):
    """Below 1.5 Hz an inertia 1.46 times the file's fits these flights, by seven deviations; below 0.75 Hz none."""
    recorder = Recorder(100.0, noise=1.2058978854361704)
    campaign = Campaign({}, {}, recorder, lag_declared=False, fast=False, flights=9, seed=314211354)
    (truths,) = flown([campaign])
    write_campaign(campaign, truths, tmp_path)
    vehicle = read_vehicle(tmp_path / "vehicle.toml")
    dataset = read_dataset(sorted(tmp_path.glob("*.csv")), vehicle)
    diagnosis = diagnose_dataset(dataset, vehicle, CATALOGUE).diagnosis
    assert diagnosis.verdict == "explained"
    assert "inertia" in [one.name for one in diagnosis.refused]


def logged_without(vehicle, seed, quantities, uses=()):
    """Three flights that lack quantities of the pose."""
    flights = compiled_flights(vehicle, list(uses), catalogue=CATALOGUE, seed=seed, manoeuvres=tuple(USUAL))
    names = [name for name in flights[0].columns if name.rpartition("_")[0] in quantities]
    return make_dataset([with_columns(flight, dict.fromkeys(names)) for flight in flights], vehicle)


@pytest.mark.parametrize(
    ("seed", "quantities"),
    [(141, ("position", "velocity", "attitude")), (142, ("position", "velocity"))],
    ids=["no pose", "no velocity"],
)
def test_a_log_without_a_pose_that_hides_nothing_is_explained(arpl_250g, seed, quantities):
    """What is left of a torque goes with the rate, which is most of the state where no velocity was logged."""
    dataset = logged_without(arpl_250g, seed, quantities)
    diagnosis = diagnose_dataset(dataset, arpl_250g, CATALOGUE).diagnosis
    assert (diagnosis.verdict, diagnosis.leftover) == ("explained", ())


def test_a_damping_that_the_catalogue_lacks_is_left_over(arpl_250g):
    """The controller's answer to turbulence looks like a damping below zero, and a true one is not taken for it."""
    damping = EffectUse("rotational_damping", {"coefficient": 4e-3})
    dataset = logged_without(arpl_250g, 143, (), [damping])
    without = {name: effect for name, effect in CATALOGUE.items() if name != damping.name}
    diagnosis = diagnose_dataset(dataset, arpl_250g, without).diagnosis
    assert diagnosis.verdict == "unknown"
    assert "predictable_from_state" in {one.test for one in diagnosis.leftover}
