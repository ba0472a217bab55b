"""The campaign: same seed, same bits; whole flights only; it resumes where it was killed; wrong requests are named."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.errors import AlulaError, RequestError
from dynamics.references import PAPER, named_reference
from dynamics.references.campaign import PAPER_DURATION, CampaignFlight, chosen_flights, paper_campaign
from dynamics.vehicle_file import read_vehicle
from flights import Flight
from simulation.campaign import Campaign, CampaignManifest, CampaignOptions
from simulation.campaign_flight import FlightSummary

SHORT = (
    CampaignFlight("small_circle", "circle:size=0.3,laps=1,ramp=1.0,speed=1.5", "train"),
    CampaignFlight("short_bob", "bob:size=0.4,laps=1,ramp=1.0", "train"),
    CampaignFlight("quick_lap", "Ellipse_2:laps=2,ramp=1.0", "test"),
)


def fly(folder: Path, **options: object) -> tuple[CampaignManifest, list[FlightSummary]]:
    summaries: list[FlightSummary] = []
    manifest = Campaign(CampaignOptions(folder, jobs=1, **options), SHORT).run(summaries.append)  # type: ignore[arg-type]
    return manifest, summaries


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CampaignManifest]:
    folder = tmp_path_factory.mktemp("campaign")
    manifest, _ = fly(folder, seed=5)
    return folder, manifest


def test_the_papers_campaign_is_68_flights_of_58_minutes_8_of_them_for_the_test() -> None:
    flights = paper_campaign()
    vehicle = read_vehicle("vehicles/arpl_250g.toml")
    assert len({flight.name for flight in flights}) == len({flight.reference for flight in flights}) == 68
    assert [flight.name for flight in flights if flight.split == "test"] == list(PAPER)
    duration = sum(named_reference(flight.reference, vehicle).duration for flight in flights)
    assert duration == pytest.approx(PAPER_DURATION, abs=30.0)


def test_a_flight_holds_what_was_measured_and_its_truth_row_by_row(flown: tuple[Path, CampaignManifest]) -> None:
    folder, manifest = flown
    flight = Flight.read(folder / "test" / "quick_lap.parquet")
    truth = Flight.read(folder / "truth" / "quick_lap.parquet")
    assert flight.rate == pytest.approx(100.0)
    assert np.array_equal(flight.time, truth.time)
    expected = ("position", "velocity", "attitude", "rate", "specific_force", "rotor_speed", "position_setpoint")
    assert flight.has(*expected, "rotor_command", "battery_voltage")
    assert not any(np.isnan(flight[name]).any() for name in expected)
    for name, maximum in (("position", 0.02), ("velocity", 0.05), ("rate", 0.05), ("rotor_speed", 6.0)):
        error = flight[name] - truth[name]
        assert 0 < np.sqrt(np.mean(error**2)) < maximum, name
    summary = next(item for item in manifest.flights if item.name == "quick_lap")
    assert summary.position_rmse < 0.1
    assert summary.duration == pytest.approx(len(flight) * 0.01)
    assert set(manifest.sha256) == {f"{place}/{item.name}.parquet" for item in SHORT for place in (item.split, "truth")}


def test_one_seed_gives_the_same_bits_and_another_seed_others(
    flown: tuple[Path, CampaignManifest], tmp_path: Path
) -> None:
    _, manifest = flown
    again, _ = fly(tmp_path / "again", seed=5, flights=("test",))
    other, _ = fly(tmp_path / "other", seed=6, flights=("test",))
    for file, digest in again.sha256.items():
        assert manifest.sha256[file] == digest
        assert other.sha256[file] != digest


def test_what_is_flown_in_two_processes_is_what_is_flown_in_one(
    flown: tuple[Path, CampaignManifest], tmp_path: Path
) -> None:
    options = CampaignOptions(tmp_path, seed=5, jobs=2)
    assert Campaign(options, SHORT).run(lambda _: None).sha256 == flown[1].sha256


@pytest.mark.realtime(repeats_only=True)  # repeated where it was starved; it bears company
def test_it_resumes_after_it_was_killed(flown: tuple[Path, CampaignManifest], tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from simulation.campaign import Campaign, CampaignOptions;"
        "from tests.simulation.test_campaign import SHORT;"
        "Campaign(CampaignOptions(Path(sys.argv[1]), seed=5, jobs=1), SHORT).run(lambda s: None)"
    )
    first = tmp_path / "train" / "small_circle.parquet"
    with subprocess.Popen([sys.executable, "-c", script, str(tmp_path)]) as process:
        deadline = time.monotonic() + 250
        while not first.exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
    assert first.exists()
    assert not (tmp_path / "manifest.json").exists()
    before = first.stat().st_mtime_ns
    manifest, summaries = fly(tmp_path, seed=5)
    assert [item.name for item in summaries] == [flight.name for flight in SHORT]
    assert first.stat().st_mtime_ns == before
    assert manifest.sha256 == flown[1].sha256


def test_another_request_for_the_same_folder_is_refused_by_what_differs(flown: tuple[Path, CampaignManifest]) -> None:
    folder, _ = flown
    with pytest.raises(RequestError, match="another campaign: its effects, seed differ"):
        fly(folder, seed=1, effects=("rotor_drag:coefficient=1e-5",))


def test_without_effects_the_nominal_model_is_what_flies(tmp_path: Path) -> None:
    manifest, _ = fly(tmp_path, effects=(), flights=("quick_lap",))
    assert manifest.recipe.effects == ()


def test_csv_instead_of_parquet_reads_as_the_same_flight(flown: tuple[Path, CampaignManifest], tmp_path: Path) -> None:
    fly(tmp_path, seed=5, flights=("quick_lap",), csv=True)
    text = Flight.read(tmp_path / "test" / "quick_lap.csv")
    table = Flight.read(flown[0] / "test" / "quick_lap.parquet")
    assert text.quantities == table.quantities
    assert all(np.array_equal(text[name], table[name], equal_nan=True) for name in table.quantities)


def test_flights_are_chosen_by_name_pattern_and_split() -> None:
    assert [flight.name for flight in chosen_flights(SHORT, ["test", "s*_bob"])] == ["short_bob", "quick_lap"]
    with pytest.raises(RequestError, match="no flight of the campaign is called 'Elipse'"):
        chosen_flights(SHORT, ["Elipse"])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vehicle": "no_such.toml"}, "there is no vehicle file"),
        ({"effects": ("rotor_drug",)}, "rotor_drug"),
        ({"scenario": Path("no_such.toml")}, "cannot read the scenario"),
    ],
)
def test_a_wrong_request_is_refused_before_anything_flies(
    options: dict[str, object], message: str, tmp_path: Path
) -> None:
    with pytest.raises(AlulaError, match=message):
        fly(tmp_path / "none", **options)
    assert not (tmp_path / "none").exists()


def test_a_scenario_with_faults_of_a_link_is_refused(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.toml"
    scenario.write_text("[parameters]\nMPC_THR_HOVER = 0.4\n")
    with pytest.raises(RequestError, match="need a link"):
        fly(tmp_path / "out", scenario=scenario)


def test_sensors_and_effects_come_from_a_scenario(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.toml"
    scenario.write_text("[sensors]\nposition = 0.0\nvelocity = 0.0\n[[effects]]\nname = 'rotor_drag'\n")
    manifest, _ = fly(tmp_path / "out", scenario=scenario, flights=("quick_lap",))
    assert manifest.recipe.effects[0].startswith("rotor_drag")
    flight = Flight.read(tmp_path / "out" / "test" / "quick_lap.parquet")
    truth = Flight.read(tmp_path / "out" / "truth" / "quick_lap.parquet")
    assert np.abs(flight["velocity"] - truth["velocity"]).max() < 1e-9


def test_the_manifest_lies_in_the_folder(flown: tuple[Path, CampaignManifest]) -> None:
    folder, manifest = flown
    assert msgspec.json.decode((folder / "manifest.json").read_bytes(), type=CampaignManifest) == manifest
