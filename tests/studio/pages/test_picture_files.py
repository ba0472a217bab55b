"""Pictures as files: one for each entry of a menu, in vectors, and a remedy where something is missing."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

from diagnosis.comparison import ComparisonDetails
from diagnosis.data.dataset import Dataset
from dynamics.errors import RequestError
from studio.pages.figure import Choice, Picture, choosing, picture
from studio.pages.picture_files import FORMATS, figures_of, write_pictures
from studio.pages.report import comparison_pictures
from tests.support.browser import BROWSER

MAGIC = {"pdf": b"%PDF", "svg": b"<svg", "png": b"\x89PNG"}
drawable = pytest.mark.skipif(
    (BROWSER is None or importlib.util.find_spec("kaleido") is None) and os.environ.get("CI") != "true",
    reason="no Chromium or no Kaleido here; CI has both",
)


@pytest.fixture
def chosen() -> Picture:
    """Two clouds of points, one of which a menu shows."""
    figure = go.Figure([go.Scattergl(x=np.arange(3.0), y=np.arange(3.0), mode="markers") for _ in "ab"])
    choosing(figure, [Choice("Cloud, a", [0], {"yaxis.title.text": "a, m"}), Choice("Cloud, b", [1])], label="cloud")
    return picture(figure, 300, "Points.")


def test_a_picture_with_a_menu_is_a_figure_for_each_entry(chosen: Picture) -> None:
    figures = dict(figures_of("clouds", chosen))
    assert list(figures) == ["clouds_cloud_a", "clouds_cloud_b"]
    first, second = figures.values()
    assert [trace["visible"] for trace in first["data"]] == [True, False]
    assert [trace["visible"] for trace in second["data"]] == [False, True]
    assert first["layout"]["yaxis"]["title"]["text"] == "a, m"
    assert {trace["type"] for trace in first["data"]} == {"scatter"}


def test_the_pictures_of_a_page_have_names(compared: ComparisonDetails, dataset: Dataset) -> None:
    names = list(comparison_pictures(compared, dataset))
    assert names[:3] == ["bars", "lines", "regimes"]
    assert {"planes_1", "spectrum", "agreement"} <= set(names)


@drawable
def test_pictures_are_written_in_every_format(chosen: Picture, tmp_path: Path) -> None:
    folder = tmp_path / "figures"
    files = write_pictures({"clouds": chosen}, folder)
    assert sorted(folder.iterdir()) == sorted(files)
    assert len(files) == 2 * len(FORMATS)
    for file in files:
        assert file.read_bytes().startswith(MAGIC[file.suffix[1:]])


def test_what_is_missing_is_named(chosen: Picture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kaleido", None)
    with pytest.raises(RequestError, match=r"pip install '.*\[workbench\]'"):
        write_pictures({"clouds": chosen}, tmp_path / "figures")
    (tmp_path / "file").write_text("")
    with pytest.raises(RequestError, match="cannot make the folder"):
        write_pictures({"clouds": chosen}, tmp_path / "file")


@drawable
def test_a_machine_without_a_browser_is_told_what_to_install(
    chosen: Picture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BROWSER_PATH", str(tmp_path / "none"))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RequestError, match="need Chromium or Chrome"):
        write_pictures({"clouds": chosen}, tmp_path / "figures")
