"""Whoever misspells a name is told the nearest one that exists."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynamics.errors import AlulaError
from dynamics.references.campaign import chosen_flights
from dynamics.vehicle_file import read_vehicle, write_vehicle
from export.trained import read_model
from flights.flight import Flight
from runtime.control.rti.processor import named_processor
from studies.sweep.run import _require_field
from training.models import named_kind
from training.overrides import overridden
from training.recipe import FAST, Recipe, named_recipe
from vehicles import FOLDER


def test_a_vehicle_is_sought_among_the_bundled_ones_and_the_files_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_vehicle(read_vehicle(FOLDER / "arpl_250g.toml"), tmp_path / "my_quad.toml")
    for wrong, right in (
        ("my_qaud", "my_quad.toml"),
        ("my_qaud.toml", "my_quad.toml"),
        (str(tmp_path / "my_qaud.toml"), str(tmp_path / "my_quad.toml")),
        ("arpl_25g", "arpl_250g"),
        ("px4-sih", "px4_sih"),
        ("crazyfly.toml", "crazyflie"),
    ):
        for read in (read_vehicle, read_model):
            with pytest.raises(AlulaError, match=r"did you mean") as caught:
                read(Path(wrong))
            assert f"did you mean {right!r}?" in str(caught.value)
            assert "Errno" not in str(caught.value)


@pytest.mark.parametrize(
    ("ask", "right"),
    [
        (lambda: named_kind("pitcn"), "pi_tcn"),
        (lambda: named_kind("greybox"), "grey_box"),
        (lambda: named_recipe("papr"), "paper"),
        (lambda: overridden(FAST, {"stepps": 3}), "steps"),
        (lambda: named_processor("avx_512"), "avx512"),
        (lambda: _require_field("optimizer", Recipe), "optimiser"),
        (lambda: chosen_flights((), ["tset"]), "test"),
        (lambda: Flight._quantity("specific_forse_x"), "specific_force_x"),
    ],
)  # fmt: skip
def test_other_names_likewise(ask: object, right: str) -> None:
    with pytest.raises(AlulaError) as caught:
        ask()  # type: ignore[operator]
    assert f"did you mean {right!r}?" in str(caught.value)
    assert "Known: " in str(caught.value)
