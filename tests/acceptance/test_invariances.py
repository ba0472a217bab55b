"""Answers that must not depend on how flights were written down: on files and the public interface alone.

A drag and a weak rotor are hidden in short flights with motion capture. Their answer is compared to that on the same
flights with the rotors in another order, the world turned, twice as many rows, and a flight cut in two.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest

import alula
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import write_vehicle
from fixtures.planted import planted_flights

MANOEUVRES = (
    "line:laps=3,ramp=1", "circle:laps=3,ramp=1,speed=1.2", "Lemniscate:laps=4,ramp=1.5,speed=0.9",
    "WarpedEllipse_2:laps=4,ramp=1.5,speed=0.8", "bob:laps=4,ramp=1,height=0.25",
)  # fmt: skip
HIDDEN = (EffectUse("linear_drag", {"coefficient": 0.1}), EffectUse("weak_rotor", {"loss": 0.08}, rotor=2))
ORDER = [2, 0, 3, 1]  # the rotor of the file that becomes rotor 0, 1, ...
TURN = 2.1  # rad about the vertical

Tables = list[pd.DataFrame]


@dataclass(frozen=True)
class Answer:
    """Verdict, and effect with the rotor it sits on, to parameters as (value, standard deviation)."""

    verdict: str
    effects: dict[tuple[str, int | None], dict[str, tuple[float, float]]]


def answer(tables: Tables, vehicle: Vehicle, folder: Path, order: list[int] | None = None) -> Answer:
    """Of the tables as CSV files. order: the rotor of the vehicle as flown that is rotor 0, 1, ... here."""
    folder.mkdir()
    write_vehicle(vehicle, folder / "vehicle.toml")
    paths = [folder / f"flight_{number}.csv" for number in range(len(tables))]
    for table, path in zip(tables, paths, strict=True):
        table.to_csv(path, index=False)
    report = alula.diagnose([str(path) for path in paths], str(folder / "vehicle.toml")).report
    effects = {}
    for effect in report.effects:
        rotor = effect.rotor if effect.rotor is None or order is None else order[effect.rotor]
        effects[effect.name, rotor] = {name: (one.value, one.std) for name, one in effect.parameters.items()}
    return Answer(report.verdict, effects)


def renamed_rotors(table: pd.DataFrame) -> pd.DataFrame:
    """The rotors' columns in another order."""
    changed = table.copy()
    for quantity in ("rotor_speed", "rotor_command"):
        for place, of_file in enumerate(ORDER):
            changed[f"{quantity}_{place}"] = table[f"{quantity}_{of_file}"]
    return changed


def turned(table: pd.DataFrame) -> pd.DataFrame:
    """Positions, velocities and attitudes of a world turned about the vertical; setpoints left out."""
    changed = table.drop(columns=[name for name in table if "setpoint" in str(name)])
    cosine, sine = np.cos(TURN), np.sin(TURN)
    for quantity in ("position", "velocity"):
        x, y = table[f"{quantity}_x"], table[f"{quantity}_y"]
        changed[f"{quantity}_x"], changed[f"{quantity}_y"] = cosine * x - sine * y, sine * x + cosine * y
    half_cosine, half_sine = np.cos(TURN / 2), np.sin(TURN / 2)
    w, x, y, z = (table[f"attitude_{axis}"] for axis in "wxyz")
    changed["attitude_w"], changed["attitude_z"] = half_cosine * w - half_sine * z, half_cosine * z + half_sine * w
    changed["attitude_x"], changed["attitude_y"] = half_cosine * x - half_sine * y, half_cosine * y + half_sine * x
    return changed


def halves(tables: Tables) -> Tables:
    """The third flight cut in two."""
    cut = len(tables[2]) // 2
    return [*tables[:2], tables[2][:cut], tables[2][cut:], *tables[3:]]


def doubled(table: pd.DataFrame) -> pd.DataFrame:
    """A row between all rows, halfway."""
    time = np.arange(2 * len(table) - 1) / 2
    return pd.DataFrame({name: np.interp(time, np.arange(len(table)), values) for name, values in table.items()})


@pytest.fixture(scope="module")
def tables(arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Tables:
    folder = tmp_path_factory.mktemp("as flown")
    flights = planted_flights(arpl_250g, HIDDEN, seed=41, manoeuvres=MANOEUVRES)
    return [pd.read_csv(flight.to_csv(folder / f"{number}.csv")) for number, flight in enumerate(flights)]


@pytest.fixture(scope="module")
def as_flown(tables: Tables, arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Answer:
    return answer(tables, arpl_250g, tmp_path_factory.mktemp("answers") / "as_flown")


def require_same(answered: Answer, as_flown: Answer, *, stds: float) -> None:
    """The same verdict and names, values within so many of their standard deviations."""
    assert answered.verdict == as_flown.verdict
    assert answered.effects.keys() == as_flown.effects.keys()
    for effect, parameters in as_flown.effects.items():
        for name, (value, std) in parameters.items():
            assert abs(answered.effects[effect][name][0] - value) <= stds * std + 1e-9, (effect, name)


@pytest.mark.long("five flights, and a diagnosis of two effects")
def test_both_hidden_effects_are_named(as_flown: Answer) -> None:
    assert set(as_flown.effects) == {("linear_drag", None), ("weak_rotor", 2)}


def test_the_order_of_the_rotors_does_not_matter(
    tables: Tables, as_flown: Answer, arpl_250g: Vehicle, tmp_path: Path
) -> None:
    rotors = arpl_250g.rotors
    changed = msgspec.structs.replace(
        rotors,
        position=tuple(rotors.position[place] for place in ORDER),
        spin=tuple(rotors.spin[place] for place in ORDER),
    )
    vehicle = msgspec.structs.replace(arpl_250g, rotors=changed)
    answered = answer([renamed_rotors(table) for table in tables], vehicle, tmp_path / "renamed", ORDER)
    require_same(answered, as_flown, stds=0.1)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda tables: [turned(table) for table in tables], id="the world turned"),
        pytest.param(lambda tables: [doubled(table) for table in tables], id="twice the rate", marks=pytest.mark.slow),
        pytest.param(halves, id="a flight cut in two", marks=pytest.mark.slow),
    ],
)
def test_how_flights_are_written_down_does_not_matter(
    tables: Tables, as_flown: Answer, arpl_250g: Vehicle, tmp_path: Path, change: Callable[[Tables], Tables]
) -> None:
    """Values may move by what the noise model makes of other rows, which is less than they are known to."""
    require_same(answer(change(tables), arpl_250g, tmp_path / "changed"), as_flown, stds=1.0)
