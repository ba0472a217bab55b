"""`alula evaluate` as a user meets it."""

from __future__ import annotations

import csv
import dataclasses
import json
from pathlib import Path

import msgspec
import pytest

from dynamics.errors import RequestError
from dynamics.references.manoeuvres import PAPER
from dynamics.vehicle import Vehicle
from studies import paper
from studies.tables import Table, markdown, shown
from tests.support.command_line import Run, command_line
from tests.support.small_campaign import fly_campaign
from tests.support.trained import untrained_model
from training import checkpoint
from training.models import named_kind

EFFECTS = ("motor_lag:time_constant=0.035", "rotor_drag:coefficient=6e-5")


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory, arpl_250g: Vehicle) -> Path:
    folder = tmp_path_factory.mktemp("small") / "campaign"
    flights = {"test/Lemniscate": "Lemniscate:laps=1,ramp=1", "train/Parabola_xy_60": "Parabola:laps=1,ramp=1"}
    return fly_campaign(folder, arpl_250g, EFFECTS, flights)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory, arpl_250g: Vehicle) -> Path:
    path = tmp_path_factory.mktemp("models") / "arpl_250g.pi_tcn.pt"
    made = untrained_model(named_kind("pi_tcn").config, arpl_250g)
    checkpoint.save(dataclasses.replace(made, card=msgspec.structs.replace(made.card, kind="pi_tcn")), path)
    return path


def test_tables_pictures_and_page_are_written(run: Run, campaign: Path, model: Path, tmp_path: Path) -> None:
    code, out, _ = run(
        "evaluate",
        model,
        campaign,
        "--vehicle",
        "arpl_250g",
        "--json",
        tmp_path / "found.json",
        "--csv",
        tmp_path / "csv",
        "--pictures",
        tmp_path / "pictures",
        "--html",
        tmp_path / "page.html",
    )
    assert code == 0
    for words in ("RMSE against the truth", "Pulse responses", "onnxruntime", "paper's pi_tcn / NOM", "of NOM's"):
        assert words in out
    answer = json.loads((tmp_path / "found.json").read_text())
    assert [m["name"] for m in answer["evaluated"]["models"]] == ["NOM", "vehicle file", "pi_tcn", "plant"]
    assert list(answer["evaluated"]["flights"]) == ["Lemniscate.parquet"]
    assert {t["engine"] for t in answer["inference"] if t["model"] == "pi_tcn"} == {
        "torch, window",
        "torch, streamed",
        "onnxruntime",
        "kernel, streamed",
    }
    assert all(0 < t["median"] <= t["slowest"] < 1 for t in answer["inference"])
    with (tmp_path / "csv" / "ratio_to_nominal.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert float(row["paper's pi_tcn / NOM"]) == pytest.approx(0.39 / 9.16)
    assert {p.name for p in (tmp_path / "pictures").iterdir()} == {
        f"{name}.{kind}" for name in ("rmse_over_nominal", "prediction_Lemniscate") for kind in ("png", "pdf")
    }
    page = (tmp_path / "page.html").read_text()
    assert page.count("<img") == 2
    assert "alula evaluate" in page


def test_without_a_compiler_the_kernel_is_not_timed_and_a_note_names_it(
    run: Run, campaign: Path, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise RequestError("no C compiler was found. Install gcc.")

    monkeypatch.setattr("export.kernel.build_kernel", refuse)
    code, out, _ = run("evaluate", model, campaign)
    assert code == 0
    assert "note: the kernel of pi_tcn is not timed: no C compiler was found. Install gcc." in out
    assert "onnxruntime" in out


def test_what_cannot_be_evaluated_is_refused(run: Run, campaign: Path, model: Path, tmp_path: Path) -> None:
    for arguments, words in (
        ([model], "no flight was given"),
        ([campaign], "no model to evaluate"),
        ([tmp_path / "none.pt", campaign], "there is no"),
        ([model, model, campaign], "given twice"),
        ([model, campaign, "--csv", "/proc/none"], "cannot write"),
    ):
        code, _, wrong = run("evaluate", *arguments, "--no-timing")
        assert code == 2
        assert words in wrong


def test_the_papers_table_is_whole() -> None:
    assert set(paper.PREDICTION) == {name for name, m in PAPER.items() if m.peaks} == set(paper.TRACKING_NOMINAL)
    assert {len(row) for row in paper.PREDICTION.values()} == {7}
    ratios = [paper.prediction_ratio(f"{flight}.parquet", "pi_tcn") for flight in paper.PREDICTION]
    assert [round(ratio or 0, 3) for ratio in ratios] == [0.175, 0.107, 0.159, 0.099, 0.043, 0.142, 0.146, 0.064]
    assert paper.prediction_ratio("hover.csv", "pi_tcn") is None


def test_numbers_are_short_and_gaps_are_empty() -> None:
    cells = ("a", 3, 0.123456, 1234.5, None, float("nan"))
    assert [shown(cell) for cell in cells] == ["a", "3", "0.123", "1234", "", ""]
    table = Table("t", "Title", ("x", "y"), (("a", 0.5),), "Note.")
    assert markdown(table) == "**Title**\n\n| x | y |\n| --- | --- |\n| a | 0.5 |\n\nNote."
