"""Which flights are learned from: test flights never, each flight once, and what cannot be used by name."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from dynamics.errors import DataError, RequestError
from flights import Flight
from training.data.logged_flights import LoggedFlight, find_logs, left_out, read_logged_flights, split_flights


def test_a_campaigns_folder_stands_for_its_training_flights(tmp_path: Path) -> None:
    for name in ("train/b.parquet", "train/a.parquet", "test/Lemniscate.parquet", "truth/a.parquet", "campaign.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert [path.name for path in find_logs([tmp_path])] == ["a.parquet", "b.parquet"]
    assert [path.name for path in find_logs([tmp_path / "test"])] == ["Lemniscate.parquet"]
    (tmp_path / "nothing").mkdir()
    with pytest.raises(RequestError, match="holds no logs"):
        find_logs([tmp_path / "nothing"])


def test_test_flights_among_the_training_files_are_refused(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "flight_0.parquet", tmp_path / "TransposedParabola.parquet")
    with pytest.raises(RequestError, match=r"TransposedParabola.parquet: test flights of the campaign"):
        read_logged_flights([folder / "flight_1.parquet", tmp_path / "TransposedParabola.parquet"], dt=0.01)
    (again,) = read_logged_flights([tmp_path / "TransposedParabola.parquet"], dt=0.01, may_be_tests=True)
    assert again.rows > 500


def test_a_renamed_copy_of_a_test_flight_is_refused_as_it_says_itself_what_it_is(
    flights: Sequence[Flight], folder: Path, tmp_path: Path
) -> None:
    flight = flights[0]
    flown = dataclasses.replace(flight.provenance, path="test/Lemniscate", reader="alula.lockstep")
    Flight(flight.time, flight.columns, flown).to_parquet(tmp_path / "flight_7.parquet")
    with pytest.raises(RequestError, match=r"flight_7.parquet is a copy of the campaign's test flight Lemniscate"):
        read_logged_flights([folder / "flight_1.parquet", tmp_path / "flight_7.parquet"], dt=0.01)


def test_a_renamed_copy_of_a_test_flight_is_refused_by_what_it_holds(flights: Sequence[Flight], tmp_path: Path) -> None:
    for name in ("train", "test"):
        (tmp_path / name).mkdir()
    (tmp_path / "campaign.json").write_text("{}")
    flights[0].to_csv(tmp_path / "test" / "Lemniscate.csv")
    flights[1].to_csv(tmp_path / "train" / "circle_xy_60.csv")
    shutil.copy(tmp_path / "test" / "Lemniscate.csv", tmp_path / "train" / "extra.csv")
    with pytest.raises(RequestError, match=r"extra.csv is a copy of the campaign's test flight Lemniscate"):
        read_logged_flights(find_logs([tmp_path]), dt=0.01)


def test_flights_of_the_same_name_in_two_folders_stay_two_flights(folder: Path, tmp_path: Path) -> None:
    """A card holds flights by name, and whoever evaluates is refused all of them."""
    paths = []
    for place, name in enumerate(("one", "two")):
        (tmp_path / name).mkdir()
        paths.append(Path(shutil.copy(folder / f"flight_{place}.parquet", tmp_path / name / "log.parquet")))
    flights = read_logged_flights([*paths, folder / "flight_3.parquet"], dt=0.01)
    assert [r.name for r in flights] == [str(paths[0]), str(paths[1]), "flight_3.parquet"]
    assert [r.name for r in split_flights(flights, validation="*two/*").validation] == [str(paths[1])]
    assert len(split_flights(flights, validation="log*").validation) == 2


def test_a_flight_given_twice_is_refused(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "flight_0.parquet", tmp_path / "again.parquet")
    with pytest.raises(RequestError, match=r"again.parquet and flight_0.parquet are the same flight"):
        read_logged_flights([folder / "flight_0.parquet", tmp_path / "again.parquet"], dt=0.01)


def test_every_tenth_flight_validates_and_at_least_one(recordings: Sequence[LoggedFlight]) -> None:
    split = split_flights(recordings)
    assert [r.name for r in split.validation] == ["flight_2.parquet"]
    assert [r.name for r in split.training] == ["flight_0.parquet", "flight_1.parquet", "flight_3.parquet"]
    many = [LoggedFlight(f"{place}.csv", str(place), recordings[0].segments) for place in range(40)]
    assert [r.name for r in split_flights(many).validation] == ["5.csv", "15.csv", "25.csv", "35.csv"]


def test_patterns_choose_what_validates_and_what_is_not_looked_at(recordings: Sequence[LoggedFlight]) -> None:
    split = split_flights(recordings, validation="flight_0*", hold_out="flight_3*")
    assert [r.name for r in split.training] == ["flight_1.parquet", "flight_2.parquet"]
    assert [r.name for r in split.validation] == ["flight_0.parquet"]
    assert split.notes == ("held out, not looked at: flight_3.parquet",)
    with pytest.raises(RequestError, match=r"--validation 'x\*' matches none of flight_0.parquet"):
        split_flights(recordings, validation="x*")
    with pytest.raises(RequestError, match=r"--hold-out 'flight\*' matches all"):
        split_flights(recordings, hold_out="flight*")


def test_of_one_flight_the_last_fifth_validates_and_a_note_says_so(recordings: Sequence[LoggedFlight]) -> None:
    split = split_flights(recordings[:1])
    (learned,), (judged,) = split.training, split.validation
    assert judged.rows == pytest.approx(0.2 * recordings[0].rows, abs=1)
    assert learned.segments[-1].time[-1] < judged.segments[0].time[0]
    assert "one flight only" in split.notes[0]


def test_a_log_without_free_flight_is_named(flights: Sequence[Flight], tmp_path: Path) -> None:
    flight = flights[0]
    disarmed = {**flight.columns, "armed": np.zeros(len(flight))}
    path = Flight(flight.time, disarmed, flight.provenance).to_parquet(tmp_path / "still.parquet")
    with pytest.raises(DataError, match=r"still.parquet: nowhere 1 s of free flight"):
        read_logged_flights([path], dt=0.01)


def test_a_log_that_nothing_is_learned_from_is_noted(flights: Sequence[Flight], folder: Path, tmp_path: Path) -> None:
    flight = flights[0]
    holes = flight["rate_x"].copy()
    holes[::15] = np.nan
    torn = Flight(flight.time, {**flight.columns, "rate_x": holes}, flight.provenance)
    paths = [torn.to_parquet(tmp_path / "torn.parquet"), folder / "flight_1.parquet"]
    flights = read_logged_flights(paths, dt=0.01)
    assert left_out(paths, flights) == ("left out, nowhere 1 s of free flight without a gap: torn.parquet",)
    assert left_out(paths[1:], flights) == ()
