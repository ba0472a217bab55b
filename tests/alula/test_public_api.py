"""`import alula` stays light; every public name is imported when it is used."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import alula
import flights
from alula.rooms import ROOMS, ROOT
from tests.support.flight_files import flight_csv, manoeuvre


def test_importing_alula_brings_neither_another_room_nor_a_library() -> None:
    libraries = ("numpy", "casadi", "msgspec", "pyarrow", "pymavlink", "scipy", "torch")
    script = f"import sys, alula; dir(alula); print([name for name in {(*ROOMS, *libraries)} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=250)
    assert done.stdout.strip() == "[]"


HEAVY = ("scipy.signal", "scipy.stats", "scipy.optimize", "scipy.interpolate", "scipy.ndimage", "torch")
PRINT_HEAVY = f"; import sys; print([name for name in {HEAVY} if name in sys.modules])"


@pytest.mark.parametrize(
    "script",
    [
        "import diagnosis.diagnose, diagnosis.completion, diagnosis.hover_trim, diagnosis.vehicle_from_logs",
        "import simulation.lockstep, studies.fleet.summary, studio.app.server",
        "import alula; assert len(alula.read_flight({log!r})) > 500",
    ],
)
def test_the_heavy_parts_of_libraries_load_where_they_are_used(script: str, tmp_path: Path) -> None:
    """scipy.signal alone, with what it brings, is as much as all else that reading a flight loads."""
    log = str(flight_csv(manoeuvre(), tmp_path / "flight.csv"))
    script = script.format(log=log) + PRINT_HEAVY
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=250)
    assert done.stdout.strip() == "[]"


def test_the_public_names_are_those_of_their_rooms() -> None:
    assert alula.Flight is flights.Flight
    assert alula.read_log is flights.read_log
    with pytest.raises(AttributeError, match="no attribute 'Fligth'"):
        alula.Fligth  # noqa: B018


def test_every_public_name_is_listed_and_there() -> None:
    assert set(alula.__all__) <= set(dir(alula))
    for name in alula.__all__:
        assert getattr(alula, name) is not None


def test_every_package_that_is_installed_is_a_room_of_ours() -> None:
    with (Path(ROOT) / "pyproject.toml").open("rb") as file:
        packages = tomllib.load(file)["tool"]["setuptools"]["packages"]["find"]["include"]
    assert {name.removesuffix("*") for name in packages} == {"alula", *ROOMS}
