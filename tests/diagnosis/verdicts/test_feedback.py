"""A controller's answer to turbulence is no inertia: gentle flights, in which little else turns the vehicle."""

from diagnosis.data.dataset import read_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle_file import read_vehicle
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
