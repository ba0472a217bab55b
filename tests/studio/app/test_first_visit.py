"""A first visit: an example to click, and marks that do not praise what could not be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.results.read import RESULTS
from studio.app import studio as room
from studio.app.home_page import layout
from studio.app.opened import OpenCase
from studio.app.studio import Studio
from studio.case.case import Case
from studio.example import example_logs
from tests.studio.app.test_studio import CountedWorker
from tests.support.worker_here import WorkerHere

ORIGINALS = Path(__file__).parents[2] / "data" / "px4_sih_flights"


@pytest.fixture
def studio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Studio:
    monkeypatch.setattr(room, "Worker", CountedWorker)
    return Studio(tmp_path / "cases", RESULTS)


def test_an_example_is_one_click_away(studio: Studio) -> None:
    assert '"act": "example"' in str(layout(studio)).replace("'", '"')
    name = studio.open_example()
    opened = studio.case(name)
    assert opened is not None
    assert [path.name for path in opened.case.log_paths] == [path.name for path in example_logs()]
    assert len(example_logs()) == 2
    assert opened.case.vehicle().name == "px4_sih"
    assert all(path.read_bytes() == (ORIGINALS / path.name).read_bytes() for path in example_logs())
    studio.close()


def test_a_check_in_which_no_log_could_be_read_gets_no_tick(tmp_path: Path) -> None:
    case = Case.create(tmp_path / "case")
    opened = OpenCase(case, WorkerHere)  # type: ignore[arg-type]
    log = tmp_path / "torn.ulg"
    log.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(200))
    case.add_logs([log])
    opened.start("check")
    opened.wait()
    assert opened.is_fresh("check")
    assert opened.status("check") == "refused"
    case.close()
