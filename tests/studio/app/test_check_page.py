"""Step 2 as data: logs whose columns are not what they declare, and logs that cannot be read."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import msgspec
import pytest
from plotly.utils import PlotlyJSONEncoder

from studio.app import check_page
from studio.app.opened import OpenCase
from tests.support.command_line import command_line
from tests.support.flight_files import manoeuvre
from tests.support.px4_bag import px4_bag

FIELD = Path(__file__).parents[2] / "data" / "field"
MOCAP = FIELD / "05_mocap_axes"
TIMEOUT = 250.0  # s on a busy machine; alone each step takes some seconds


def _checked(opened: OpenCase, log: Path, mapping: Path | None = None) -> str:
    """The page of a checked log, as JSON."""
    if not opened.case.state.logs:
        opened.case.add_logs([log])
    if mapping is not None:
        opened.case.set_options(msgspec.structs.replace(opened.case.state.options, mapping=str(mapping)))
    opened.start("check")
    opened.wait(TIMEOUT)
    assert opened.failure == ""
    return json.dumps(check_page.layout(opened, "case", "light"), cls=PlotlyJSONEncoder, ensure_ascii=False)


def _commands(page: str) -> list[str]:
    """The texts that a button copies."""
    texts: list[str] = []

    def walk(part: Any) -> None:
        if isinstance(part, dict):
            if part.get("type") == "Pre" and part["props"].get("id"):
                texts.append(part["props"]["children"])
            part = list(part.values())
        if isinstance(part, list):
            for child in part:
                walk(child)

    walk(json.loads(page))
    return texts


@pytest.mark.parametrize(
    ("log", "mapping", "statement", "evidence", "repair"),
    [
        (
            MOCAP / "motive_yup_mm_3.csv.gz",
            MOCAP / "mapping.toml",
            "y up",
            "turning and rates agrees then",
            "body_axes",
        ),
        (MOCAP / "zup_correct_mm_3.csv.gz", MOCAP / "mapping_metres.toml", "is in mm", "times what", "scale = 0.001"),
        (FIELD / "14_board_turned" / "drag_acc90_1.csv.gz", None, "accelerometer is turned", "agrees then", "axes = "),
    ],
    ids=["axes", "unit", "turned"],
)
def test_columns_that_are_not_as_declared_have_evidence_and_a_command_that_repairs_them(
    log: Path,
    mapping: Path | None,
    statement: str,
    evidence: str,
    repair: str,
    opened: OpenCase,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = _checked(opened, log, mapping)
    for part in (statement, "Evidence: ", evidence, repair):
        assert part in page, page
    (command,) = [command for command in _commands(page) if "--repair" in command]
    monkeypatch.chdir(tmp_path)
    words = shlex.split(command)
    code, _, wrong = command_line(monkeypatch, capsys)(*words[1:])
    assert code == 0, wrong
    repaired = _checked(opened, log, tmp_path / words[-1])
    assert "--repair" not in repaired
    assert opened.status("check") == "done"


def test_a_log_that_is_read_and_not_as_declared_says_so_once_beside_the_command(
    opened: OpenCase, tmp_path: Path
) -> None:
    """As of an autopilot that was given motion capture in millimetres."""
    truth = manoeuvre(duration=12.0, rate=100.0)
    page = _checked(opened, px4_bag(truth._replace(position=1000 * truth.position), tmp_path / "bag"))
    assert page.count("is in mm") == 1, page
    (command,) = [command for command in _commands(page) if "--repair" in command]
    assert "bag" in command


def test_a_log_that_is_as_declared_has_nothing_to_repair(opened: OpenCase) -> None:
    page = _checked(opened, MOCAP / "zup_correct_mm_3.csv.gz", MOCAP / "mapping.toml")
    assert "not what they declare" not in page
    assert "--repair" not in page


def test_a_log_that_cannot_be_read_says_why(opened: OpenCase) -> None:
    page = _checked(opened, FIELD / "06_ulog_containers_and_topics" / "encrypted.ulge")
    assert "decrypt it with" in page
    assert "This log cannot be read" in page
    assert "--repair" not in page
