"""A model that errs more than the nominal one is not offered for flight."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from rich.console import Console

from alula.cli.evaluate import _following
from alula.cli.train import _print_advice
from training.card import Card, FlightError
from training.recipe import FAST


def card(*pairs: tuple[int, float, float]) -> Card:
    """A card with the rows, the error and the nominal model's error of each flight."""
    errors = tuple(
        FlightError(f"{i}.csv", rows, own, own, own, nominal) for i, (rows, own, nominal) in enumerate(pairs)
    )
    return Card("pi_tcn", "", "", FAST, {}, {}, "arpl_250g", "", errors=errors)


def test_the_error_of_all_flights_is_compared_with_the_nominal_models() -> None:
    assert card((100, 3.9, 1.0)).of_nominal == pytest.approx(3.9)
    assert card((100, 1.0, 2.0), (300, 2.0, 2.0)).of_nominal == pytest.approx(math.sqrt(1300 / 1600))
    assert math.isnan(card().of_nominal)


@pytest.mark.parametrize(
    ("of_nominal", "following"),
    [
        (0.3, "alula export m.pt --out m"),
        (math.nan, "alula export m.pt --out m"),
        (3.9, "alula diagnose logs --vehicle v.toml"),
    ],
)
def test_training_offers_no_export_of_a_model_that_is_worse_than_nominal(
    of_nominal: float, following: str, capsys: pytest.CaptureFixture[str]
) -> None:
    _print_advice(of_nominal, [Path("logs")], "v.toml", Path("m.pt"), Console(width=200))
    printed = capsys.readouterr().out
    assert printed.splitlines()[-1] == f"next: {following}"
    assert ("not to be flown" in printed) == (of_nominal >= 1)


def test_evaluation_offers_the_first_model_that_is_better_than_nominal() -> None:
    models, logs = [Path("a.pt"), Path("b.pt")], [Path("logs")]
    assert _following(models, logs, "v.toml", [3.9, 0.4])[:2] == ["export", Path("b.pt")]
    assert _following(models, logs, "v.toml", [3.9, 1.2])[0] == "train"
    assert _following([], logs, "v.toml", [])[0] == "train"
