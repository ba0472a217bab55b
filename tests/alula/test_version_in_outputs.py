"""The version of Alula is in every output that can be sent to somebody.

| output | where |
| --- | --- |
| JSON of a command or of the Python API | `alula_version`, of a list in each object |
| page (HTML) | last lines |
| recording (MCAP) | metadata `version` |
| flight table (Parquet) | schema metadata `alula_version` |
| bundle | manifest `versions.alula`; `alula_version` in the metadata of model.onnx |
| checkpoint | card `versions.alula` |
| case and its archive | case.json `alula_version` |
| fleet folder | fleet.json `alula_version` |
"""

from __future__ import annotations

import ast
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pa_parquet
import pytest

from dynamics.files import write_answer
from dynamics.version import VERSION_KEY, __version__
from export.bundle import LIBRARIES as OF_BUNDLES
from export.bundle import ExportOptions, _onnx_metadata
from export.trained import read_model
from flights import Flight
from flights.log import Provenance
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from studio.case.archive import write_archive
from studio.case.case import Case
from studio.case.state_file import STATE_FILE
from studio.pages.provenance import origin
from studio.pages.tables import tables_page
from tests.support.command_line import Run, command_line
from vehicles import FOLDER

ROOT = Path(__file__).parents[2]
# Files that write JSON without the version, and why.
WITHOUT = {
    "alula/cli/vehicle.py": "the schema, whose keys are those of JSON Schema",
    "alula/cli/demo.py": "report.json of the demonstration",
    "studies/sweep/run.py": "the sweep's own file, by which it finds its cells again",
}


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


def _calls(path: Path) -> Iterator[str]:
    """Names of the functions that a module calls."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            yield node.func.id


def test_no_command_writes_json_without_the_version() -> None:
    files = [path for room in ("alula", "studies") for path in (ROOT / room).rglob("*.py")]
    without = {str(path.relative_to(ROOT)) for path in files if "write_json" in _calls(path)}
    assert without == set(WITHOUT)
    assert sum("write_answer" in _calls(path) for path in files) >= 12


def test_objects_lists_and_numbers(tmp_path: Path) -> None:
    for value, written in (
        ({"a": 1.0}, {"a": 1.0, VERSION_KEY: __version__}),
        ([{"a": 1}, {}], [{"a": 1, VERSION_KEY: __version__}, {VERSION_KEY: __version__}]),
        (3.0, 3.0),
    ):
        write_answer(value, tmp_path / "a.json")
        assert json.loads((tmp_path / "a.json").read_text()) == written


@pytest.mark.parametrize("words", [("effects", "mass", "--json", "-"), ("vehicle", "show", "px4_sih", "--json", "-")])
def test_commands_that_answer_in_json(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, _ = run(*words)
    assert code == 0
    answer = json.loads(out)
    assert {entry[VERSION_KEY] for entry in (answer if isinstance(answer, list) else [answer])} == {__version__}


def test_pages(tmp_path: Path) -> None:
    assert f"Made by Alula {__version__}" in tables_page("A table", [], [], [], origin=origin({}))


def test_flight_tables(tmp_path: Path) -> None:
    flight = Flight(np.arange(3.0), {"yaw": np.zeros(3)}, Provenance("a", "", "flight CSV", "test"))
    metadata = pa_parquet.read_schema(flight.to_parquet(tmp_path / "a.parquet")).metadata
    assert metadata[VERSION_KEY.encode()] == __version__.encode()


def test_onnx_files_and_bundles() -> None:
    model = read_model(FOLDER / "px4_sih.toml")
    metadata = _onnx_metadata(model, ExportOptions(Problem(), native_processor()))
    assert metadata[VERSION_KEY] == __version__
    assert "alula" in OF_BUNDLES


def test_cases_and_their_archives(tmp_path: Path) -> None:
    log = tmp_path / "a.csv"
    log.write_text("t,position_x\n0,0\n")
    case = Case.create(tmp_path / "case")
    case.add_logs([log])
    assert json.loads((case.folder / STATE_FILE).read_text())[VERSION_KEY] == __version__
    with zipfile.ZipFile(write_archive(case, tmp_path / "sent.alula.zip")) as archive:
        assert json.loads(archive.read(STATE_FILE))[VERSION_KEY] == __version__
    case.close()
    again = Case.open(tmp_path / "case")
    assert len(again.state.logs) == 1
    again.close()
