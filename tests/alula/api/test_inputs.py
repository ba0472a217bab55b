"""Logs are paths, folders or patterns; flights and vehicles are taken as they are or read from files."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

import alula
from alula.api.inputs import log_paths
from dynamics.effect_source import read_effect_file


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("b.csv", "a.ulg", "flight.mcap", "flight.tlog", "other.tlog", "below/c.csv", "bag/metadata.yaml"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.touch()
    return tmp_path


def test_a_folder_is_every_log_below_it_and_a_recordings_tlog_is_no_flight_of_its_own(folder: Path) -> None:
    names = [str(path.relative_to(folder)) for path in log_paths(folder)]
    assert names == ["a.ulg", "b.csv", "bag", "below/c.csv", "flight.mcap", "other.tlog"]


def test_paths_keep_their_order_and_patterns_are_sorted(folder: Path) -> None:
    logs = log_paths([folder / "flight.tlog", str(folder / "*.csv"), str(folder / "[ab].*")])
    assert [path.name for path in logs] == ["flight.tlog", "b.csv", "a.ulg", "b.csv"]


@pytest.mark.parametrize("name", ["*.parquet", "empty"])
def test_a_place_without_logs_is_refused_by_its_name(folder: Path, name: str) -> None:
    (folder / "empty").mkdir()
    with pytest.raises(alula.RequestError, match=r"no log there\. Give logs, a folder of logs, or a pattern"):
        log_paths(folder / name)


def test_a_vehicle_is_read_by_name_or_path_and_errors_are_caught_as_alulas(tmp_path: Path) -> None:
    vehicle = alula.load_vehicle("arpl_250g")
    alula.write_vehicle(vehicle, tmp_path / "mine.toml")
    assert alula.load_vehicle(tmp_path / "mine.toml") == alula.load_vehicle(str(tmp_path / "mine.toml")) == vehicle
    with pytest.raises(alula.AlulaError):
        alula.load_vehicle("absent.toml")


def test_effects_of_ones_own_may_be_named_by_the_vehicle(tmp_path: Path) -> None:
    vehicle = alula.load_vehicle("arpl_250g").with_effects(alula.EffectUse("tether", {"stiffness": 0.1}))
    alula.write_vehicle(vehicle, tmp_path / "tethered.toml")
    effects = [Path(__file__).parents[3] / "examples" / "my_effects.py"]
    loaded = msgspec.structs.replace(vehicle, effect_files=(read_effect_file(effects[0]),))
    assert alula.load_vehicle(tmp_path / "tethered.toml", effect_files=effects) == loaded
    with pytest.raises(alula.RequestError, match="unknown effect 'tether'"):
        alula.load_vehicle(tmp_path / "tethered.toml")
