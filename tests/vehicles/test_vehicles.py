"""Vehicle files by name."""

from pathlib import Path

from vehicles import FOLDER, vehicle_path


def test_a_vehicle_that_comes_along_is_found_by_its_name():
    assert vehicle_path("arpl_250g") == FOLDER / "arpl_250g.toml"


def test_anything_else_is_taken_as_a_path(tmp_path, monkeypatch):
    assert vehicle_path("mine.toml") == Path("mine.toml")
    assert vehicle_path("folder/arpl_250g") == Path("folder/arpl_250g")
    monkeypatch.chdir(tmp_path)
    Path("arpl_250g").touch()
    assert vehicle_path("arpl_250g") == Path("arpl_250g")
