"""The advice how to install the workbench names a place that exists, never a bare name on an index."""

import json
import re
from pathlib import Path

import pytest

from dynamics import workbench_install as module
from dynamics.workbench_install import workbench_install
from tests.support.tutorial import ROOT

NOWHERE = Path("/nonexistent")


def installed_from(monkeypatch: pytest.MonkeyPatch, record: str | None) -> None:
    """An install away from its source, with this direct_url.json."""

    class Distribution:
        def read_text(self, name: str) -> str | None:
            assert name == "direct_url.json"
            return record

    monkeypatch.setattr(module, "ROOT", NOWHERE)
    monkeypatch.setattr(module.metadata, "distribution", lambda name: Distribution())


def test_beside_its_source_the_source_is_named() -> None:
    assert workbench_install() == f"pip install '{ROOT}[workbench]'"


def test_a_wheel_that_is_still_there_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    wheel = tmp_path / "with a space" / "alula-0.1.0-py3-none-any.whl"
    wheel.parent.mkdir()
    wheel.touch()
    installed_from(monkeypatch, json.dumps({"url": wheel.as_uri(), "archive_info": {}}))
    assert workbench_install() == f"pip install '{wheel}[workbench]'"


@pytest.mark.parametrize(
    "record",
    [
        None,
        "no JSON",
        "[]",
        "{}",
        json.dumps({"url": "file:///nonexistent/alula"}),
        json.dumps({"url": "https://example.org/alula.whl"}),
    ],
)
def test_without_a_source_the_folder_of_the_source_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, record: str | None
) -> None:
    installed_from(monkeypatch, record)
    assert workbench_install() == "pip install '.[workbench]' in the folder of Alula's source"


def test_a_folder_of_another_project_is_not_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "other"\n')
    installed_from(monkeypatch, json.dumps({"url": tmp_path.as_uri()}))
    assert str(tmp_path) not in workbench_install()


def test_no_message_installs_by_a_name_that_no_index_has() -> None:
    """A sentence that says `pip install 'alula[...]'` would install whatever has taken the name."""
    rooms = [folder for folder in ROOT.iterdir() if (folder / "__init__.py").is_file() and folder.name != "tests"]
    files = [file for room in rooms for file in room.rglob("*.py")]
    files += [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    by_name = re.compile(r"install ['\"]?alula\b(?!-)")  # a wheel's own file may be named
    assert [str(file) for file in files if by_name.search(file.read_text(encoding="utf-8"))] == []
